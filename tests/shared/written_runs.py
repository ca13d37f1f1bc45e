"""Runs written without a flight, and a limit of the time in which commands read them."""

import contextlib
import json
import signal
from datetime import UTC, datetime, timedelta

import numpy as np
from record_flight import run_info, run_samples

from testbed.logs.file_record import record_files
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.metrics.document import finalise
from testbed.metrics.observer import MetricsObserver
from testbed.network.link_statistics import initial_statistics, summarise

NOW = datetime(2026, 6, 30, tzinfo=UTC)


def make_run(logs, scenario, days_ago, *, size=1000, finished=True):
    """Write the files of a run that began some days before `NOW`."""
    name = f"{NOW - timedelta(days=days_ago):%Y%m%dT%H%M%SZ}-{days_ago:04x}"
    folder = logs / scenario / name
    folder.mkdir(parents=True)
    (folder / SCENARIO_NAME).write_text("scenario: {}\n")
    (folder / LOG_NAME).write_bytes(bytes(size))
    if finished:
        document = {"scenario": scenario, "outcome": "completed", "simulated_s": 60.0}
        (folder / METRICS_NAME).write_text(json.dumps(document))
    record_files(folder, SCENARIO_NAME, METRICS_NAME, LOG_NAME)
    return folder


class WaitsTooLongError(BaseException):
    """What waits; no OSError, as TimeoutError is, which code about files may catch."""


@contextlib.contextmanager
def time_limit(seconds=5.0):
    """Raise WaitsTooLongError in what waits longer, as for the other end of a pipe."""

    def end(*_):
        raise WaitsTooLongError(f"waits longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def synthetic(folder, count=60, followers=3, *, ended=True, info=None, **how):
    """Record a synthetic run."""
    folder.mkdir(exist_ok=True)
    log, meter = McapRecorder(folder / "run.mcap"), MetricsObserver()
    info = info or run_info(followers, duration_s=60.0)
    for observer in (log, meter):
        observer.begin(info)
    for sample in run_samples(count, followers, **how):
        log.observe(sample)
        meter.observe(sample)
    nothing = summarise(initial_statistics(1, 2), ("a", "b"), np.ones((1, 2), dtype=bool))
    network = {"links": {}, "all": nothing["all"]}
    summary = finalise(
        meter.summary(), network=network, external={}, outcome="interrupted", wall_s=1.0
    )
    log.end(summary if ended else {}, ())
    return folder
