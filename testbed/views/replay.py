"""Recorded runs in a viewer: one of them, or two over one another."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from testbed.errors import InputError
from testbed.state import Event, RunInfo
from testbed.views.batch import Batch, Source, beside, parts, whole
from testbed.views.scene import Scene, scene_of, together
from testbed.views.sinks import Outlet, Sink

BATCH_FRAMES = 1000
LABELS = ("A", "B")  # of two runs


class Recorded(Source, Protocol):
    """A log read back, such as `testbed.record.read.Log`."""

    @property
    def info(self) -> RunInfo: ...  # noqa: D102
    @property
    def events(self) -> tuple[Event, ...]: ...  # noqa: D102


def replay(sink: Sink, first: Recorded, second: Recorded | None = None) -> None:
    """Show one run, or two over one another, as fast as the sink takes them.

    Raises:
        InputError: two runs have no time in common.
        OSError: an .rrd file cannot be written.
    """
    still, batch = shown(first, second)
    outlet = sink.open(still)
    if outlet is not None:
        send(outlet, batch)
        outlet.close()


def shown(first: Recorded, second: Recorded | None = None) -> tuple[Scene, Batch]:
    """What is drawn of one run, or of two at the times that both have.

    Raises:
        InputError: they have none in common.
    """
    still, batch = _of(first)
    if second is None:
        return still, batch
    other, others = _of(second)
    batch = beside(batch, others, LABELS)
    if len(batch) < 2:
        raise InputError("the two runs have no frames at the same times: nothing to lay over")
    begin, step = float(batch.time[0]), float(np.median(np.diff(batch.time)))
    both = replace(together(still, other, LABELS), frame_rate_hz=1.0 / step)
    who = [
        Event(begin, "info", label, f"is {each.title}")
        for label, each in zip(LABELS, (still, other), strict=True)
    ]
    return both, replace(batch, events=(*who, *batch.events))


def _of(run: Recorded) -> tuple[Scene, Batch]:
    batch = whole(run, run.events)
    # of logs that do not say it, too
    estimated = not np.array_equal(batch.believed, batch.position, equal_nan=True)
    return replace(scene_of(run.info), estimated=estimated), batch


def send(outlet: Outlet, batch: Batch) -> None:
    """Send a long batch in pieces."""
    for part in parts(batch, BATCH_FRAMES):
        outlet.send(part)
