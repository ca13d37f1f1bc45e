"""The figures of a run in their order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from testbed.reports import figures_control_network_wind as other
from testbed.reports import figures_motion as motion
from testbed.reports import figures_paths as paths
from testbed.reports.figure_spec import Figure, FigureSpec, make_figure
from testbed.reports.plot_selection import PlotSelection, select_followers
from testbed.reports.run_data import RunData

Maker = Callable[[RunData, PlotSelection], FigureSpec | None]
MAKERS: Sequence[tuple[str, Maker]] = (
    ("trajectory", paths.trajectory),
    ("first-lap", paths.first_lap),
    ("corner", paths.corner),
    ("altitude", motion.altitude),
    ("relative", motion.relative),
    ("relative-ned", motion.relative_ned),
    ("error", motion.error),
    ("speed", motion.speed),
    ("barrier", motion.barrier),
    ("commands", other.commands),
    ("network", other.network),
    ("wind", other.wind),
    ("estimates", other.estimates),
)


def run_figures(run: RunData) -> Iterator[Figure]:
    """Yield the figures for which the run has data."""
    selection = select_followers(run)
    info = run.log.info
    part = f" · {run.part}" if run.part else ""
    subtitle = f"{info.scenario_name} · {run.outcome} · seed {info.seed}{part}"
    for name, make in MAKERS:
        # numbers of an aircraft beyond the range of its model can be infinite
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            spec = make(run, selection)
        if spec is not None:
            note = selection.note if spec.needs_selection_note else ""
            yield make_figure(name, spec, subtitle, note)
