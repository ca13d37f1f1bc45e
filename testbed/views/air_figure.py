"""The figure of `testbed air`: wind at probes beside the closed form of the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array, BoolArray
from testbed.views.panels import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    Band,
    Line,
    Panel,
    PanelGrid,
    Span,
)

SHOWN_S = 60.0  # of the records: more would be unreadable
COMPONENTS = (
    ("longitudinal u", "u"),
    ("lateral v, right", "v"),
    ("vertical w, down", "w"),
)
PROBES = ((BLUE, "o"), (ORANGE, "s"))  # colour and marker
FREQUENCY = "frequency, Hz"


@dataclass(frozen=True, slots=True)
class WindFigureData:
    """Wind at P probes: T samples, and spectra in B frequency bands."""

    title: str
    subtitle: str
    names: tuple[str, ...]  # P
    time: Array  # (T,) s
    velocity: Array  # (P, T, 3) m/s about the mean wind: longitudinal, right, down
    frequency_hz: Array  # (B,)
    psd: Array  # (P, 3, B) (m/s)²/Hz
    psd_expected: tuple[Array, Array, Array] | None  # (3, B): closed form, limits of its 95 % band
    separation: float | None  # m between two probes; None: one probe
    coherence: Array  # (3, B)
    coherence_expected: tuple[Array, Array, Array] | None  # (3, B), as above
    # Hz from which a field falls below the closed form; m, its shortest wave
    unresolved: tuple[float, float] | None = None


def wind_figure(data: WindFigureData) -> PanelGrid:
    """Lay out a row for each component: record, spectrum and, with two probes, coherence."""
    two = data.separation is not None
    rows = [
        [_record(data, k), _spectrum(data, k), *([_coherence(data, k)] if two else [])]
        for k in range(3)
    ]
    return PanelGrid(data.title, data.subtitle, rows, (1.25, 1.0, 1.0) if two else (1.4, 1.0))


def _record(data: WindFigureData, k: int) -> Panel:
    shown = _window(data)
    largest = 1.05 * float(np.abs(data.velocity[:, shown]).max()) or 1.0
    lines = [
        Line(
            data.time[shown],
            data.velocity[probe, shown, k],
            colour,
            name,
            marker=marker,
            marker_phase=probe / len(data.names),
        )
        for probe, (name, (colour, marker)) in enumerate(zip(data.names, PROBES, strict=False))
    ]
    return Panel(
        "",
        "time, s",
        f"{COMPONENTS[k][0]}, m/s",
        lines,
        x_limits=(float(data.time[shown][0]), float(data.time[shown][-1])),
        y_limits=(-largest, largest),
    )


def _window(data: WindFigureData) -> BoolArray:
    """Select a minute (T,) of the records: the first, or without turbulence the largest gust's."""
    if data.psd_expected is not None:
        return data.time <= SHOWN_S
    largest = np.abs(data.velocity).max(axis=(0, 2)).argmax()
    begin = min(data.time[largest] - 0.5 * SHOWN_S, data.time[-1] - SHOWN_S)
    begin = max(float(begin), 0.0)
    shown: BoolArray = (data.time >= begin) & (data.time <= begin + SHOWN_S)
    return shown


def _spectrum(data: WindFigureData, k: int) -> Panel:
    symbol = COMPONENTS[k][1]
    moving = np.where(data.psd > 0.0, data.psd, np.nan)
    lines = [
        Line(
            data.frequency_hz,
            moving[probe, k],
            colour,
            width=1.3,
            marker=marker,
            marker_phase=probe / len(data.names),
        )
        for probe, (colour, marker) in zip(range(len(data.names)), PROBES, strict=False)
    ]
    bands, limits = [], None
    if np.isfinite(moving[:, k]).any():  # below are rounding errors
        peak = float(np.nanmax(moving[:, k]))
        limits = (1e-8 * peak, 3.0 * peak)
    if data.psd_expected is not None and data.psd_expected[0][k].all():
        line, band = _closed_form(data, data.psd_expected, k)
        limits = (0.1 * float(band.low.min()), 3.0 * float(band.high.max()))  # spectra fall below
        lines.append(line)
        bands.append(band)
    return Panel(
        "",
        FREQUENCY,
        f"spectrum of {symbol}, (m/s)²/Hz",
        lines,
        bands,
        x_log=True,
        y_log=True,
        x_limits=_frequencies(data),
        y_limits=limits,
        spans=_unresolved(data, named=k == 0),
        note=f"{symbol} does not vary",
    )


def _frequencies(data: WindFigureData) -> tuple[float, float]:
    return float(data.frequency_hz[0]), float(data.frequency_hz[-1])


def _closed_form(
    data: WindFigureData, expected: tuple[Array, Array, Array], k: int
) -> tuple[Line, Band]:
    """Draw the closed form of a component with the band of its estimates."""
    closed, low, high = (each[k] for each in expected)
    return (
        Line(data.frequency_hz, closed, BLACK, "closed form", 1.2),
        Band(data.frequency_hz, low, high, GREY, "95 % of estimates"),
    )


def _unresolved(data: WindFigureData, *, named: bool) -> list[Span]:
    """Shade the frequencies at which the closed form has shorter waves than the field."""
    if data.unresolved is None or data.unresolved[0] >= data.frequency_hz[-1]:
        return []
    begin, shortest = data.unresolved
    name = f"no waves below {shortest:.2g} m" if named else ""
    return [Span(begin, float(data.frequency_hz[-1]), name)]


def _coherence(data: WindFigureData, k: int) -> Panel:
    label = f"between the probes, {data.separation:g} m apart"
    lines = [Line(data.frequency_hz, data.coherence[k], GREEN, label, dots=True)]
    bands = []
    if data.coherence_expected is not None:
        line, band = _closed_form(data, data.coherence_expected, k)
        lines.append(line)
        bands.append(band)
    return Panel(
        "",
        FREQUENCY,
        f"coherence of {COMPONENTS[k][1]}, real part",
        lines,
        bands,
        x_log=True,
        x_limits=_frequencies(data),
        y_limits=(-1.05, 1.05),
        note=f"{COMPONENTS[k][1]} does not vary",
    )
