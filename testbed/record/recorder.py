"""The observer that writes the log of a run."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from testbed.frames import geodetic_from_ned, quaternion_xyzw
from testbed.record.chunk import Sheet, Strip, Whole, strip
from testbed.record.columns import keep, unpack
from testbed.record.door import FIX, LOG, TRANSFORMS, LogError, LogFile, log_line, schema
from testbed.record.header import to_json
from testbed.record.messages import LOG_SCHEMA, TOPICS, Topic
from testbed.record.rundir import SCENARIO_NAME
from testbed.record.transforms import Fixes, Transforms
from testbed.record.wire import layout
from testbed.state import Event, Frame, RunInfo

INFO_NAME, METRICS_NAME = "run.json", "metrics.json"
CODE_ENDING = ".py"  # of what is attached as code that the page names
FIX_HZ = 5
FLUSH_S = 0.35  # of wall-clock time, at the latest: a kill loses less than half a second
_SHORTEST_S = 0.005  # of the thread's sleep
_CHUNK_AIRCRAFT_FRAMES = 800
_WALL_CLOCK = ("wall_s", "real_time_factor")
_NS = 10**9
# NED in the east-north-up world that viewers draw with z up
_ENU_FROM_NED = np.zeros((1, 1, 3)), np.array([[[0.5**0.5, 0.5**0.5, 0.0, 0.0]]])


class McapRecorder:
    """Write a run as MCAP: https://mcap.dev, protobuf, zstd, indexed.

    Chunks end after a number of frames that depends on nothing but the number of aircraft, so the
    same scenario and seed give the same bytes; only a run so slow that such a chunk lasts longer
    than `FLUSH_S` is cut sooner, which changes chunks and no message. A thread sees to that also
    where no frame follows, as when the run waits for a program outside.

    Args:
        path: The file, which must not exist.

    Raises:
        LogError: From all methods: the file cannot be written, or is not there any more.
    """

    borrows = True  # keeps no array of a frame

    def __init__(self, path: Path) -> None:
        """See the class."""
        self._path = path
        self._file: LogFile | None = None
        self._lock = threading.RLock()  # of all that follows
        self._over = threading.Event()
        self._trouble: Exception | None = None  # that the thread met

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
        self._open_streams(file, info.names)
        self._full = chunk_frames(len(info.names))
        self._kept = keep(self._full)
        self._events: list[tuple[int, Event]] = []  # with the row they come after
        self._written = 0  # frames
        self._fix_stride = max(1, round(info.frame_rate_hz / FIX_HZ))
        self._flushed = time.monotonic()
        self._file = file
        threading.Thread(target=self._keep_up, name="log-clock", daemon=True).start()

    def observe(self, frame: Frame) -> None:
        """Take a frame; write the chunk when it is full or old."""
        with self._lock:
            self._complain()
            kept = self._kept
            kept.append(frame)
            count = len(kept.tick)
            if frame.events:
                self._events.extend((count - 1, event) for event in frame.events)
            if count == self._full or time.monotonic() - self._flushed > FLUSH_S:
                self._flush()

    def flush(self) -> None:
        """Have everything seen so far written."""
        with self._lock:
            self._complain()
            self._flush()

    def _keep_up(self) -> None:
        """Write what nobody else has written in time; a thread."""
        left = FLUSH_S
        while not self._over.wait(max(left, _SHORTEST_S)):
            with self._lock:
                if self._file is None:
                    return
                left = self._flushed + FLUSH_S - time.monotonic()
                if left > 0.0:
                    continue
                left = FLUSH_S
                try:
                    self._flush()
                except Exception as error:
                    self._trouble = error  # the next who calls is told
                    return

    def _complain(self) -> None:
        trouble, self._trouble = self._trouble, None
        if trouble is not None:
            raise trouble

    def _flush(self) -> None:
        file = self._file
        if file is not None:
            strips = [*self._strips(file)] if self._kept.tick else []
            if self._events:
                turns, events = zip(*self._events, strict=True)
                time_ns = [round(event.time_s * _NS) for event in events]
                lines = [[log_line(event)] for event in events]
                strips.append(strip([self._event], lines, np.array(time_ns), np.array(turns)))
            try:
                file.write(strips)
            except LogError:
                self._file = None  # it has closed itself after its last whole record
                raise
            self._kept.clear()
            self._events = []
        self._flushed = time.monotonic()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Write the last frames, the events after them and the metrics; finish the file.

        The metrics are attached without wall-clock times, which differ from run to run.
        """
        with self._lock:
            self._complain()
            file = self._file
            if file is None:
                return
            self._events.extend((len(self._kept.tick) - 1, event) for event in events)
            self._flush()
            timeless = {**summary, **{key: None for key in _WALL_CLOCK if key in summary}}
            text = json.dumps(timeless, indent=2, ensure_ascii=False, allow_nan=False)
            file.attachment(METRICS_NAME, "application/json", text.encode())
            self.close()

    def close(self) -> None:
        """Finish the file; for a run that ends without metrics. Harmless when repeated."""
        with self._lock:
            self._over.set()
            self._complain()
            if self._file is not None:
                file = self._file
                self._flush()
                self._file = None
                file.close()

    def _open_streams(self, file: LogFile, names: tuple[str, ...]) -> None:
        self._tf, self._poses = file.stream("/tf", TRANSFORMS), Transforms("ned", names)
        self._event = file.stream("/events", LOG)
        self._fix, self._fixes = [file.stream(f"/{name}/fix", FIX) for name in names], Fixes(names)
        self._topics = {
            topic: (
                layout(topic, len(names)),
                [file.stream(f"/{name}/{topic.name}", schema(topic)) for name in theirs],
            )
            for topic in TOPICS
            if (theirs := names[1:] if topic.followers_only else names)
        }
        self._sheets: dict[tuple[Topic, ...], Sheet] = {}  # by the topics that are in it

    def _strips(self, file: LogFile) -> Iterator[Strip]:
        """The frames that were kept, and what is before them and between them."""
        time_ns = np.array(self._kept.tick, dtype=np.int64) * _NS // self._info.base_rate_hz
        if not self._written:
            static = [file.stream("/tf_static", TRANSFORMS)]
            yield strip(static, [[_static(time_ns[:1])]], time_ns[:1], np.zeros(1, dtype=np.int64))
        columns, told = unpack(self._kept)
        topics = tuple(topic for topic in told if topic in self._topics)
        positions, euler = columns["truth.position_ned"], columns["truth.euler"]
        sheet = self._sheet(topics)
        rows = sheet.blank(len(time_ns))
        transforms, *messages = sheet.messages(rows)
        self._poses.fill(transforms[:, 0], positions, quaternion_xyzw(euler), time_ns)
        for topic, theirs in zip(topics, messages, strict=True):
            self._topics[topic][0].fill(theirs, columns)
        yield sheet.strip(rows, time_ns)
        fixing = slice(-self._written % self._fix_stride, None, self._fix_stride)
        turns = np.arange(len(time_ns))[fixing]
        if turns.size:
            places = geodetic_from_ned(positions[fixing], self._info.origin)
            fixes = self._fixes.encode(places, time_ns[fixing])
            yield strip(self._fix, fixes, time_ns[fixing], turns)
        self._written += len(time_ns)

    def _sheet(self, topics: tuple[Topic, ...]) -> Sheet:
        if topics not in self._sheets:
            kinds = [(self._poses.template, [self._tf])]
            kinds += [(self._topics[t][0].template, self._topics[t][1]) for t in topics]
            self._sheets[topics] = Sheet(kinds)
        return self._sheets[topics]


def _static(time_ns: Whole) -> bytes:
    """The one message of `/tf_static`, sent at this time (1,)."""
    transforms = Transforms("enu", ("ned",))
    octets = np.array([list(transforms.template)], dtype=np.uint8)
    transforms.fill(octets, *_ENU_FROM_NED, time_ns)
    return octets.tobytes()


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
