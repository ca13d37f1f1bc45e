"""PlotJuggler layout for the log of a run: `plotjuggler --layout run.plotjuggler.xml`.

PlotJuggler names a protobuf field `<topic>/<field>`, that of a nested message
`<topic>/<field>/<field>`. The layout names its data file and topics, so that PlotJuggler loads it
without a dialogue. Only topics of numbers are selected: older releases fail on fields called
`timestamp`.
"""

from __future__ import annotations

import xml.etree.ElementTree as xml
from collections.abc import Sequence

import numpy as np

from testbed.core.identifiers import identifiers
from testbed.logs.flight_data import FlightData
from testbed.views.log_plots import Curve, Plots, numeric_topics, tabs

_NS = 10**9
_MARGIN = 0.05  # of the range, above and below


def plotjuggler_layout(flight: FlightData, log: str) -> str:
    """Return the layout as XML.

    Args:
        flight: the run, for the ranges of the axes.
        log: path of the log, absolute or relative to the layout's folder.
    """
    root = xml.Element("root")
    window = {"name": "Main Window", "parent": "main_window"}
    main = xml.SubElement(root, "tabbed_widget", window)
    for title, plots in tabs(flight.names).items():
        _add_tab(main, title, plots, flight)
    xml.SubElement(main, "currentTabIndex", index="0")
    xml.SubElement(root, "use_relative_time_offset", enabled="0")
    # the plugin's default, and the settings of the file
    _add_reader(xml.SubElement(root, "Plugins"), numeric_topics(flight.names))
    files = xml.SubElement(root, "previouslyLoaded_Datafiles")
    file = xml.SubElement(files, "fileInfo", filename=log, prefix="")
    _add_reader(file, numeric_topics(flight.names))
    xml.indent(root)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{xml.tostring(root, encoding='unicode')}\n"


def series_name(curve: Curve) -> str:
    """Return PlotJuggler's name of a curve: /uav1/formation/age_s/leader."""
    return "/".join(filter(None, [curve.topic, curve.field, curve.about]))


def _add_tab(main: xml.Element, title: str, plots: Plots, flight: FlightData) -> None:
    count = len(plots)
    element = xml.SubElement(main, "Tab", tab_name=title, containers="1")
    splitter = xml.SubElement(
        xml.SubElement(element, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(count),
        sizes=";".join([f"{1 / count:.6f}"] * count),
    )
    for name, curves in plots.items():
        area = xml.SubElement(splitter, "DockArea", name=name)
        drawn = xml.SubElement(
            area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false"
        )
        xml.SubElement(drawn, "range", _range(curves, flight))
        xml.SubElement(drawn, "limitY")
        for curve in curves:
            xml.SubElement(drawn, "curve", name=series_name(curve), color=curve.colour)


def _range(curves: Sequence[Curve], flight: FlightData) -> dict[str, str]:
    low, high = np.inf, -np.inf
    for curve in curves:
        name, _, topic = curve.topic.removeprefix("/").rpartition("/")  # a name may have a /
        values = flight[f"{topic}_{curve.field}"][:, flight.names.index(name)].astype(float)
        if curve.about is not None:
            values = values[:, identifiers(flight.names).index(curve.about)]
        finite = values[np.isfinite(values)]
        low, high = min(low, finite.min(initial=low)), max(high, finite.max(initial=high))
    if low > high:
        low, high = 0.0, 1.0
    margin = _MARGIN * (high - low) or 1.0
    start = flight.info.start_unix_ns / _NS
    end = start + (flight.time_s[-1] if flight.time_s.size else 1.0)
    sides = {"left": start, "right": end, "bottom": low - margin, "top": high + margin}
    return {side: f"{value:.6f}" for side, value in sides.items()}


def _add_reader(parent: xml.Element, selected: Sequence[str]) -> None:
    """Configure the MCAP reader: these topics, at the log times."""
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
