"""A layout of PlotJuggler for the log of a run: `plotjuggler --layout run.plotjuggler.xml`.

PlotJuggler names what it finds in protobuf `<topic>/<field>`, and `<topic>/<field>[k]` in lists.
A layout that names its data file loads it, without a dialogue that asks for topics; the topics are
those of numbers alone, for older releases take any field called `timestamp` for a number.
"""

from __future__ import annotations

import xml.etree.ElementTree as xml
from collections.abc import Sequence

import numpy as np

from testbed.record.flight import Flight
from testbed.views.log_plots import Curve, Page, Plot, pages, topics

_MARGIN = 0.05  # of the range, above and below


def plotjuggler_layout(flight: Flight, log: str) -> str:
    """The text of the layout.

    Args:
        flight: the run, for the ranges of its numbers.
        log: path of the log, absolute or from the layout's folder.
    """
    root = xml.Element("root")
    window = {"name": "Main Window", "parent": "main_window"}
    main = xml.SubElement(root, "tabbed_widget", window)
    for page in pages(flight.names):
        _tab(main, page, flight)
    xml.SubElement(main, "currentTabIndex", index="0")
    xml.SubElement(root, "use_relative_time_offset", enabled="0")
    # as a plugin's default, and for the file
    _reader(xml.SubElement(root, "Plugins"), topics(flight.names))
    files = xml.SubElement(root, "previouslyLoaded_Datafiles")
    file = xml.SubElement(files, "fileInfo", filename=log, prefix="")
    _reader(file, topics(flight.names))
    xml.indent(root)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{xml.tostring(root, encoding='unicode')}\n"


def series_name(curve: Curve) -> str:
    """What PlotJuggler calls a curve's numbers: /uav1/formation/age_s[0]."""
    place = "" if curve.index is None else f"[{curve.index}]"
    return f"{curve.topic}/{curve.field}{place}"


def _tab(main: xml.Element, page: Page, flight: Flight) -> None:
    count = len(page.plots)
    tab = xml.SubElement(main, "Tab", tab_name=page.title, containers="1")
    splitter = xml.SubElement(
        xml.SubElement(tab, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(count),
        sizes=";".join([f"{1 / count:.6f}"] * count),
    )
    for plot in page.plots:
        area = xml.SubElement(splitter, "DockArea", name=plot.title)
        drawn = xml.SubElement(
            area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false"
        )
        xml.SubElement(drawn, "range", _range(plot, flight))
        xml.SubElement(drawn, "limitY")
        for curve in plot.curves:
            xml.SubElement(drawn, "curve", name=series_name(curve), color=curve.colour)


def _range(plot: Plot, flight: Flight) -> dict[str, str]:
    """The window that shows all curves."""
    low, high = np.inf, -np.inf
    for curve in plot.curves:
        name, topic = curve.topic.strip("/").split("/")
        values = flight[f"{topic}_{curve.field}"][:, flight.names.index(name)]
        values = values if curve.index is None else values[:, curve.index]
        finite = values[np.isfinite(values)]
        low, high = min(low, finite.min(initial=low)), max(high, finite.max(initial=high))
    if low > high:
        low, high = 0.0, 1.0
    margin = _MARGIN * (high - low) or 1.0
    end = flight.time_s[-1] if flight.time_s.size else 1.0
    sides = {"left": 0.0, "right": end, "bottom": low - margin, "top": high + margin}
    return {side: f"{value:.6f}" for side, value in sides.items()}


def _reader(parent: xml.Element, selected: Sequence[str]) -> None:
    """How the log is to be read: these topics, at the times of the log."""
    plugin = xml.SubElement(parent, "plugin", ID="DataLoad MCAP")
    xml.SubElement(
        plugin,
        "parameters",
        use_timestamp="0",
        use_mcap_log_time="1",
        clamp_large_arrays="0",
        max_array_size="500",
        selected_topics=";".join(selected),
    )
