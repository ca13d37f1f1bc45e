"""Make the pictures of the docs that a command of the testbed makes.

usage: python benchmarks/pictures.py [--only poles] --into docs/margins.md

Each picture stands between markers in one page; other pages may show it too. Those of reports are
screenshots by Chromium; those of the Rerun viewer need a Vulkan driver, which may be software.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from inputs import ROOT, Case, Inputs
from tables import add_output_arguments, blocks, part_of, publish

COMMAND = "python benchmarks/pictures.py"
IMAGES = ROOT / "docs" / "images"
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
DIFFER = 3  # exit code of a comparison whose runs differ, of margins below a bound
MAX_WIDTH = 1600  # pixels
SIMULATION = Case("simulation-3")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the docs.

    Args:
        file: in docs/images.
        page: with its markers.
        alt: what it shows.
        make: writes it, in an empty folder that is the working directory.
        inputs: of its numbers.
        minutes: at most, on two quiet processors.
    """

    file: str
    page: str
    alt: str
    make: Callable[[Path], None]
    inputs: Inputs
    minutes: float = 1.0

    @property
    def name(self) -> str:
        """Name without ending."""
        return Path(self.file).stem


def testbed(*words: str | Path, folder: Path | None = None) -> None:
    """Run the command line program, where runs that differ are no error."""
    command = [sys.executable, "-m", "testbed", *map(str, words)]
    code = subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL).returncode
    if code not in (0, DIFFER):
        raise SystemExit(f"testbed {' '.join(map(str, words))}: exit code {code}")


def screenshot(page: Path, picture: Path, size: str) -> None:
    """Write a picture of the head of an HTML page; `size` is WIDTH,HEIGHT."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        raise SystemExit(f"{picture.name} needs Chromium (install it, as .ci/run does)")
    as_root = ("--no-sandbox",) if os.geteuid() == 0 else ()
    words = ("--headless", *as_root, "--hide-scrollbars", f"--window-size={size}")
    command = [program, *words, f"--screenshot={picture}", page.resolve().as_uri()]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    shrink(picture)


def shrink(file: Path) -> None:
    """Give a PNG at most 256 colours, and a figure at most the width of a page."""
    from PIL import Image

    with Image.open(file) as image:
        small = image.convert("RGB")
    if small.width > MAX_WIDTH:
        height = round(small.height * MAX_WIDTH / small.width)
        small = small.resize((MAX_WIDTH, height), Image.Resampling.LANCZOS)
    small.quantize(256).save(file, optimize=True)


def write_listings(page: str, folder: Path) -> None:
    """Write the files that a page shows under their titles into a folder."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for name, content in re.findall(r'^```\w+ title="(.+?)"\n(.*?)^```$', text, re.M | re.S):
        (folder / name).write_text(content, encoding="utf-8")


def by(*words: str) -> Callable[[Path], None]:
    """Return what makes a picture by one command, to which its path is appended."""
    return lambda file: testbed(*words, file)


def _laws(file: Path) -> None:
    folder = Path.cwd()
    write_listings("docs/own-law.md", folder)
    for scenario, out in (("simulation-3", "paper"), ("chase.yaml", "chase")):
        testbed("run", scenario, "--duration", "5m", "--quiet", "--out", out)
    testbed("compare", "paper", "chase", "--figure", file)


def _study_cases(file: Path) -> None:
    write_listings("docs/studies.md", Path.cwd())
    testbed("sweep", "laws.yaml", "--out", "laws.parquet")
    figures = ("--figures", "figures", "--format", "png", "--width", "3.5", "--no-title")
    testbed("study-report", "laws.parquet", *figures)
    shutil.copy("figures/cases-windows-rectangles-mean_rms_m.png", file)


def _map(study: str) -> Callable[[Path], None]:
    def make(file: Path) -> None:
        testbed("sweep", study, "--out", "map.parquet")
        figures = ("--statistic", "mean", "--figures", "figures", "--format", "png")
        testbed("study-report", "map.parquet", *figures)
        (picture,) = Path("figures").glob("map-*.png")
        shutil.copy(picture, file)

    return make


def _report(file: Path) -> None:
    testbed("run", "simulation-3", "--quiet", "--out", "sim3")
    testbed("report", "sim3", "--out", "sim3.html")
    screenshot(Path("sim3.html"), file, "1200,2330")


def _envelope(file: Path) -> None:
    from jsbsim import get_default_root_dir

    source = Path(get_default_root_dir()) / "aircraft" / "c172p" / "c172p.xml"
    testbed("new", "aircraft", source, "--speed", "55", "--into", "c172p")
    shutil.copy("c172p/envelope.png", file)


def _two_runs(file: Path) -> None:
    for name in ("simulation-3", "simulation-3-latency"):
        testbed("run", name, "--quiet", "--duration", "160", "--out", name)
    testbed("shot", "simulation-3", "simulation-3-latency", "--at", "145", "--out", file)


def _film(file: Path) -> None:
    testbed("run", "simulation-3", "--quiet", "--duration", "360", "--out", "sim3")
    part = ("--from", "332", "--to", "346", "--speed", "2", "--fps", "10", "--size", "704x396")
    testbed("video", "sim3", *part, "--out", file)


def _views(file: Path) -> None:
    """Write the pictures of both views, of which one test makes each."""
    words = ("-m", "pytest", "-q", "-k", "picture", "tests/views/contract/test_views.py")
    variables = {**os.environ, "TESTBED_PICTURES": str(file.parent), "TESTBED_CASES": "all"}
    subprocess.run([sys.executable, *words], cwd=ROOT, env=variables, check=True)


FOLLOWS = ("controller.law=leader_follower:LeaderFollower",)
DELAYS = "0.05,0.1,0.2,0.3,0.4,0.5,0.7,1"
PROFILE_RMS = "controller.profile=rms"
WIND = ("air.turbulence.model=coherent", "air.wind.speed_mps=8", "air.wind.from_deg=240")
SETTINGS = tuple(word for each in WIND for word in ("--set", each))
PICTURES = (
    Picture(
        "poles.png",
        "docs/margins.md",
        "Poles of Simulation 3 with profile rms, straight and at 45 degrees of bank",
        by("margins", "simulation-3", "--set", PROFILE_RMS, "--bank", "0,45", "--plot"),
        Inputs((Case("simulation-3", (PROFILE_RMS,)),)),
    ),
    Picture(
        "root-locus.png",
        "docs/margins.md",
        "Poles of Simulation 3 over a factor of the roll command, straight and at 45 degrees",
        by(
            *("margins", "simulation-3", "--set", PROFILE_RMS, "--bank", "0,45"),
            *("--figure", "root-locus", "--plot"),
        ),
        Inputs((Case("simulation-3", (PROFILE_RMS,)),)),
    ),
    Picture(
        "delay.png",
        "docs/margins.md",
        "Offsets of Simulation 2 over the delay, in a turn at 30 degrees of bank",
        by(
            *("delay", "simulation-2", "--bank", "30", "--delays", DELAYS),
            *("--method", "both", "--plot"),
        ),
        Inputs((Case("simulation-2"),)),
        2,
    ),
    Picture(
        "along-a-string.png",
        "docs/margins.md",
        "Slot errors and gains per hop of Simulation 2 by the frequency of the leader's speed",
        by(
            *("frequency-response", "simulation-2"),
            *("--flown", "0.02,0.04,0.07,0.1,0.15,0.2,0.3", "--plot"),
        ),
        Inputs((Case("simulation-2"),)),
        2,
    ),
    Picture(
        "map-delay-and-loss.png",
        "docs/margins.md",
        "Mean RMS error over message delay and loss, with the contour of 2 m and the boundary of "
        "completed flights",
        _map("map-delay-and-loss"),
        Inputs(studies=("map-delay-and-loss",)),
        15,
    ),
    Picture(
        "map-bank-and-climb.png",
        "docs/margins.md",
        "Mean RMS error over bank and climb of the leader, with the boundary of completed flights",
        _map("map-bank-and-climb"),
        Inputs(studies=("map-bank-and-climb",)),
        5,
    ),
    Picture(
        "air.png",
        "docs/air.md",
        "Wind at two probes 5 m apart in the coherent field",
        by("air", "simulation-3", "--separation", "5", *SETTINGS, "--plot"),
        Inputs((Case("simulation-3", WIND),)),
    ),
    Picture(
        "compare-laws.svg",
        "docs/own-law.md",
        "Distance of three followers from their slots over 300 s, the paper's law solid, Chase "
        "dashed",
        _laws,
        Inputs((SIMULATION,)),
    ),
    Picture(
        "study-cases.png",
        "docs/studies.md",
        "A figure of 3.5 inches: two laws at four points, and their difference",
        _study_cases,
        Inputs(
            (Case("simulation-3", ("controller.law=leader_follower:LeaderFollower",)), SIMULATION)
        ),
    ),
    Picture(
        "envelope.png",
        "docs/own-aircraft.md",
        "Throttle, angle of attack and elevator of the Cessna over airspeed",
        _envelope,
        Inputs(),
        2,
    ),
    Picture(
        "report.png",
        "docs/run.md",
        "The report of Simulation 3: its table and the trajectories",
        _report,
        Inputs((SIMULATION,)),
    ),
    Picture(
        "view-4.png",
        "docs/view.md",
        "Four aircraft with a bursty radio",
        _views,
        Inputs((Case("bursty-wifi"),)),
        3,
    ),
    Picture(
        "view-20.png",
        "docs/view.md",
        "Twenty aircraft",
        _views,
        Inputs((Case("vee-30"),)),
        3,
    ),
    Picture(
        "view-two-runs.png",
        "docs/view.md",
        "Simulation 3 with and without delay",
        _two_runs,
        Inputs((SIMULATION, Case("simulation-3-latency"))),
        2,
    ),
    Picture(
        "formation.gif",
        "docs/index.md",
        "Three Rascals and their leader in a climbing corner of Simulation 3",
        _film,
        Inputs((SIMULATION,)),
        2,
    ),
)
INPUTS = {f"{COMMAND}, {each.name}": each.inputs for each in PICTURES}


def main() -> None:
    """Make pictures, and stamp their pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser, INPUTS)
    options = parser.parse_args()
    if options.check:
        parser.error("--check compares text: pictures are looked at")
    written = {mark for page in options.into for mark in _marks(page)}
    for picture, mark in zip(PICTURES, INPUTS, strict=True):
        if part_of(mark) not in options.only or mark not in written:
            continue
        print(f"make: {picture.file}", file=sys.stderr, flush=True)
        begun = Path.cwd()
        with tempfile.TemporaryDirectory() as folder:
            new = Path(folder).resolve() / picture.file
            work = Path(folder, "work")
            work.mkdir()
            os.chdir(work)
            try:
                picture.make(new)
            finally:
                os.chdir(begun)
            if new.suffix == ".png" and not picture.name.startswith("view-"):  # of photographs
                shrink(new)
            shutil.copy(new, IMAGES / picture.file)
        path = os.path.relpath(IMAGES / picture.file, (ROOT / picture.page).parent)
        options_of = argparse.Namespace(into=[ROOT / picture.page], check=False)
        publish(options_of, {mark: f"![{picture.alt}]({path})"}, INPUTS)


def _marks(page: Path) -> Mapping[str, int]:
    return {each.mark: each.line for each in blocks(page.read_text(encoding="utf-8"))}


if __name__ == "__main__":
    main()
