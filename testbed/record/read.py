"""Logs as labelled arrays, and as the frames that observers saw live."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from testbed.errors import InputError
from testbed.record import door
from testbed.record.door import Contents, LogError
from testbed.record.header import from_json
from testbed.record.messages import LOG_SCHEMA, STATE, TOPICS, Topic
from testbed.record.recorder import CODE_ENDING, INFO_NAME, METRICS_NAME
from testbed.record.rundir import SCENARIO_NAME
from testbed.record.wire import layout
from testbed.rows import WHOLE
from testbed.scenario import Scenario, loads
from testbed.state import (
    AirData,
    Array,
    Event,
    FbwaCommand,
    FormationState,
    Frame,
    LinkCounts,
    Observer,
    RunInfo,
    Surfaces,
    Truths,
    VehicleState,
    listed,
)

_NS = 10**9
_RecordT = TypeVar("_RecordT")


@dataclass(frozen=True, slots=True)
class Log:
    """A run read back: as in a `Frame`, with K frames on the axis before the agents'."""

    info: RunInfo
    metadata: Mapping[str, str]
    tick: np.ndarray[Any, np.dtype[np.int64]]  # (K,) of the base rate
    time_s: Array  # (K,)
    truth: VehicleState  # (K, N, ...)
    estimate: VehicleState  # (K, N, ...)
    air: AirData  # (K, N, ...)
    command: FbwaCommand  # (K, N)
    surfaces: Surfaces  # (K, N)
    formation: FormationState  # (K, n, ...)
    links: LinkCounts  # (K, n, N) zero in frames before the log tells of them
    lost: Truths  # (K, N)
    events: tuple[Event, ...]
    metrics: Mapping[str, Any] | None  # None: the run did not come to its end
    finished: bool  # False: the writer never closed the file
    lost_bytes: int  # of a record cut short at the end

    def __repr__(self) -> str:
        """How much of what there is."""
        records = "truth, estimate, air, command, surfaces, formation, links, lost"
        ended = "" if self.finished else ", cut short"
        count = len(self.events)
        events = f"{count} event{'s' * (count != 1)}{ended}"
        return f"<Log of {self.info.scenario_name}: {records} of {self.size}; {events}>"

    @property
    def size(self) -> str:
        """Frames, seconds and aircraft in words."""
        last = f", {self.time_s[-1] - self.time_s[0]:g} s" if self.time_s.size else ""
        return f"{self.time_s.size} frames{last}, of {listed(self.info.names)}"


def read_log(path: Path) -> Log:
    """Read a log; of one that was cut short, everything up to the cut.

    Raises:
        LogError: No log of ours, or damaged before its end.
    """
    contents = door.read(path)
    info = _info(path, contents)
    state = contents.messages.get(f"/{info.names[0]}/{STATE.name}")
    tick = _ticks(state.time_ns if state else [], info)
    columns: dict[str, Any] = {}
    for topic in TOPICS:
        columns |= _columns(path, contents, topic, info, tick, columns)
    for source, kind in WHOLE.items():
        # a bit set of a frame that is not there reads as nothing set, a count as none
        columns[source] = np.nan_to_num(columns[source]).astype(kind)
    truth = _assemble(VehicleState, "truth", columns)
    estimate = _assemble(VehicleState, "estimate", columns)
    metrics = contents.attachments.get(METRICS_NAME)
    return Log(
        info=info,
        metadata=contents.metadata.get("testbed", {}),
        tick=tick,
        time_s=tick / info.base_rate_hz,
        truth=truth,
        estimate=truth if _same(estimate, truth) else estimate,
        air=_assemble(AirData, "air", columns),
        command=_assemble(FbwaCommand, "command", columns),
        surfaces=_assemble(Surfaces, "surfaces", columns),
        formation=_assemble(FormationState, "formation", columns),
        links=_assemble(LinkCounts, "links", columns),
        lost=columns["lost"],
        events=_events(path, contents),
        metrics=None if metrics is None else _json(path, METRICS_NAME, metrics),
        finished=contents.finished,
        lost_bytes=contents.lost_bytes,
    )


def frames(log: Log) -> Iterator[Frame]:
    """The frames of a log in order, for the observers that watch runs.

    An event comes with the first frame that is not before it; those after the last frame are
    left to `end`, as in a run.
    """
    exact = log.estimate is log.truth
    events = sorted(log.events, key=lambda event: event.time_s)
    taken = 0
    for k in range(log.tick.size):
        time_s = float(log.time_s[k])
        first = taken
        while taken < len(events) and events[taken].time_s <= time_s:
            taken += 1
        truth = _at(log.truth, k)
        yield Frame(
            tick=int(log.tick[k]),
            time_s=time_s,
            truth=truth,
            estimate=truth if exact else _at(log.estimate, k),
            air=_at(log.air, k),
            command=_at(log.command, k),
            surfaces=_at(log.surfaces, k),
            formation=_at(log.formation, k),
            links=_at(log.links, k),
            lost=log.lost[k],
            events=tuple(events[first:taken]),
        )


def replay(log: Log, watchers: Sequence[Observer]) -> list[Event]:
    """Show a log to observers of runs, which are left to be ended; the events after its frames."""
    for watcher in watchers:
        watcher.begin(log.info)
    shown = 0
    for frame in frames(log):
        for watcher in watchers:
            watcher.observe(frame)
        shown += len(frame.events)
    return sorted(log.events, key=lambda event: event.time_s)[shown:]


def page_of(log: Log) -> Scenario | None:
    """The page as flown; None: it is of another version."""
    try:
        return loads(log.info.scenario_yaml, look=False)
    except InputError:
        return None


def _at(record: _RecordT, k: int) -> _RecordT:
    """One frame of a record of stacked arrays."""
    kind = type(record)
    return kind(**{name: getattr(record, name)[k] for name in kind.__annotations__})


def _info(path: Path, contents: Contents) -> RunInfo:
    found = contents.metadata.get("testbed")
    if contents.begun and not contents.finished and INFO_NAME not in contents.attachments:
        raise LogError(f"{path}: {door.NOTHING}")
    if found is None or INFO_NAME not in contents.attachments:
        raise LogError(f"{path}: an MCAP file, but not a log of a testbed run")
    if found.get("log_schema") != str(LOG_SCHEMA):
        raise LogError(
            f"{path}: log schema {found.get('log_schema')}, but this version reads {LOG_SCHEMA};"
            f" it was written by testbed {found.get('version.testbed', 'of unknown version')}"
        )
    try:
        return from_json(
            contents.attachments[INFO_NAME].decode(),
            scenario_yaml=contents.attachments.get(SCENARIO_NAME, b"").decode(),
            code={n: data for n, data in contents.attachments.items() if n.endswith(CODE_ENDING)},
        )
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error


def _ticks(time_ns: list[int], info: RunInfo) -> Any:  # noqa: ANN401
    """Ticks of the base rate: the times are these, cut to whole nanoseconds."""
    return np.rint(np.array(time_ns, dtype=np.float64) * info.base_rate_hz / _NS).astype(np.int64)


def _columns(
    path: Path,
    contents: Contents,
    topic: Topic,
    info: RunInfo,
    tick: np.ndarray[Any, Any],
    others: Mapping[str, Array],
) -> dict[str, Array]:
    """The arrays (K, agents[, components]) of a topic by source.

    Where there is nothing they are those of the other topics that stand for them, or nan.
    """
    agents = info.names[1:] if topic.followers_only else info.names
    found = [contents.messages.get(f"/{agent}/{topic.name}") for agent in agents]
    instead = {c.source: others[c.unwritten] for c in topic.columns if c.unwritten}
    if instead and not any(each and each.time_ns for each in found):
        return instead
    kind = layout(topic, len(info.names))
    out: dict[str, Array] = {}
    for column in topic.columns:
        components = len(info.names) if column.per_aircraft else len(column.names)
        shape = (tick.size, len(agents), components)
        same = instead.get(column.source)
        out[column.source] = np.full(shape, np.nan) if same is None else same.reshape(shape).copy()
    for i, (agent, messages) in enumerate(zip(agents, found, strict=True)):
        if messages is None or not tick.size:
            continue
        own = _ticks(messages.time_ns, info)
        at = np.searchsorted(tick, own)
        known = tick[np.minimum(at, tick.size - 1)] == own
        try:
            values = kind.decode(messages.data)
        except ValueError as error:
            raise LogError(f"{path}: /{agent}/{topic.name}: {error}") from error
        for source, array in out.items():
            array[at[known], i] = values[source][known]
    for column in topic.columns:
        if len(column.names) == 1 and not column.per_aircraft:
            out[column.source] = out[column.source][..., 0]
    return out


def _assemble(kind: type[_RecordT], name: str, columns: Mapping[str, Array]) -> _RecordT:
    return kind(**{field: columns[f"{name}.{field}"] for field in kind.__annotations__})


def _same(one: VehicleState, other: VehicleState) -> bool:
    """Whether these are the same arrays, because nothing was written of one of them."""
    return all(ours is theirs for ours, theirs in zip(one, other, strict=True))


def _events(path: Path, contents: Contents) -> tuple[Event, ...]:
    found = contents.messages.get("/events")
    if found is None:
        return ()
    out = []
    for stamp, payload in zip(found.time_ns, found.data, strict=True):
        try:
            level, text, source = door.log_fields(payload)
        except ValueError as error:
            raise LogError(f"{path}: /events: {error}") from error
        out.append(Event(stamp / _NS, level, source, text))
    return tuple(out)


def _json(path: Path, name: str, data: bytes) -> dict[str, Any]:
    try:
        return dict(json.loads(data))
    except ValueError as error:
        raise LogError(f"{path}: {name}: {error}") from error
