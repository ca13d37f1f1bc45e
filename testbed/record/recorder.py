"""The observer that writes the log of a run."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from testbed.frames import geodetic_from_ned
from testbed.record import wire
from testbed.record.chunk import Pile
from testbed.record.door import LogError, LogFile
from testbed.record.encode import FixLayout, FrameLayout, Rows
from testbed.record.header import to_json
from testbed.record.messages import (
    COMMAND,
    ESTIMATE,
    FORMATION,
    FRAME_TRANSFORM,
    FRAME_TRANSFORMS,
    LEVELS,
    LINK,
    LOCATION_FIX,
    LOG,
    LOG_SCHEMA,
    QUATERNION,
    STATE,
    TIMESTAMP,
    VECTOR3,
    MessageType,
    Topic,
)
from testbed.state import Event, Frame, RunInfo

SCENARIO_NAME, INFO_NAME, METRICS_NAME = "scenario.resolved.yaml", "run.json", "metrics.json"
FIX_HZ = 5
FLUSH_S = 0.35  # of wall-clock time, at the latest: a kill loses less than half a second
_CHUNK_AIRCRAFT_FRAMES = 200
_WALL_CLOCK = ("wall_s", "real_time_factor")
_NS = 10**9


class McapRecorder:
    """Write a run as MCAP: https://mcap.dev, protobuf, zstd, indexed.

    Chunks end after a number of frames that depends on nothing but the number of aircraft, so the
    same scenario and seed give the same bytes; only a run so slow that such a chunk lasts longer
    than `FLUSH_S` is cut sooner, which changes chunks and no message.

    Args:
        path: The file, which must not exist.

    Raises:
        LogError: From `begin`, `observe` and `end`: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        """See the class."""
        self._path = path
        self._file: LogFile | None = None

    def begin(self, info: RunInfo) -> None:
        """Create the file and write what is known before the first frame."""
        version = info.versions.get("testbed", "")
        file = LogFile(self._path, library=f"testbed {version}".strip())
        self._info = info
        page = info.scenario_yaml.encode()
        file.metadata("testbed", _metadata(info, hashlib.sha256(page).hexdigest()))
        file.attachment(SCENARIO_NAME, "application/yaml", page)
        file.attachment(INFO_NAME, "application/json", to_json(info).encode())
        self._open_channels(file, info.names)
        frames = min(max(_CHUNK_AIRCRAFT_FRAMES // len(info.names), 10), 50)
        self._rows = Rows(frames=frames, aircraft=len(info.names))
        self._events: list[tuple[int, Event]] = []  # with the row they come after
        self._sequence = 0
        self._fix_stride = max(1, round(info.frame_rate_hz / FIX_HZ))
        self._flushed = time.monotonic()
        self._file = file

    def observe(self, frame: Frame) -> None:
        """Take a frame; write the chunk when it is full or old."""
        rows = self._rows
        rows.append(frame)
        if frame.events:
            self._events.extend((rows.filled, event) for event in frame.events)
        if rows.full or time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Put everything seen so far into the file."""
        file, rows = self._file, self._rows
        if file is not None and (rows.filled or self._events):
            try:
                self._write_chunk(file)
            except LogError:
                self._file = None  # it has closed itself after its last whole record
                raise
            rows.filled = 0
            self._events = []
        self._flushed = time.monotonic()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Write the last frames, the events after them and the metrics; finish the file.

        The metrics are attached without wall-clock times, which differ from run to run.
        """
        file = self._file
        if file is None:
            return
        self._events.extend((self._rows.filled, event) for event in events)
        self.flush()
        timeless = {**summary, **{key: None for key in _WALL_CLOCK if key in summary}}
        text = json.dumps(timeless, indent=2, ensure_ascii=False, allow_nan=False)
        file.attachment(METRICS_NAME, "application/json", text.encode())
        self.close()

    def close(self) -> None:
        """Finish the file; for a run that ends without metrics. Harmless when repeated."""
        if self._file is not None:
            file = self._file
            self.flush()
            self._file = None
            file.close()

    def _open_channels(self, file: LogFile, names: tuple[str, ...]) -> None:
        stamped = (TIMESTAMP,)
        transforms = file.schema(
            FRAME_TRANSFORMS, (*stamped, VECTOR3, QUATERNION, FRAME_TRANSFORM, FRAME_TRANSFORMS)
        )
        tf = file.channel("/tf", transforms)
        self._tf_static = file.channel("/tf_static", transforms)
        self._log = file.channel("/events", file.schema(LOG, (*stamped, LOG)))
        fix = file.schema(LOCATION_FIX, (*stamped, LOCATION_FIX))
        fixes = tuple(file.channel(f"/{name}/fix", fix) for name in names)
        self._fixes = FixLayout(names, fixes)

        def channels(kind: MessageType, name: str, of: Sequence[str]) -> tuple[int, ...]:
            number = file.schema(kind, (kind,))
            return tuple(file.channel(f"/{aircraft}/{name}", number) for aircraft in of)

        def topic(kind: Topic) -> tuple[int, ...]:
            return channels(kind.type, kind.name, names[1:] if kind.followers_only else names)

        always = {kind: topic(kind) for kind in (STATE, COMMAND, FORMATION)}
        links = channels(LINK, "link", names[1:])
        also = {**always, ESTIMATE: topic(ESTIMATE)}
        self._layouts = {
            False: FrameLayout(names, tf=tf, topics=always, links=links),
            True: FrameLayout(names, tf=tf, topics=also, links=links),
        }

    def _write_chunk(self, file: LogFile) -> None:
        """The frames in the rows, with what not every frame has between them."""
        rows, count = self._rows, self._rows.filled
        time_ns = _nanoseconds(rows.tick[:count], self._info.base_rate_hz)
        sequence = np.arange(self._sequence, self._sequence + count, dtype=np.uint64)
        layout = self._layouts[rows.estimates_differ()]
        often = layout.encode(rows, sequence=sequence, time_ns=time_ns)
        fixed = np.flatnonzero(sequence % np.uint64(self._fix_stride) == 0)
        places = geodetic_from_ned(rows.positions()[fixed], self._info.origin)
        fixes = self._fixes.encode(places, sequence=sequence[fixed], time_ns=time_ns[fixed])

        pile = Pile()
        fix = iter(fixes)
        fixing = set(fixed.tolist())
        for row in range(count + 1):
            for channel, stamp, payload in self._seldom(row, time_ns):
                record = wire.message(channel, self._sequence + row, stamp, payload)
                pile.single(channel, stamp, record)
            if row in fixing:
                pile.row("fix", next(fix))
            if row < count:
                pile.row("frame", often[row])
        pile.index("frame", layout.channels, layout.offsets, time_ns)
        pile.index("fix", self._fixes.channels, self._fixes.offsets, time_ns[fixed])
        file.chunk(b"".join(pile.parts), span_ns=pile.span_ns(), indexes=pile.indexes())
        self._sequence += count

    def _seldom(self, row: int, time_ns: wire.Times) -> list[tuple[int, int, bytes]]:
        """Channel, time and payload of the events before a row, and of what comes only once."""
        out: list[tuple[int, int, bytes]] = []
        if self._sequence + row == 0 and time_ns.size:
            stamp = int(time_ns[0])
            out.append((self._tf_static, stamp, _enu_from_ned(stamp)))
        for after, event in self._events:
            if after == row:
                stamp = round(event.time_s * _NS)
                level = LEVELS.index(event.level) if event.level in LEVELS else 0
                line = wire.log_line(stamp, level, event.text, event.source)
                out.append((self._log, stamp, line))
        return out


def _metadata(info: RunInfo, scenario_sha256: str) -> dict[str, str]:
    versions = {f"version.{name}": value for name, value in info.versions.items()}
    return {
        "log_schema": str(LOG_SCHEMA),
        "scenario": info.scenario_name,
        "scenario_sha256": scenario_sha256,
        "seed": str(info.seed),
        **versions,
    }


def _nanoseconds(tick: np.ndarray[Any, np.dtype[np.int64]], base_rate_hz: int) -> wire.Times:
    return (tick * _NS // base_rate_hz).astype(np.uint64)


def _enu_from_ned(time_ns: int) -> bytes:
    """The transform that puts NED into the east-north-up world that viewers draw with z up."""
    half = np.sqrt(0.5)
    return wire.transform(time_ns, "enu", "ned", np.zeros(3), np.array([half, half, 0.0, 0.0]))
