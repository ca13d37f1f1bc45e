"""The figure of `testbed air`: what probes felt, beside what the model promises."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.state import Array, Truths
from testbed.views.panels import BLACK, BLUE, GREEN, GREY, ORANGE, Band, Line, Panel, Sheet

ENDINGS = (".png", ".pdf", ".svg")
SHOWN_S = 60.0  # of the records: more would be a smear
COMPONENTS = (
    ("longitudinal u", "u"),
    ("lateral v, right", "v"),
    ("vertical w, down", "w"),
)
PROBES = (BLUE, ORANGE)


@dataclass(frozen=True, slots=True)
class AirPicture:
    """What is drawn, with P probes, T samples and B bands of frequency."""

    title: str
    subtitle: str
    names: tuple[str, ...]  # P
    time: Array  # (T,) s
    velocity: Array  # (P, T, 3) m/s about the mean wind: longitudinal, right, down
    frequency_hz: Array  # (B,)
    psd: Array  # (P, 3, B) (m/s)²/Hz
    psd_expected: tuple[Array, Array, Array] | None  # (3, B): closed form, ends of its 95 % band
    separation: float | None  # m between two probes
    coherence: Array  # (3, B)
    coherence_expected: tuple[Array, Array, Array] | None  # (3, B), as above


def sheet_of(picture: AirPicture) -> Sheet:
    """The panels: a row for each component; records, spectra and, of two probes, coherence."""
    two = picture.separation is not None
    rows = [
        [_record(picture, k), _spectrum(picture, k), *([_coherence(picture, k)] if two else [])]
        for k in range(3)
    ]
    return Sheet(picture.title, picture.subtitle, rows, (1.25, 1.0, 1.0) if two else (1.4, 1.0))


def draw_air(picture: AirPicture, path: Path) -> None:
    """Write the figure.

    Raises:
        OSError: it cannot be written.
    """
    from testbed.views.figure_door import draw

    draw(sheet_of(picture), path)


def _record(picture: AirPicture, k: int) -> Panel:
    shown = _window(picture)
    largest = 1.05 * float(np.abs(picture.velocity[:, shown]).max()) or 1.0
    lines = [
        Line(picture.time[shown], picture.velocity[probe, shown, k], colour, name)
        for probe, (name, colour) in enumerate(zip(picture.names, PROBES, strict=False))
    ]
    return Panel(
        COMPONENTS[k][0],
        "time, s" if k == 2 else "",
        "m/s",
        lines,
        x_limits=(float(picture.time[shown][0]), float(picture.time[shown][-1])),
        y_limits=(-largest, largest),
    )


def _window(picture: AirPicture) -> Truths:
    """A minute (T,) of the records: the first; without turbulence that round the largest gust."""
    if picture.psd_expected is not None:
        return picture.time <= SHOWN_S
    largest = np.abs(picture.velocity).max(axis=(0, 2)).argmax()
    begin = min(picture.time[largest] - 0.5 * SHOWN_S, picture.time[-1] - SHOWN_S)
    begin = max(float(begin), 0.0)
    shown: Truths = (picture.time >= begin) & (picture.time <= begin + SHOWN_S)
    return shown


def _spectrum(picture: AirPicture, k: int) -> Panel:
    symbol = COMPONENTS[k][1]
    moving = np.where(picture.psd > 0.0, picture.psd, np.nan)
    lines = [
        Line(picture.frequency_hz, moving[probe, k], colour, width=1.3)
        for probe, colour in zip(range(len(picture.names)), PROBES, strict=False)
    ]
    bands, limits = [], None
    if np.isfinite(moving[:, k]).any():  # below is the rounding of a record that hardly varies
        peak = float(np.nanmax(moving[:, k]))
        limits = (1e-8 * peak, 3.0 * peak)
    if picture.psd_expected is not None and picture.psd_expected[0][k].all():
        closed, low, high = (each[k] for each in picture.psd_expected)
        limits = (0.1 * float(low.min()), 3.0 * float(high.max()))  # what is cut off falls far
        lines.append(Line(picture.frequency_hz, closed, BLACK, "closed form", 1.2))
        bands.append(Band(picture.frequency_hz, low, high, GREY, "95 % of estimates"))
    return Panel(
        f"spectrum of {symbol}",
        "frequency, Hz" if k == 2 else "",
        "(m/s)²/Hz",
        lines,
        bands,
        x_log=True,
        y_log=True,
        y_limits=limits,
        note=f"{symbol} does not vary",
    )


def _coherence(picture: AirPicture, k: int) -> Panel:
    lines = [
        Line(picture.frequency_hz, picture.coherence[k], GREEN, "between the probes", dots=True)
    ]
    bands = []
    if picture.coherence_expected is not None:
        closed, low, high = (each[k] for each in picture.coherence_expected)
        lines.append(Line(picture.frequency_hz, closed, BLACK, "closed form", 1.2))
        bands.append(Band(picture.frequency_hz, low, high, GREY, "95 % of estimates"))
    return Panel(
        f"coherence of {COMPONENTS[k][1]}, {picture.separation:g} m apart",
        "frequency, Hz" if k == 2 else "",
        "coherence, real part",
        lines,
        bands,
        x_log=True,
        y_limits=(-1.05, 1.05),
        note=f"{COMPONENTS[k][1]} does not vary",
    )
