"""The only module that imports Dask: flights on a cluster that is there already.

Its workers need the same testbed and the same versions of what it flies with, and what a page names
by a path where this machine has it. A worker flies one page at a time, whatever its threads.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from testbed.errors import InputError
from testbed.links.addresses import is_loopback
from testbed.study.crew import Flown, Task, fly

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
WORKERS_S = 30.0  # for the first worker to appear
_LOOK_S = 5.0  # between two looks at how many there are


def notices(scheduler: str) -> Iterator[str]:
    """What people should know of a cluster: where it is, and whom they trust."""
    yield f"cluster: {scheduler}"
    place = scheduler if "://" in scheduler else f"tcp://{scheduler}"
    host = urlsplit(place).hostname or scheduler
    if not is_loopback(host):
        yield (
            f"warning: {host} is not this machine alone: pages go there, and who has it can run "
            "code here (Dask's own TLS keeps others away)"
        )


class Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, scheduler: str) -> None:
        """Connect.

        Args:
            scheduler: its address, as tcp://HOST:8786.

        Raises:
            InputError: Dask is missing, nobody answers there, or there are no workers.
        """
        try:
            import distributed
        except ImportError as error:
            raise InputError(
                f"--backend dask: {error}; install it with: pip install distributed"
            ) from None
        self._dask = distributed
        try:
            self._client: Client = distributed.Client(
                scheduler, timeout=CONNECT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {scheduler}: nobody answers there: {error or 'no connection'}"
            ) from None
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except (OSError, TimeoutError):
            self._client.close()
            raise InputError(
                f"--scheduler {scheduler}: it has no workers: start some with dask worker "
                f"{scheduler} --nthreads 1"
            ) from None
        self._hand = self._client.get_executor(pure=False, retries=0)
        self._seen_s = -_LOOK_S
        self._room = 1

    def room(self) -> int:
        """A task for each worker, and another to follow it."""
        if time.monotonic() - self._seen_s >= _LOOK_S:
            self._seen_s = time.monotonic()
            self._room = 2 * max(1, len(self._client.nthreads()))
        return self._room

    def submit(self, task: Task) -> Future[Flown]:
        """Have a task flown by a worker."""
        future: Future[Flown] = self._hand.submit(fly, task)
        return future

    def killed(self, error: BaseException) -> bool:
        """Whether it says that workers have ended."""
        return isinstance(error, self._dask.KilledWorker)

    def end(self) -> None:
        """Take back what waits, and leave; what flies is flown to its end, for nobody."""
        self._hand.shutdown(wait=False)
        self._client.close(timeout=CONNECT_S)
