"""Finish the log and the metrics of a run that was cut short."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from testbed.core.files import lock_file, replacement
from testbed.core.input_files import MAX_LOG_BYTES, open_regular
from testbed.core.records import Event
from testbed.logs.file_record import check_default_output, delete_tail, record_files
from testbed.logs.mcap_file import NO_SAMPLES, LogError
from testbed.logs.read import RunLog, read_log, replay, scenario_of
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, find_run
from testbed.metrics.document import write_json
from testbed.metrics.document_check import check_metrics
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver

_REMEDY = "move or rename it"


@dataclass(frozen=True, slots=True)
class Recovered:
    """The result of recovering a run."""

    log: Path
    metrics: Metrics
    was_cut: bool  # False: the log was complete
    lost_bytes: int  # of an incomplete record at the end


def recover(run: str | Path) -> Recovered:
    """Finish the log of a run that was killed, and compute its metrics.

    A new log replaces the old one in one move, after all samples and events of the old one were
    read back from it; on any failure the old one stays. Metrics are those of a run stopped at the
    cut; network statistics and wall-clock times are not in a log, and null.

    Args:
        run: its directory, its `.mcap` file, or its scenario's name for the latest run.

    Raises:
        LogError: There is no such run, it is still flying, its log is damaged before its end, or
            cannot be written.
    """
    path = find_run(run)
    with _locked(path):
        return _recover(path)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Lock a log, which its writer does too until it ends or is killed."""
    with open_regular(path, MAX_LOG_BYTES, error=LogError) as file:
        if not lock_file(file):
            raise LogError(
                f"{path}: this run is still flying, or is being recovered by another process; wait "
                "for its end"
            )
        yield


def _recover(path: Path) -> Recovered:
    log = read_log(path)
    metrics_path = path.with_name(METRICS_NAME)
    if log.finished and log.metrics is not None:
        check_metrics(log.metrics, log.info, str(path))
        if path.name == LOG_NAME and not metrics_path.exists():  # killed after the log was finished
            check_default_output(metrics_path, _REMEDY)  # also a link to nothing
            write_json(metrics_path, log.metrics)
            record_files(path.parent, path.name, METRICS_NAME)
        return Recovered(path, log.metrics, was_cut=False, lost_bytes=0)
    if not log.tick.size:
        raise LogError(f"{path}: {NO_SAMPLES}")
    check_default_output(metrics_path, _REMEDY)
    try:
        with replacement(path) as new_path:
            metrics = _rewrite(log, new_path)
            if not _is_complete(read_log(new_path), log):
                raise LogError(
                    f"{path}: the new log lacks samples or events of this one, which is kept"
                )
    except OSError as error:
        raise LogError(f"{path}: cannot be replaced: {error.strerror}") from error
    delete_tail(path)
    write_json(metrics_path, metrics)
    record_files(path.parent, path.name, METRICS_NAME)
    return Recovered(path, metrics, was_cut=True, lost_bytes=log.lost_bytes)


def _rewrite(log: RunLog, path: Path) -> Metrics:
    """Write the samples of a log to a new one; return their metrics."""
    scenario = scenario_of(log)
    meter = MetricsObserver(published=scenario.published if scenario else None)
    recorder = McapRecorder(path, live=False)
    rest = replay(log, [meter, recorder])
    last_s = float(log.time_s[-1])
    cut = Event(last_s, "warning", "run", f"recovered: the log was cut after {last_s:g} s")
    after = [*rest, cut]
    metrics = meter.summary(after)
    metrics["outcome"], metrics["recovered"] = "interrupted", True
    recorder.end(metrics, after)
    return metrics


def _is_complete(new: RunLog, old: RunLog) -> bool:
    """Return whether a new log is finished, with all samples and events of the old."""
    finished = new.finished and new.metrics is not None
    return finished and len(new.events) == len(old.events) + 1 and new.tick.size == old.tick.size
