"""The observer that writes the log of a run."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.core.files import replacement
from testbed.core.frames import enu_from_ned, quaternion_xyzw
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import Array, Event, RunInfo, Sample
from testbed.core.samples import BlockObserver, Columns, SampleRows
from testbed.logs.foxglove_messages import FIX, LOG, TRANSFORMS, encode_event
from testbed.logs.header import INFO_NAME, METADATA_NAME, metadata, to_json
from testbed.logs.mcap_file import LogError, McapWriter, tail_path, topic_schema
from testbed.logs.message_batch import (
    LogChannel,
    MessageBatch,
    MessageRows,
    Schema,
    message_batch,
)
from testbed.logs.messages import ESTIMATE, ESTIMATED_ERROR, NETWORK, Topic, topics_of
from testbed.logs.proto_template import (
    GnssFixes,
    IntArray,
    ProtoTemplate,
    TransformsTemplate,
    topic_template,
)
from testbed.logs.run_directory import METRICS_NAME, SCENARIO_NAME
from testbed.metrics.document import timeless_json

FIX_HZ = 5
# Wall time, at most, between writes of chunks or the tail: a killed run loses less than 0.5 s.
FLUSH_S = 0.35
_MIN_SLEEP_S = 0.005  # of the flushing thread
_NS = 10**9
# Position and quaternion (x, y, z, w) of the NED frame in the east-north-up world that viewers
# draw with z up.
_ENU_FROM_NED = np.zeros((1, 1, 3)), np.array([[[0.5**0.5, 0.5**0.5, 0.0, 0.0]]])


class Addition(NamedTuple):
    """A message of another topic than those of a log."""

    tick: int  # of the base rate
    topic: str
    schema: Schema
    data: bytes


class McapRecorder(BlockObserver):
    """Write a run as MCAP: https://mcap.dev, protobuf, zstd, indexed.

    A chunk is a block of samples, whose number depends on the number of aircraft only, so that the
    same scenario and seed give the same bytes. Where that takes longer than `FLUSH_S` of wall time,
    the samples of the unfinished chunk are written to the tail, a file beside the log that readers
    add to an unfinished log, and that is removed at the end. A thread does so also while no sample
    arrives, as when the run waits for an external program.

    Args:
        path: The file, which must not exist.
        additions: Further messages in order of time, written with the samples of these ticks.
        live: A flight, which may be killed; False: a copy of a log, which needs no tail.
        flush_s: Wall time, at most, between writes of chunks or the tail, which encode all samples
            since the last chunk again, where samples arrive; None: `FLUSH_S`, by a thread also
            where none does.

    Raises:
        LogError: From all methods: the file cannot be written, or was removed or moved.
    """

    def __init__(
        self,
        path: Path,
        additions: Iterable[Addition] = (),
        *,
        live: bool = True,
        flush_s: float | None = None,
    ) -> None:
        self.path, self._live, self._own_flush_s = path, live, flush_s
        self._additions = iter(additions)
        self._next_addition = next(self._additions, None)
        self._added: dict[str, LogChannel] = {}  # by topic
        self._file: McapWriter | None = None
        self._process = os.getpid()
        self._lock = threading.RLock()  # of everything below
        self._closed = threading.Event()
        self._writer_error: Exception | None = None  # raised in the thread

    def begin(self, info: RunInfo) -> None:
        """Create the file and write its header."""
        file = McapWriter(self.path)
        self._info = info
        file.metadata(METADATA_NAME, metadata(info))
        file.attachment(SCENARIO_NAME, "application/yaml", info.scenario_yaml.encode())
        for name, code in info.code.items():
            media = "text/x-python" if name.endswith(".py") else "application/zip"
            file.attachment(name, media, code)
        file.attachment(INFO_NAME, "application/json", to_json(info).encode())
        self._encoder = _SampleEncoder(file, info)
        self._begin_blocks(info)
        self._events: list[tuple[int, Event]] = []  # with the sample they follow in the chunk
        self._tail: tuple[int, int] = (0, 0)  # number of samples and events in it
        self._flushed = time.monotonic()
        self._file = file
        if self._live and self._own_flush_s is None:
            threading.Thread(target=self._flush_loop, name="log-clock", daemon=True).start()

    def add_events(self, events: Sequence[Event]) -> None:
        """See `BlockObserver`."""
        with self._writing():
            number = len(self._new.ticks) - 1
            self._events.extend((number, event) for event in events)

    def take_block(self) -> None:
        """Write the new samples of the buffer as a chunk."""
        with self._writing():
            self._flush()

    def observe(self, sample: Sample) -> None:
        """Copy a sample; write the chunk when it is full, and the tail when that is old."""
        with self._writing():
            super().observe(sample)
            if self._live and time.monotonic() - self._flushed > self._flush_s:
                self._write_tail()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Write the last samples, the events after them and the metrics; finish the file.

        The metrics are attached without wall-clock times, which differ from run to run. Without
        metrics, after an error before the flight, nothing is attached: the run counts as cut.
        """
        with self._writing():
            if self._file is None:
                return
            self.add_events(events)
            self._flush()
            if summary:
                metrics = timeless_json(summary).encode()
                self._file.attachment(METRICS_NAME, "application/json", metrics)
            self.close()

    def close(self) -> None:
        """Finish the file, without metrics if `end` was not called. Harmless when repeated."""
        self.check_process()
        self._closed.set()
        with self._writing():
            if self._file is not None:
                file = self._file
                self._flush()
                self._file = None
                file.close()
                with suppress(OSError):  # read by nothing, beside a finished log
                    tail_path(self.path).unlink(missing_ok=True)

    @property
    def _flush_s(self) -> float:
        return FLUSH_S if self._own_flush_s is None else self._own_flush_s

    def _flush_loop(self) -> None:
        """Write the tail where no sample arrives in time; runs in a thread."""
        remaining = self._flush_s
        while not self._closed.wait(max(remaining, _MIN_SLEEP_S)):
            with self._lock:
                if self._file is None:
                    return
                remaining = self._flushed + self._flush_s - time.monotonic()
                if remaining > 0.0:
                    continue
                remaining = self._flush_s
                try:
                    self._write_tail()
                except Exception as error:
                    self._writer_error = error  # raised by the next call of a method
                    return

    def check_process(self) -> None:
        """Refuse a forked child: it shares the position in the file, and lacks the threads.

        Before any lock, which a thread of the parent may have held when it was forked.
        """
        if os.getpid() != self._process:
            raise LogError(
                f"{self.path}: this process is a fork of the one that writes the log; begin a "
                "flight of its own here"
            )

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Keep the thread from writing meanwhile; first raise the error that stopped it."""
        self.check_process()
        with self._lock:
            error, self._writer_error = self._writer_error, None
            if error is not None:
                raise error
            yield

    def _flush(self) -> None:
        if (file := self._file) is not None:
            samples = self._take()
            with self._closed_by_errors():
                encoded = self._encode(file, self._encoder, samples)
                file.write_chunk([*encoded, *self._additional(file, samples.ticks)])
            self._events = []
        self._tail, self._flushed = (0, 0), time.monotonic()

    def _write_tail(self) -> None:
        """Write the samples and events since the last chunk to the tail."""
        file, samples = self._file, self._new
        size = len(samples.ticks), len(self._events)
        if file is not None and size != self._tail:
            with self._closed_by_errors():
                file.flush()
                try:
                    with replacement(tail_path(self.path)) as path:
                        tail = McapWriter(path)
                        tail.continues(file)
                        encoder = _SampleEncoder(tail, self._info, after=self._encoder)
                        tail.write_chunk([*self._encode(tail, encoder, samples)])
                        tail.close()
                except (OSError, LogError) as error:
                    reason = getattr(error.__cause__ or error, "strerror", None) or error
                    raise LogError(f"{self.path}: cannot write the log: {reason}") from error
        self._tail, self._flushed = size, time.monotonic()

    @contextmanager
    def _closed_by_errors(self) -> Iterator[None]:
        """Forget the file after an error: it is closed after its last complete record."""
        try:
            yield
        except LogError:
            self._file = None
            raise

    def _encode(
        self, file: McapWriter, encoder: _SampleEncoder, samples: SampleRows
    ) -> Iterator[MessageBatch]:
        """Encode samples, and the events since the last chunk, for a file."""
        if len(samples.ticks):
            differ = bool(samples.inexact.any())
            of_run = topics_of(self._info.law_numbers)
            topics = _changed_topics(of_run, samples.columns, estimates_differ=differ)
            yield from encoder.encode(samples.ticks, samples.columns, topics)
        if self._events:
            order, events = zip(*self._events, strict=True)
            start_ns = self._info.start_unix_ns
            time_ns = [start_ns + round(event.time_s * _NS) for event in events]
            lines = [[encode_event(*each)] for each in zip(events, time_ns, strict=True)]
            yield message_batch([encoder.events], lines, np.array(time_ns), np.array(order))

    def _additional(self, file: McapWriter, ticks: IntArray) -> Iterator[MessageBatch]:
        """Take the additions up to the last tick, one batch per topic."""
        found: dict[str, list[Addition]] = {}
        if not ticks.size:
            return
        while self._next_addition is not None and self._next_addition.tick <= ticks[-1]:
            found.setdefault(self._next_addition.topic, []).append(self._next_addition)
            self._next_addition = next(self._additions, None)
        for topic, each in found.items():
            if topic not in self._added:
                self._added[topic] = file.channel(topic, each[0].schema)
            own = np.array([addition.tick for addition in each], dtype=np.int64)
            time_ns = self._info.start_unix_ns + own * _NS // self._info.base_rate_hz
            data = [[addition.data] for addition in each]
            order = np.searchsorted(ticks, own)
            yield message_batch([self._added[topic]], data, time_ns, order)


class _SampleEncoder:
    """Encode samples as messages of a file."""

    def __init__(
        self, file: McapWriter, info: RunInfo, after: _SampleEncoder | None = None
    ) -> None:
        """Prepare the channels and templates of all topics that a run of these aircraft has.

        Args:
            file: of the messages.
            info: of the run.
            after: encoder of the samples before, in another file.
        """
        names = info.names
        self._info, self._file = info, file
        self.events = file.channel("/events", LOG)
        self._tf, self._transforms = (
            file.channel("/tf", TRANSFORMS),
            TransformsTemplate("ned", names),
        )
        self._fix_channels = [file.channel(f"/{name}/fix", FIX) for name in names]
        self._fixes = GnssFixes(names)
        self._fix_stride = max(1, round(info.sample_rate_hz / FIX_HZ))
        self._topics: dict[Topic, tuple[ProtoTemplate, list[LogChannel]]] = {}
        for topic in topics_of(info.law_numbers):
            agents = names[1:] if topic.followers_only else names
            if agents:
                schema = topic_schema(topic, names)
                channels = [file.channel(f"/{name}/{topic.name}", schema) for name in agents]
                self._topics[topic] = topic_template(topic, names), channels
        self._covariance: FixCovariance = (
            copy(after._covariance) if after else FixCovariance(len(names))
        )
        self._rows: dict[tuple[Topic, ...], MessageRows] = {}
        self._encoded: int = after._encoded if after else 0  # samples

    def encode(
        self, ticks: IntArray, columns: Columns, topics: Sequence[Topic]
    ) -> Iterator[MessageBatch]:
        """Encode the next K samples.

        Args:
            ticks: (K,) of the base rate.
            columns: arrays (K, ...) by source.
            topics: those to write.
        """
        info = self._info
        time_ns = info.start_unix_ns + ticks * _NS // info.base_rate_hz
        if not self._encoded:
            static = [self._file.channel("/tf_static", TRANSFORMS)]
            yield message_batch(
                static, [[_static_transform(time_ns[:1])]], time_ns[:1], np.zeros(1, dtype=np.int64)
            )
        positions, euler = columns["truth.position_ned"], columns["truth.euler"]
        present = tuple(topic for topic in topics if topic in self._topics)
        layout = self._message_rows(present)
        rows = layout.allocate(len(ticks))
        transforms, *messages = layout.messages(rows)
        self._transforms.fill(transforms[:, 0], positions, quaternion_xyzw(euler), time_ns)
        for topic, of_topic in zip(present, messages, strict=True):
            self._topics[topic][0].fill(of_topic, columns)
        yield layout.batch(rows, time_ns)
        with_fix = slice(-self._encoded % self._fix_stride, None, self._fix_stride)
        order = np.arange(len(ticks))[with_fix]
        estimates = columns["estimate.position_ned"]
        covariances = self._covariance.add(estimates - positions)[with_fix]
        if order.size:
            geodetic = geodetic_from_ned(estimates[with_fix], info.origin)
            fixes = self._fixes.encode(geodetic, covariances, time_ns[with_fix])
            yield message_batch(self._fix_channels, fixes, time_ns[with_fix], order)
        self._encoded += len(ticks)

    def _message_rows(self, topics: tuple[Topic, ...]) -> MessageRows:
        if topics not in self._rows:
            groups = [(self._transforms.data, [self._tf])]
            for topic in topics:
                template, channels = self._topics[topic]
                groups.append((template.data, channels))
            self._rows[topics] = MessageRows(groups)
        return self._rows[topics]


def _changed_topics(
    topics: Sequence[Topic], columns: Columns, *, estimates_differ: bool
) -> list[Topic]:
    """Select the topics to write: estimates that differ from the truth, links that lost messages.

    Args:
        topics: of the run.
        columns: arrays (K, ...) by source.
        estimates_differ: False if all estimates are the truth itself.
    """

    def differ(one: str, other: str) -> bool:
        # compared by bits, so that NaN equals itself
        return columns[one].tobytes() != columns[other].tobytes()

    written = {topic for topic in topics if topic not in (ESTIMATE, ESTIMATED_ERROR, NETWORK)}
    if estimates_differ:
        for topic in (ESTIMATE, ESTIMATED_ERROR):
            if any(differ(column.source, column.default_source or "") for column in topic.columns):
                written.add(topic)
    # the counts are cumulative: after the first loss they differ for ever
    if differ("links.sent", "links.delivered"):
        written.add(NETWORK)
    return [topic for topic in topics if topic in written]


def _static_transform(time_ns: IntArray) -> bytes:
    """Encode the one message of `/tf_static`: NED in the east-north-up world, at time_ns (1,)."""
    template = TransformsTemplate("enu", ("ned",))
    octets = np.array([list(template.data)], dtype=np.uint8)
    template.fill(octets, *_ENU_FROM_NED, time_ns)
    return octets.tobytes()


class FixCovariance:
    """Average the squared errors of N estimated positions, from the first sample on."""

    def __init__(self, aircraft: int) -> None:
        self._sums = np.zeros((aircraft, 3, 3))  # m²
        self._count = 0

    def add(self, error_ned: Array) -> Array:
        """Add the next K samples.

        Args:
            error_ned: (K, N, 3) m, of the estimates; not finite in aircraft that have failed.

        Returns:
            (K, N, 3, 3) m², of east, north and up, after each sample.
        """
        enu = np.nan_to_num(enu_from_ned(error_ned), posinf=0.0, neginf=0.0)
        squares = np.concatenate([self._sums[None], enu[..., :, None] * enu[..., None, :]])
        # summed one by one, so that chunks of other lengths give the same bits
        sums = np.cumsum(squares, axis=0)[1:]
        counts = np.arange(self._count + 1, self._count + 1 + len(sums))
        self._sums, self._count = sums[-1], self._count + len(sums)
        out: Array = sums / counts[:, None, None, None]
        return out
