"""Workers of an existing Dask cluster; the only importer of Dask.

Workers need the same version of the testbed and of its libraries, and the files that a scenario
names, at the same paths. A worker flies one scenario at a time, whatever its number of threads.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from testbed.core.errors import ExternalProgramLost, InputError, describe_error, needs_extra
from testbed.mavlink.udp_endpoint import is_loopback
from testbed.pool.flight_task import FlightResult, FlightTask, run_task

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
FIRST_WORKER_S = 30.0
LOST = "the cluster is lost, with the flights that ran on it: {} (write --resume to fly the rest)"
_COUNT_INTERVAL_S = 5.0  # between two counts of the workers


def cluster_notices(scheduler: str) -> Iterator[str]:
    """Yield the notices on a cluster: its address, and a security warning."""
    yield f"cluster: {scheduler}"
    address = scheduler if "://" in scheduler else f"tcp://{scheduler}"
    host = urlsplit(address).hostname or scheduler
    if not is_loopback(host):
        yield (
            f"warning: {host} is another machine: scenarios are sent there, and a program that "
            "controls the scheduler can run code here (Dask's TLS restricts access)"
        )


class DaskWorkers:
    """The workers of a Dask scheduler."""

    def __init__(self, scheduler: str) -> None:
        """Connect.

        Args:
            scheduler: its address, as tcp://HOST:8786.

        Raises:
            InputError: Dask is not installed, or the address is none.
            ExternalProgramLost: the scheduler does not answer, or has no workers.
        """
        with needs_extra("dask", "--backend dask"):
            import distributed
        self._dask = distributed
        # of a lost scheduler it prints tracebacks, whatever the caller does with the error
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        try:
            self._client: Client = distributed.Client(
                scheduler, timeout=CONNECT_S, set_as_default=False
            )
        except OSError as error:
            raise ExternalProgramLost(
                f"--scheduler {scheduler}: does not answer: {str(error) or 'no connection'}"
            ) from None
        except (ValueError, TypeError) as error:
            raise InputError(f"--scheduler {scheduler}: is no address: {error}") from None
        try:
            self._client.wait_for_workers(1, timeout=FIRST_WORKER_S)
        except (OSError, TimeoutError):
            self._client.close()
            raise ExternalProgramLost(
                f"--scheduler {scheduler}: has no workers: start some with dask worker "
                f"{scheduler} --nthreads 1"
            ) from None
        self._executor = self._client.get_executor(pure=False, retries=0)
        self._counted_s = -_COUNT_INTERVAL_S
        self._capacity = 1
        self._had_workers_s = time.monotonic()

    def capacity(self) -> int:
        """Return two tasks for each worker: one that runs and one that waits.

        Raises:
            ExternalProgramLost: there has been no worker for a while, or no scheduler.
        """
        if time.monotonic() - self._counted_s >= _COUNT_INTERVAL_S:
            self._counted_s = time.monotonic()
            with _loss_reported():
                workers = len(self._client.nthreads())
            self._capacity = 2 * max(1, workers)
            if workers:
                self._had_workers_s = self._counted_s
            elif self._counted_s - self._had_workers_s > FIRST_WORKER_S:
                raise ExternalProgramLost(LOST.format(f"no workers for {FIRST_WORKER_S:g} s"))
        return self._capacity

    def submit(self, task: FlightTask) -> Future[FlightResult]:
        """Run a task in a worker."""
        with _loss_reported():
            future: Future[FlightResult] = self._executor.submit(run_task, task)
        return future

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether an error means that workers ended."""
        return isinstance(error, self._dask.KilledWorker)

    def shutdown(self) -> None:
        """Cancel waiting tasks and disconnect; results of running flights are discarded."""
        with suppress(ExternalProgramLost), _loss_reported():  # the loss has been reported
            self._executor.shutdown(wait=False)
            self._client.close(timeout=CONNECT_S)


@contextmanager
def _loss_reported() -> Iterator[None]:
    """Report a call that fails because the scheduler has ended.

    Raises:
        ExternalProgramLost: the call failed.
    """
    try:
        yield
    except (OSError, RuntimeError, TimeoutError, CancelledError) as error:
        raise ExternalProgramLost(LOST.format(describe_error(error))) from error
