"""Read logs back as stacked arrays, and as the samples that observers saw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from testbed.core.errors import InputError
from testbed.core.input_files import parse_json_map
from testbed.core.records import (
    ActuatorCommand,
    AirData,
    Array,
    BoolArray,
    Event,
    FbwaCommand,
    FormationState,
    LinkCounters,
    Observer,
    RunInfo,
    Sample,
    VehicleState,
    join_names,
)
from testbed.logs import mcap_file
from testbed.logs.header import CODE_SUFFIX, INFO_NAME, METADATA_NAME, from_json
from testbed.logs.mcap_file import LogError, McapContents
from testbed.logs.messages import LOG_SCHEMA, RECORDS, STATE, Topic, topics_of
from testbed.logs.proto_template import IntArray, topic_template
from testbed.logs.run_directory import METRICS_NAME, SCENARIO_NAME
from testbed.scenario import Scenario, loads

if TYPE_CHECKING:  # the package loads compiled functions, which a reader of logs does not need
    from testbed.metrics.model import Metrics

_NS = 10**9
# Values of all samples: this number, and more for each byte of messages. Logs have 1 per byte.
_MIN_VALUES, _MAX_VALUES_PER_BYTE = 10_000_000, 8
_RECORD_NAMES = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")


@dataclass(frozen=True, slots=True)
class RunLog:
    """A log that was read: records of a `Sample` with K leading samples."""

    info: RunInfo
    metadata: Mapping[str, str]
    tick: IntArray  # (K,) of the base rate
    time_s: Array  # (K,)
    truth: VehicleState  # (K, N, ...)
    estimate: VehicleState  # (K, N, ...) `truth` itself if all estimates are exact
    air: AirData  # (K, N, ...)
    command: FbwaCommand[Array]  # (K, N)
    surfaces: ActuatorCommand  # (K, N)
    formation: FormationState  # (K, n, ...)
    links: LinkCounters  # (K, n, N) zero in samples before the log counts messages
    lost: BoolArray  # (K, N)
    law: Array | None  # (K, n, L) numbers of a user's law, (K, n) where there is one; None: none
    events: tuple[Event, ...]
    metrics: Metrics | None  # None: missing or empty, the run was cut short
    finished: bool  # False: the writer did not close the file
    lost_bytes: int  # of an incomplete record at the end

    def __repr__(self) -> str:
        """Name the run, its size and its records."""
        records = "truth, estimate, air, command, surfaces, formation, links, lost"
        ended = "" if self.finished else ", cut short"
        count = len(self.events)
        events = f"{count} event{'s' * (count != 1)}{ended}"
        return f"<Log of {self.info.scenario_name}: {records} of {self.size}; {events}>"

    @property
    def time_ns(self) -> IntArray:
        """Times of the samples (K,) since 1970 (UTC), ns."""
        return self.info.start_unix_ns + self.tick * _NS // self.info.base_rate_hz

    @property
    def size(self) -> str:
        """Samples, seconds and aircraft in words."""
        last = f", {self.time_s[-1] - self.time_s[0]:g} s" if self.time_s.size else ""
        return f"{self.time_s.size} samples{last}, of {join_names(self.info.names)}"


def read_log(path: Path) -> RunLog:
    """Read a log; of one that was cut short, everything up to the cut.

    Raises:
        LogError: Not a log of this schema, or damaged before its end.
    """
    contents = mcap_file.read(path)
    info = _run_info(path, contents)
    state = contents.messages.get(f"/{info.names[0]}/{STATE.name}")
    tick = _ticks(state.time_ns if state else [], info)
    if np.any(np.diff(tick) <= 0):
        raise LogError(f"{path}: /{info.names[0]}/{STATE.name}: times do not increase")
    _refuse_size(path, contents, tick.size, info)
    columns: dict[str, Any] = {}
    for topic in topics_of(info.law_numbers):
        columns |= _read_columns(path, contents, topic, info, tick, columns)
    records = {name: _record(name, columns) for name in _RECORD_NAMES}
    truth, estimate = records["truth"], records["estimate"]
    if all(one is other for one, other in zip(estimate, truth, strict=True)):
        records["estimate"] = truth
    attached = contents.attachments.get(METRICS_NAME)
    metrics = _json(path, METRICS_NAME, attached) if attached else None
    return RunLog(
        info=info,
        metadata=contents.metadata.get(METADATA_NAME, {}),
        tick=tick,
        time_s=tick / info.base_rate_hz,
        **records,
        lost=columns["lost"],
        law=columns.get("law"),
        events=_events(path, contents, info.start_unix_ns),
        metrics=cast("Metrics | None", metrics or None),  # not checked: see metrics.document_check
        finished=contents.finished,
        lost_bytes=contents.lost_bytes,
    )


def samples(log: RunLog) -> Iterator[Sample]:
    """Iterate over the samples of a log, as observers of the run saw them.

    An event comes with the first sample at or after its time; events after the last sample are
    left out, as `Observer.end` gets them.
    """
    events = sorted(log.events, key=lambda event: event.time_s)
    used = 0
    for k in range(log.tick.size):
        time_s = float(log.time_s[k])
        first = used
        while used < len(events) and events[used].time_s <= time_s:
            used += 1
        yield Sample(
            tick=int(log.tick[k]),
            time_s=time_s,
            **_records_at(log, k),
            lost=log.lost[k],
            law=None if log.law is None else log.law[k],
            events=tuple(events[first:used]),
        )


def select_window(log: RunLog, begin_s: float, end_s: float) -> RunLog:
    """Select the samples and events of a log from `begin_s` to `end_s`, both included.

    Raises:
        LogError: the window has no samples.
    """
    first, last = np.searchsorted(log.time_s, (begin_s, np.nextafter(end_s, np.inf))).tolist()
    if first >= last:
        raise LogError(
            "there are no samples between the chosen times (write times between "
            f"{log.time_s[0]:g} and {log.time_s[-1]:g} s)"
        )
    rows = slice(first, last)
    return replace(
        log,
        **{name: getattr(log, name)[rows] for name in ("tick", "time_s", "lost")},
        **_records_at(log, rows),
        law=None if log.law is None else log.law[rows],
        events=tuple(event for event in log.events if begin_s <= event.time_s <= end_s),
    )


def replay(log: RunLog, observers: Sequence[Observer]) -> list[Event]:
    """Show a log to observers, without `end`; return the events after its last sample."""
    for observer in observers:
        observer.begin(log.info)
    shown = 0
    for sample in samples(log):
        for observer in observers:
            observer.observe(sample)
        shown += len(sample.events)
    return sorted(log.events, key=lambda event: event.time_s)[shown:]


def scenario_of(log: RunLog) -> Scenario | None:
    """Load the scenario as flown; None if this version does not accept it."""
    try:
        return loads(log.info.scenario_yaml, check_files=False)
    except InputError:
        return None


def _records_at(log: RunLog, k: int | slice) -> dict[str, Any]:
    """Take sample k, or the samples of a slice, of all records; `estimate` stays `truth`."""
    found = {}
    for name in _RECORD_NAMES:
        record = getattr(log, name)
        found[name] = type(record)(*(each[k] for each in record))
    if log.estimate is log.truth:
        found["estimate"] = found["truth"]
    return found


def _run_info(path: Path, contents: McapContents) -> RunInfo:
    metadata = contents.metadata.get(METADATA_NAME)
    complete = INFO_NAME in contents.attachments
    if contents.own_header and not contents.finished and not complete:
        raise LogError(f"{path}: {mcap_file.NO_SAMPLES}")
    if metadata is None or not complete:
        raise LogError(f"{path}: an MCAP file, but not a log of a testbed run")
    if metadata.get("log_schema") != str(LOG_SCHEMA):
        version = metadata.get("version.testbed", "of unknown version")
        raise LogError(
            f"{path}: log schema {metadata.get('log_schema')} of testbed {version}; this version"
            f" reads schema {LOG_SCHEMA} only: read the log with the version that wrote it"
        )
    attached = contents.attachments
    try:
        return from_json(
            attached[INFO_NAME].decode(),
            scenario_yaml=attached.get(SCENARIO_NAME, b"").decode(),
            code={name: data for name, data in attached.items() if name.endswith(CODE_SUFFIX)},
        )
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error


def _refuse_size(path: Path, contents: McapContents, count: int, info: RunInfo) -> None:
    """Refuse samples whose arrays are much larger than the messages they come from.

    Raises:
        LogError: With both numbers.
    """
    aircraft = len(info.names)
    per_aircraft = sum(
        aircraft if column.per_aircraft else len(column.names)
        for topic in topics_of(info.law_numbers)
        for column in topic.columns
    )
    values = count * aircraft * per_aircraft
    messages = sum(len(data) for each in contents.messages.values() for data in each.data)
    if values > _MIN_VALUES + _MAX_VALUES_PER_BYTE * messages:
        raise LogError(
            f"{path}: {count:,} samples of {aircraft:,} aircraft have {values:,} values, too many"
            f" for {messages:,} bytes of messages"
        )


def _ticks(time_ns: list[int], info: RunInfo) -> IntArray:
    """Ticks of the base rate; the times are these, rounded down to whole nanoseconds."""
    since_start = [stamp - info.start_unix_ns for stamp in time_ns]
    return np.rint(np.array(since_start, dtype=np.float64) * info.base_rate_hz / _NS).astype(
        np.int64
    )


def _read_columns(
    path: Path,
    contents: McapContents,
    topic: Topic,
    info: RunInfo,
    tick: IntArray,
    others: Mapping[str, Array],
) -> dict[str, Array]:
    """Decode the arrays (K, agents[, components]) of a topic, by source.

    Samples without a message get the values of the column's default source, or NaN.
    """
    agents = info.names[1:] if topic.followers_only else info.names
    found = [contents.messages.get(f"/{agent}/{topic.name}") for agent in agents]
    defaults = {c.source: others[c.default_source] for c in topic.columns if c.default_source}
    if defaults and not any(each and each.time_ns for each in found):
        return defaults
    template = topic_template(topic, info.names)
    out: dict[str, Array] = {}
    for column in topic.columns:
        components = len(info.names) if column.per_aircraft else len(column.names)
        shape = (tick.size, len(agents), components)
        default = defaults.get(column.source)
        out[column.source] = (
            np.full(shape, np.nan) if default is None else default.reshape(shape).copy()
        )
    for i, (agent, messages) in enumerate(zip(agents, found, strict=True)):
        if messages is None or not tick.size:
            continue
        own = _ticks(messages.time_ns, info)
        rows = np.searchsorted(tick, own)
        known = tick[np.minimum(rows, tick.size - 1)] == own
        try:
            values = template.decode(messages.data)
        except ValueError as error:
            raise LogError(f"{path}: /{agent}/{topic.name}: {error}") from error
        for source, array in out.items():
            array[rows[known], i] = values[source][known]
    for column in topic.columns:
        array = out[column.source]
        if len(column.names) == 1 and not column.per_aircraft:
            array = array[..., 0]
        if column.dtype != "f8":
            # in samples without a message no bit is set and no message counted
            array = np.nan_to_num(array).astype(column.dtype)
        out[column.source] = array
    return out


def _record(name: str, columns: Mapping[str, Array]) -> Any:  # noqa: ANN401 - a named tuple
    kind = RECORDS[name]
    return kind(*(columns[f"{name}.{field}"] for field in kind._fields))


def _events(path: Path, contents: McapContents, start_ns: int) -> tuple[Event, ...]:
    found = contents.messages.get("/events")
    if found is None:
        return ()
    try:
        return tuple(
            mcap_file.decode_event(payload, (stamp - start_ns) / _NS)
            for stamp, payload in zip(found.time_ns, found.data, strict=True)
        )
    except ValueError as error:
        raise LogError(f"{path}: /events: {error}") from error


def _json(path: Path, name: str, data: bytes) -> dict[str, Any]:
    try:
        return parse_json_map(data)
    except ValueError as error:
        raise LogError(f"{path}: {name}: {error}") from error
