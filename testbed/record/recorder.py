"""The observer that writes the log of a run."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from testbed.frames import geodetic_from_ned, quaternion_xyzw
from testbed.record.door import LogError, LogFile, Write
from testbed.record.header import to_json
from testbed.record.messages import BELIEVED, ESTIMATE, LOG_SCHEMA, NETWORK, TOPICS
from testbed.record.rows import Rows, all_delivered, says_more
from testbed.record.transforms import Transforms
from testbed.record.wire import layout
from testbed.state import Event, Frame, RunInfo

SCENARIO_NAME, INFO_NAME, METRICS_NAME = "scenario.resolved.yaml", "run.json", "metrics.json"
CODE_ENDING = ".py"  # of what is attached as code that the page names
FIX_HZ = 5
FLUSH_S = 0.35  # of wall-clock time, at the latest: a kill loses less than half a second
_CHUNK_AIRCRAFT_FRAMES = 800
_WALL_CLOCK = ("wall_s", "real_time_factor")
_NS = 10**9
# NED in the east-north-up world that viewers draw with z up
_ENU_FROM_NED = np.array([[[0.0, 0.0, 0.0, 0.5**0.5, 0.5**0.5, 0.0, 0.0]]])


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

    borrows = True  # a frame is copied at once

    def __init__(self, path: Path) -> None:
        """See the class."""
        self._path = path
        self._file: LogFile | None = None

    def begin(self, info: RunInfo) -> None:
        """Create the file and write what is known before the first frame."""
        file = LogFile(self._path)
        self._info = info
        page = info.scenario_yaml.encode()
        file.metadata("testbed", _metadata(info, hashlib.sha256(page).hexdigest()))
        file.attachment(SCENARIO_NAME, "application/yaml", page)
        for name, code in info.code.items():
            file.attachment(name, "text/x-python", code)
        file.attachment(INFO_NAME, "application/json", to_json(info).encode())
        file.flush()
        self._open_streams(file, info.names)
        frames = chunk_frames(len(info.names))
        self._rows = Rows(frames=frames, aircraft=len(info.names))
        self._events: list[tuple[int, Event]] = []  # with the row they come after
        self._written = 0  # frames
        self._fix_stride = max(1, round(info.frame_rate_hz / FIX_HZ))
        self._flushed = time.monotonic()
        self._file = file

    def observe(self, frame: Frame) -> None:
        """Take a frame; write the chunk when it is full or old."""
        rows = self._rows
        rows.append(frame)
        if frame.events:
            self._events.extend((len(rows), event) for event in frame.events)
        if rows.full or time.monotonic() - self._flushed > FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Put everything seen so far into the file."""
        file, rows = self._file, self._rows
        if file is not None and (rows or self._events):
            self._write_rows()
            try:
                file.flush()
            except LogError:
                self._file = None  # it has closed itself after its last whole record
                raise
            rows.clear()
            self._events = []
        self._flushed = time.monotonic()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Write the last frames, the events after them and the metrics; finish the file.

        The metrics are attached without wall-clock times, which differ from run to run.
        """
        file = self._file
        if file is None:
            return
        self._events.extend((len(self._rows), event) for event in events)
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

    def _open_streams(self, file: LogFile, names: tuple[str, ...]) -> None:
        self._tf, self._tf_static = file.transforms("/tf"), file.transforms("/tf_static")
        self._poses = Transforms("ned", names)
        self._event = file.events("/events")
        self._fixes = [file.fixes(f"/{name}/fix", name) for name in names]
        self._topics = {
            topic: (
                layout(topic, len(names)),
                [
                    file.topic(f"/{name}/{topic.name}", topic)
                    for name in (names[1:] if topic.followers_only else names)
                ],
            )
            for topic in TOPICS
        }

    def _write_rows(self) -> None:
        """The frames in the rows, one after the other, with the events between them."""
        count, columns = len(self._rows), self._rows.columns()
        time_ns = [tick * _NS // self._info.base_rate_hz for tick in self._rows.tick]
        unwritten = [topic for topic in (ESTIMATE, BELIEVED) if not says_more(topic, columns)]
        if all_delivered(columns):  # once a message is lost, no later count is as it was sent
            unwritten.append(NETWORK)
        writes: list[Write] = []
        encoded: list[list[list[bytes]]] = []
        for topic, (kind, streams) in self._topics.items():
            if topic not in unwritten:
                writes += streams
                encoded.append(kind.encode(columns))
        messages = [list(chain.from_iterable(parts)) for parts in zip(*encoded, strict=True)]
        positions = columns["truth.position_ned"]
        quaternions = quaternion_xyzw(columns["truth.euler"])
        poses = np.concatenate([positions, quaternions], axis=-1)
        transforms = self._poses.encode(poses, np.array(time_ns, dtype=np.int64))
        fixing = range(-self._written % self._fix_stride, count, self._fix_stride)
        places = geodetic_from_ned(positions[fixing.start :: fixing.step], self._info.origin)
        fixed = dict(zip(fixing, places.tolist(), strict=True))
        if not self._written and time_ns:
            at = np.array(time_ns[:1], dtype=np.int64)
            (static,) = Transforms("enu", ("ned",)).encode(_ENU_FROM_NED, at)
            self._tf_static(static, time_ns[0])
        for row, stamp in enumerate(time_ns):
            self._write_events(row)
            self._tf(transforms[row], stamp)
            for write, message in zip(writes, messages[row], strict=True):
                write(message, stamp)
            for fix, place in zip(self._fixes, fixed.get(row, ()), strict=False):
                fix(place, stamp)
        self._write_events(count)
        self._written += count

    def _write_events(self, after: int) -> None:
        for row, event in self._events:
            if row == after:
                self._event(event)


def chunk_frames(aircraft: int) -> int:
    """Frames in a chunk of a run that is not slow."""
    return min(max(_CHUNK_AIRCRAFT_FRAMES // aircraft, 10), 200)


def _metadata(info: RunInfo, scenario_sha256: str) -> dict[str, str]:
    versions = {f"version.{name}": value for name, value in info.versions.items()}
    return {
        "log_schema": str(LOG_SCHEMA),
        "scenario": info.scenario_name,
        "scenario_sha256": scenario_sha256,
        "seed": str(info.seed),
        **versions,
    }
