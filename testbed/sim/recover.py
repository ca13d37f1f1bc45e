"""A run that was cut short, finished from what its log has."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.metrics import MetricsObserver
from testbed.metrics.document import write_json
from testbed.record.door import NOTHING, LogError
from testbed.record.read import Log, page_of, read_log, replay
from testbed.record.recorder import METRICS_NAME, McapRecorder
from testbed.record.rundir import LOG_NAME, find_run
from testbed.state import Event


@dataclass(frozen=True, slots=True)
class Recovered:
    """What was found and made of it."""

    log: Path
    metrics: Mapping[str, Any]
    was_cut: bool  # False: there was nothing to do
    lost_bytes: int  # of a record that was cut in two, which nobody can read


def recover(run: str | Path) -> Recovered:
    """Finish the log of a run that was killed, and count its metrics.

    The log takes the old one's place in one move, once everything that could be read of that was
    read back from it; whatever fails, the old one stays. Numbers of frames are as they would have
    been, had the run been stopped there; what the radio did and how long the run took is not in a
    log, and null.

    Args:
        run: its directory, its `.mcap` file, or its scenario for the latest.

    Raises:
        LogError: there is no such run, its log is damaged before its end, or cannot be written.
    """
    path = find_run(run)
    log = read_log(path)
    beside = path.with_name(METRICS_NAME)
    if log.finished and log.metrics is not None:
        if path.name == LOG_NAME and not beside.exists():  # it was killed between the two
            write_json(beside, log.metrics)
        return Recovered(path, log.metrics, was_cut=False, lost_bytes=0)
    if not log.tick.size:
        raise LogError(f"{path}: {NOTHING}")
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        metrics = _again(log, fresh)
        if not _as_long(read_log(fresh), log):
            raise LogError(f"{path}: what was written is not what was read (keep the old one)")
        os.replace(fresh, path)
    except OSError as error:
        raise LogError(f"{path}: cannot be replaced: {error.strerror}") from error
    finally:
        fresh.unlink(missing_ok=True)
    write_json(beside, metrics)
    return Recovered(path, metrics, was_cut=True, lost_bytes=log.lost_bytes)


def _again(log: Log, path: Path) -> dict[str, Any]:
    """Record the frames of a log once more; the metrics."""
    page = page_of(log)
    published = page.scenario.published if page else None
    meter = MetricsObserver(published=published.model_dump() if published else None)
    recorder = McapRecorder(path)
    rest = replay(log, [meter, recorder])
    last_s = float(log.time_s[-1])
    cut = Event(last_s, "warning", "run", f"recovered: the log was cut after {last_s:g} s")
    after = [*rest, cut]
    metrics = {**meter.summary(after), "outcome": "interrupted", "recovered": True}
    recorder.end(metrics, after)
    return metrics


def _as_long(fresh: Log, old: Log) -> bool:
    """Whether a log has all frames and events of the old one, and is finished."""
    whole = fresh.finished and fresh.metrics is not None
    return whole and len(fresh.events) == len(old.events) + 1 and fresh.tick.size == old.tick.size
