"""Estimates of the memory and disk space of a run, and checks against what is free.

The coefficients were measured by `benchmarks/memory.py`; a test compares them with flights.
"""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

from testbed.core.errors import InputError
from testbed.core.files import format_bytes
from testbed.scenario import Scenario, SingleAircraft
from testbed.scenario.sensors import TRUTH

# bytes
_PROGRAM = 180e6  # libraries, tables and buffers
_PER_AIRCRAFT = 1.5e6  # a flight model and its records
_PER_MESSAGE = 250.0  # between transmission and delivery
_LOG_PER_SAMPLE = 430.0  # of an aircraft, compressed
_LOG_TURBULENCE = 65.0  # more with turbulence
_LOG_ESTIMATE = 205.0  # more where the estimate differs from the truth
_CGROUP = Path("/sys/fs/cgroup")
_CGROUP_2 = ("memory.max", "memory.current")
_CGROUP_1 = ("memory.limit_in_bytes", "memory.usage_in_bytes")
_OWN_CGROUP = Path("/proc/self/cgroup")
_STATM = Path("/proc/self/statm")


def memory_needed(scenario: Scenario | SingleAircraft) -> float:
    """Return the largest memory of a flight, bytes."""
    n, in_flight = len(scenario.aircraft), 0.0
    if isinstance(scenario, Scenario):
        links = scenario.network.links.values()
        per_link = (each.delay_s or 0.0 for receivers in links for each in receivers.values())
        delay_s = min(max([scenario.network.delay_s, *per_link]), scenario.scenario.duration_s)
        in_flight = n * (n - 1) * scenario.rates.broadcast_hz * delay_s
    return _PROGRAM + _PER_AIRCRAFT * n + _PER_MESSAGE * in_flight


def disk_needed(scenario: Scenario) -> float:
    """Return the size of the log of a whole flight, bytes."""
    samples = scenario.scenario.duration_s * scenario.rates.log_hz
    turbulent = scenario.air.turbulence.model != "none"
    with_errors = sum(each.sensors != TRUTH for each in scenario.aircraft)
    per_aircraft = _LOG_PER_SAMPLE + _LOG_TURBULENCE * turbulent
    return samples * (per_aircraft * len(scenario.aircraft) + _LOG_ESTIMATE * with_errors)


def check_memory(scenario: Scenario | SingleAircraft) -> None:
    """Refuse a flight that needs more memory than is free.

    Raises:
        InputError: with the memory needed and free.
    """
    needed, free = memory_needed(scenario), memory_free()
    if free is not None and needed > free:
        raise InputError(
            f"scenario: {scenario.scenario.duration_s:g} s of {len(scenario.aircraft)} aircraft "
            f"need about {format_bytes(needed)} of memory, and {format_bytes(free)} are free "
            "(write a shorter duration_s, fewer aircraft, lower rates or less delay)"
        )


def check_disk(scenario: Scenario, folder: Path) -> None:
    """Refuse a log that is larger than the free space of its folder's file system.

    Args:
        scenario: to be flown.
        folder: of the log; it need not exist.

    Raises:
        InputError: with the space needed and free.
    """
    existing = next(each for each in (folder, *folder.absolute().parents) if os.path.exists(each))
    needed, free = disk_needed(scenario), float(shutil.disk_usage(existing).free)
    if needed > free:
        raise InputError(
            f"scenario: the log of {scenario.scenario.duration_s:g} s of "
            f"{len(scenario.aircraft)} aircraft needs about {format_bytes(needed)}, and {existing} "
            f"has {format_bytes(free)} (write a shorter duration_s, a lower rates.log_hz, "
            "log.mcap: false, or choose another --out)"
        )


def memory_free() -> float | None:
    """Return the memory this process may still allocate, bytes; None where it is unknown."""
    return min(_free_memory(), default=None)


def _free_memory() -> Iterator[float]:
    """Yield the free memory of the machine, and what limits of the process and its groups leave."""
    yield from _within_process_limits()
    yield from _within_control_groups()
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        values = dict(line.split(":", 1) for line in lines)
        yield 1024.0 * float(values["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return


def _within_process_limits() -> Iterator[float]:
    """Yield what `ulimit -v` and `ulimit -d` leave of the address space and of its data."""
    try:
        pages = _STATM.read_text(encoding="ascii").split()
        used = {resource.RLIMIT_AS: int(pages[0]), resource.RLIMIT_DATA: int(pages[5])}
    except (OSError, ValueError, IndexError):
        return
    for kind, count in used.items():
        limit = resource.getrlimit(kind)[0]
        if limit != resource.RLIM_INFINITY:
            yield float(limit - count * resource.getpagesize())


def _within_control_groups() -> Iterator[float]:
    """Yield what the limits of this process's control groups leave, from its own to the root."""
    try:
        lines = _OWN_CGROUP.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        lines = []
    groups = {_CGROUP: _CGROUP_2}
    for line in lines:
        _, controllers, path = (*line.split(":", 2), "", "")[:3]
        if controllers in ("", "memory"):
            top, files = _CGROUP / controllers, _CGROUP_1 if controllers else _CGROUP_2
            own = top / path.strip("/")
            groups |= {each: files for each in (own, *own.parents) if each.is_relative_to(top)}
    for folder, names in groups.items():
        try:
            limit, used = (float((folder / name).read_text(encoding="ascii")) for name in names)
        except (OSError, ValueError):  # no limit: the file is missing, or contains "max"
            continue
        yield limit - used
