"""The command that makes a video of a run: video."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from testbed.cli.options import (
    Follow,
    RunName,
    check_follow,
    finite_option,
    output_option,
    parse_pixels,
    positive_option,
    value_option,
)
from testbed.cli.output import describe_file, is_stdout, message_console
from testbed.cli.progress import progress_counter
from testbed.cli.view import read_shown_log
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from testbed.core.records import Array
    from testbed.views.pillow_backend import Drawing
    from testbed.views.video import FlightVideo

SUFFIXES = (".mp4", ".gif", ".png", ".apng")
RATES = (50, 25, 20, 10, 5)  # frames per second whose duration every format can hold
LENGTH_S = 30.0  # of a video without --speed, at most
MAX_FRAMES = 100_000


def video_command(
    run: RunName,
    *,
    out: Annotated[
        Path,
        output_option(
            metavar="FILE",
            help="The video: .mp4 (AV1), .gif, or .png (animated).",
            suffixes=SUFFIXES,
        ),
    ],
    begin: Annotated[
        float | None,
        finite_option(
            "SECONDS", "Time of the run at which it begins.  \\[default: the start]", "--from"
        ),
    ] = None,
    end: Annotated[
        float | None,
        finite_option("SECONDS", "Time of the run at which it ends.  \\[default: the end]", "--to"),
    ] = None,
    speed: Annotated[
        float | None,
        positive_option(
            "X", "Seconds of the run per second.  \\[default: 1, or more for a video of 30 s]"
        ),
    ] = None,
    follow: Follow = None,
    size: Annotated[
        str, value_option("WIDTHxHEIGHT", "Size of the pictures, pixels.")
    ] = "1280x720",
    fps: Annotated[int, value_option("N", "Pictures per second: 50, 25, 20, 10 or 5.")] = 25,
) -> None:
    """Make a video of a run; needs no screen and no graphics card.

    The cameras are those of the viewer: all flying aircraft are in sight, or one is followed.
    """
    from testbed.logs.file_record import record_output
    from testbed.views.recorded_runs import scene_and_batch
    from testbed.views.video import FlightVideo

    pixels = parse_pixels(size)
    if pixels is None or any(each % 2 for each in pixels):
        raise InputError(f"--size {size}: write WIDTHxHEIGHT in even pixels, such as 1280x720")
    if fps not in RATES:
        raise InputError(f"--fps {fps}: write one of {', '.join(map(str, RATES))}")
    if is_stdout(out):
        raise InputError("--out -: a video goes to a file; write its name")
    log = read_shown_log(run)
    check_follow(follow, log.info.names)
    scene, batch = scene_and_batch(log, follow=follow)
    frames = choose_frames(batch.time, begin, end, speed, fps)
    video = FlightVideo(scene, batch, frames, pixels)
    with report_write_errors(f"--out {out}"):
        draw_video(video, out, len(frames), fps, "drawing")
    record_output(out, default=False)
    length = f"{len(frames) / fps:.1f} s of {scene.scenario}"
    messages = message_console()
    messages.write_line(describe_file(out, length))
    if out.suffix.lower() == ".mp4":
        messages.write_line(f"as H.264, for slides: {h264_command(out)}")


def h264_command(film: Path) -> str:
    """Return the command that makes H.264 of a film in AV1, for programs that do not play that."""
    slides = film.with_name(f"{film.stem}-h264.mp4")
    source, target = (shlex.quote(str(each)) for each in (film, slides))
    return f"ffmpeg -i {source} -c:v libx264 -pix_fmt yuv420p {target}"


def draw_video(video: FlightVideo, path: Path, total: int, fps: int, what: str) -> None:
    """Draw all pictures of a video to a file, with `what` as the name of the progress."""
    from testbed.views.pillow_backend import save_video

    with write_file(path) as file, progress_counter(what, total=total, unit="pictures") as progress:

        def render(number: int) -> Drawing:
            progress(number, total)
            return video.frame(number)

        save_video(file, path.suffix.lower(), render, total, 1000 // fps, video.colours)


def choose_frames(
    time: Array, begin: float | None, end: float | None, speed: float | None, fps: int
) -> NDArray[np.intp]:
    """Choose the samples that are drawn.

    Args:
        time: (K,) s, of the samples.
        begin: s; None: the first.
        end: s; None: the last.
        speed: seconds of the run per second; None: 1, or more for a video of `LENGTH_S`.
        fps: pictures per second.

    Returns:
        Their indices (F,), ascending.

    Raises:
        InputError: there are fewer than two or too many, or the run does not have these times.
    """
    import numpy as np

    first, last = float(time[0]), float(time[-1])
    begin, end = first if begin is None else begin, last if end is None else end
    for name, value in (("--from", begin), ("--to", end)):
        if not first <= value <= last:
            raise InputError(f"{name} {value:g}: write a time of the run, {first:g} to {last:g} s")
    speed = max(1.0, (end - begin) / LENGTH_S) if speed is None else speed
    count = int((end - begin) / speed * fps + 1e-6) + 1
    if not 2 <= count <= MAX_FRAMES:
        raise InputError(
            f"--from {begin:g} --to {end:g} --speed {speed:g}: {max(count, 0)} pictures; write "
            f"times and a speed for 2 to {MAX_FRAMES:,}"
        )
    at = begin + speed / fps * np.arange(count)
    after = np.searchsorted(time, at).clip(1, len(time) - 1)
    nearer: NDArray[np.intp] = np.where(time[after] - at < at - time[after - 1], after, after - 1)
    return nearer
