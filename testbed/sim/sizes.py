"""How much memory and disk a run will take, before it takes any.

The numbers are of measurements, held to flights by a test; `benchmarks/memory.py` measures them.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

from testbed.errors import InputError
from testbed.scenario import Scenario
from testbed.scenario.sensors import TRUTH
from testbed.sim.clock import Clock

_PROGRAM = 180e6  # bytes: libraries, tables and buffers
_AIRCRAFT = 1.5e6  # of a flight model and what belongs to it
_PATH = 400.0  # of a tick of a leader that is computed beforehand, while it is
_MESSAGE = 250.0  # of a message on its way
_LOGGED = 430.0  # of an aircraft in a frame, compressed
_AIR = 65.0  # the same, more where the air is never the same
_ESTIMATE = 205.0  # and where the estimate is not the truth
_CGROUP = Path("/sys/fs/cgroup")


def memory_needed(page: Scenario, clock: Clock) -> float:
    """The most memory that a flight takes at any time, bytes."""
    n = 1 + len(page.fleet)
    ticks = 0.0
    if page.leader.path.kind != "mission":
        ticks = sum(1 for _ in clock.schedule(1.0)) * page.scenario.duration_s
    links = page.network.links.values()
    delays = [page.network.delay_s, *(each.delay_s or 0.0 for to in links for each in to.values())]
    in_flight = n * (n - 1) * page.rates.broadcast_hz * min(max(delays), page.scenario.duration_s)
    return _PROGRAM + _AIRCRAFT * n + _PATH * ticks + _MESSAGE * in_flight


def disk_needed(page: Scenario) -> float:
    """What the log of a whole flight takes, bytes."""
    frames = page.scenario.duration_s * page.rates.log_hz
    turbulent = page.air.turbulence.model != "none"
    guessing = sum(each.sensors != TRUTH for each in page.aircraft)
    return frames * ((_LOGGED + _AIR * turbulent) * len(page.aircraft) + _ESTIMATE * guessing)


def check_memory(page: Scenario, clock: Clock) -> None:
    """Refuse a flight that needs more memory than is free.

    Raises:
        InputError: it does, with how much it needs and there is.
    """
    needed, free = memory_needed(page, clock), memory_free()
    if free is not None and needed > free:
        raise InputError(
            f"scenario: {page.scenario.duration_s:g} s of {len(page.aircraft)} aircraft need about "
            f"{_told(needed)} of memory, and {_told(free)} are free (write a shorter duration_s, "
            "fewer aircraft, lower rates or less delay)"
        )


def check_disk(page: Scenario, folder: Path) -> None:
    """Refuse a log for which a folder, or the first that exists above it, has no room.

    Raises:
        InputError: there is none, with how much it needs and there is.
    """
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    needed, free = disk_needed(page), float(shutil.disk_usage(there).free)
    if needed > free:
        raise InputError(
            f"scenario: the log of {page.scenario.duration_s:g} s of {len(page.aircraft)} aircraft "
            f"needs about {_told(needed)}, and {there} has {_told(free)} (write a shorter "
            "duration_s, a lower rates.log_hz, log.mcap: false, or choose another --out)"
        )


def memory_free() -> float | None:
    """What this process may still take, bytes; None where the system does not say."""
    return min(_memory(), default=None)


def _memory() -> Iterator[float]:
    """What the machine has to give, and what is left of a limit for this process and others."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        told = dict(line.split(":", 1) for line in lines)
        yield 1024.0 * float(told["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return
    try:
        limit, used = (
            float((_CGROUP / f"memory.{name}").read_text(encoding="ascii"))
            for name in ("max", "current")
        )
        yield limit - used
    except (OSError, ValueError):  # no such limit: the file is missing, or says "max"
        return


def _told(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"
