"""Recorded runs in a viewer: one of them, or two over one another."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

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
    scene, batch = scene_of(first.info), whole(first, first.events)
    if second is None:
        return scene, batch
    scenes = scene, scene_of(second.info)
    batch = beside(batch, whole(second, second.events), LABELS)
    if not len(batch):
        raise InputError("the two runs have no frame at the same time: nothing to lay over")
    begin = float(batch.time[0])
    who = [
        Event(begin, "info", label, f"is {still.title}")
        for label, still in zip(LABELS, scenes, strict=True)
    ]
    return together(*scenes, LABELS), replace(batch, events=(*who, *batch.events))


def send(outlet: Outlet, batch: Batch) -> None:
    """Send a long batch in pieces."""
    for part in parts(batch, BATCH_FRAMES):
        outlet.send(part)
