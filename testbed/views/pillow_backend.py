"""Draw pictures of lines, triangles and texts, and write them as a video.

The only module that imports Pillow. Nothing here needs a display or another program.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import InputError, needs_extra
from testbed.core.records import Array
from testbed.views.panels import Colour

with needs_extra("video", "videos"):
    from PIL import Image, ImageDraw, ImageFont, features

FINER = 2  # drawn at this many times the size, and reduced: smooth edges
TEXT_SIZE = 13.0  # pixels
BEHIND_TEXT: Colour = (30, 34, 42)
QUALITY, EFFORT = 72, 9  # of AV1: 0..100; 0 slow and small to 10 fast
MAX_BYTES = 1 << 30  # of a GIF or PNG while it is made

Pixels = NDArray[np.uint8]
Render = Callable[[int], "Drawing"]


class Drawing:
    """A picture: first lines and triangles, then texts."""

    def __init__(self, width: int, height: int, backdrop: Colour | Pixels) -> None:
        """Start with a backdrop; sizes and positions are pixels from the upper left corner.

        Args:
            width: pixels.
            height: pixels.
            backdrop: one colour, or those (FINER * height, 3) of the rows.
        """
        size = FINER * width, FINER * height
        if isinstance(backdrop, tuple):
            self.image = Image.new("RGB", size, backdrop)
        else:
            self.image = Image.fromarray(backdrop[:, None]).resize(size, Image.Resampling.NEAREST)
        self._draw: Any = ImageDraw.Draw(self.image)
        self._reduced = False

    def polygons(self, corners: Array, colours: Pixels) -> None:
        """Fill polygons (t, k, 2) with colours (t, 3), in this order."""
        flat = (FINER * corners).reshape(len(corners), -1).tolist()
        for points, colour in zip(flat, colours.tolist(), strict=True):
            self._draw.polygon(points, fill=tuple(colour))

    def line(self, points: Array, colour: Colour, width: float = 1.0) -> None:
        """Draw a line through points (k, 2)."""
        finer = 1 if self._reduced else FINER
        path = (finer * points).ravel().tolist()
        self._draw.line(path, fill=colour, width=max(1, round(finer * width)), joint="curve")

    def dot(self, point: Array, colour: Colour, radius: float) -> None:
        """Draw a filled circle."""
        x, y = (FINER * point).tolist()
        r = FINER * radius
        self._draw.ellipse([x - r, y - r, x + r, y + r], fill=colour)

    def segments(self, ends: Array, colours: Pixels, widths: Array) -> None:
        """Draw straight lines between ends (k, 2, 2), in this order."""
        flat = (FINER * ends).reshape(len(ends), -1).tolist()
        whole = np.maximum(np.round(FINER * widths), 1.0).astype(int).tolist()
        for path, colour, width in zip(flat, colours.tolist(), whole, strict=True):
            self._draw.line(path, fill=tuple(colour), width=width)

    @staticmethod
    def joined(width: int, height: int, parts: Sequence[tuple[Drawing, int, int]]) -> Drawing:
        """Join finished pictures, each at its left and top, in one of this size."""
        both = Drawing(1, 1, BEHIND_TEXT)
        both.image = Image.new("RGB", (width, height), BEHIND_TEXT)
        for part, left, top in parts:
            both.image.paste(part.finish(), (left, top))
        both._draw, both._reduced = ImageDraw.Draw(both.image), True
        return both

    def text(
        self,
        middle: Array,
        text: str,
        colour: Colour,
        *,
        anchor: str = "mm",
        size: float = TEXT_SIZE,
        boxed: bool = True,
    ) -> None:
        """Write a text; after the first one no more lines and triangles are drawn.

        Args:
            middle: (2,) of the text, or the point that `anchor` names.
            text: one line.
            colour: of the letters.
            anchor: see Pillow.
            size: of the font, pixels.
            boxed: whether it has a background.
        """
        self.finish()
        font = ImageFont.load_default(size)
        at = (float(middle[0]), float(middle[1]))
        if boxed:
            left, top, right, bottom = self._draw.textbbox(at, text, font, anchor)
            self._draw.rounded_rectangle((left - 3, top - 2, right + 3, bottom + 2), 3, BEHIND_TEXT)
        self._draw.text(at, text, fill=colour, font=font, anchor=anchor)

    def finish(self) -> Image.Image:
        """Return the picture at its size."""
        if not self._reduced:
            self.image = self.image.reduce(FINER)
            self._draw = ImageDraw.Draw(self.image)
            self._reduced = True
        return self.image


def text_width(text: str, size: float = TEXT_SIZE) -> float:
    """Measure a text, pixels."""
    return float(ImageFont.load_default(size).getlength(text))


def save_picture(file: BinaryIO, drawing: Drawing) -> None:
    """Write a picture as PNG."""
    drawing.finish().save(file, "PNG", optimize=True)


def save_video(
    file: BinaryIO,
    kind: str,
    render: Render,
    count: int,
    frame_ms: int,
    colours: Sequence[Colour],
) -> None:
    """Draw frames and write them as a video without end.

    Args:
        file: gets the video.
        kind: suffix of the file: .mp4 (AV1), .gif, .png or .apng (animated PNG).
        render: draws a frame by its number; called in order, some numbers twice.
        count: of frames, at least 2.
        frame_ms: duration of a frame, ms.
        colours: at most 256 to which a GIF or PNG is reduced.

    Raises:
        InputError: the video is too long for its kind, or Pillow was built without AV1.
    """
    if kind == ".mp4":
        if not features.check("avif"):
            raise InputError("this Pillow was built without AVIF; write a GIF or an animated PNG")
        frames: Image.Image = _Frames(render, count)
        content = io.BytesIO()
        frames.save(
            content, "AVIF", save_all=True, duration=frame_ms, quality=QUALITY, speed=EFFORT
        )
        file.write(mp4_from_avif(content.getvalue()))
        return
    width, height = render(0).finish().size
    if count * width * height > MAX_BYTES:
        raise InputError(
            f"{count} frames of {width}x{height} are too many for {kind}; write a .mp4, or fewer "
            "frames with --to, --speed, --fps or --size"
        )
    palette = Image.new("P", (1, 1))
    palette.putpalette([each for colour in colours for each in colour])
    reduced = [
        render(k).finish().quantize(palette=palette, dither=Image.Dither.NONE) for k in range(count)
    ]
    options: dict[str, Any] = {"optimize": True} if kind == ".gif" else {"compress_level": 9}
    reduced[0].save(
        file, "GIF" if kind == ".gif" else "PNG", save_all=True, append_images=reduced[1:],
        duration=frame_ms, loop=0, **options,
    )  # fmt: skip


class _Frames(Image.Image):
    """A sequence whose frames are drawn when they are needed, as a file's are read."""

    is_animated = True

    def __init__(self, render: Render, count: int) -> None:
        super().__init__()
        self._render, self.n_frames, self._frame = render, count, -1
        self._mode = "RGB"
        self.seek(0)

    def seek(self, frame: int) -> None:
        if frame >= self.n_frames:
            raise EOFError
        if frame != self._frame:
            image = self._render(frame).finish()
            self._im, self._size, self._frame = image.im, image.size, frame

    def tell(self) -> int:
        return self._frame


def mp4_from_avif(data: bytes) -> bytes:
    """Turn an AVIF image sequence into an MP4 file of the same length.

    Both hold AV1 in the boxes of ISO/IEC 14496-12. The sequence has one track of pictures, played
    for ever, and an item that still-image programs show; the MP4 file has the track as video.
    """
    content = bytearray(data)
    boxes = {kind: (start, end) for kind, start, end in _boxes(content, 0, len(content))}
    start, end = boxes[b"ftyp"]
    brands = [b"isom", b"\0\0\2\0", b"isom", b"iso6", b"av01", b"mp41"]
    rest = (end - start) // 4 - len(brands)
    content[start:end] = b"".join(brands + [b"isom"] * rest)
    content[boxes[b"meta"][0] - 4 : boxes[b"meta"][0]] = b"free"
    movie = boxes[b"moov"]
    duration = 0
    for kind, first, last in _boxes(content, *movie):
        if kind != b"trak":
            continue
        inner = {k: (a, b) for k, a, b in _boxes(content, first, last)}
        media = {k: (a, b) for k, a, b in _boxes(content, *inner[b"mdia"])}
        handler = media[b"hdlr"][0] + 8
        content[handler : handler + 4] = b"vide"
        duration = _read_duration(content, media[b"mdhd"][0])
        _write_duration(content, inner[b"tkhd"][0], duration, 20, 28)
        content[inner[b"tkhd"][0] + 3] = 3  # enabled, in the movie
        if b"edts" in inner:  # plays the track for ever
            content[inner[b"edts"][0] - 4 : inner[b"edts"][0]] = b"free"
    header = next(a for k, a, _ in _boxes(content, *movie) if k == b"mvhd")
    _write_duration(content, header, duration, 16, 24)
    return bytes(content)


def _boxes(content: bytearray, start: int, end: int) -> list[tuple[bytes, int, int]]:
    """List type, and start and end of the content, of the boxes between two positions."""
    found = []
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", content, start)
        head = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", content, start + 8)
            head = 16
        size = size or end - start
        found.append((kind, start + head, start + size))
        start += size
    return found


def _read_duration(content: bytearray, header: int) -> int:
    if content[header] == 1:
        return int(struct.unpack_from(">Q", content, header + 24)[0])
    return int(struct.unpack_from(">I", content, header + 16)[0])


def _write_duration(content: bytearray, header: int, duration: int, short: int, long: int) -> None:
    """Write the duration of a box of version 0 or 1, at these positions."""
    if content[header] == 1:
        struct.pack_into(">Q", content, header + long, duration)
    else:
        struct.pack_into(">I", content, header + short, duration)
