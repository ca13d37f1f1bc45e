"""What a companion measures of itself: latency, ages of messages, time of a step, memory."""

from __future__ import annotations

import resource
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded
from testbed.link.message_counts import Durations

_KB = 1024
_STATUS, _STATUS_BYTES = Path("/proc/self/status"), 1 << 16


class LoopStatistics:
    """Durations of one flight, and what the process used.

    Attributes:
        state_to_command: from the system's time of receipt of ATTITUDE until its command is sent.
        step: of law and middle loop.
        ages: of the messages that a step used, by aircraft.
        commands: sent.
        samples: of the own state.
        missed: steps without a sample for each of their messages, by aircraft.
    """

    def __init__(self, used: Sequence[str]) -> None:
        """Begin to count; `used` are the aircraft whose messages the law uses."""
        self.state_to_command, self.step = Durations(), Durations()
        self.ages = {name: Durations() for name in used}
        self.missed = dict.fromkeys(used, 0)
        self.commands = self.samples = 0
        self.ready_cpu_s = time.process_time()
        self._begun = time.monotonic(), time.process_time()
        self.first_command_cpu_s: float | None = None

    def add_command(self, latency_s: float) -> None:
        """Count a command, sent some time after the receipt of its state, s."""
        if not self.commands:
            self.first_command_cpu_s = time.process_time()
        self.commands += 1
        self.state_to_command.add(latency_s)

    def add_age(self, name: str, age_s: float) -> None:
        """Count the age of a message at a step, s; NaN: there was none."""
        if age_s >= 0.0:
            self.ages[name].add(age_s)
        else:
            self.missed[name] += 1

    def summary(self) -> Mapping[str, Any]:
        """Return all numbers for JSON; s and MB."""
        elapsed, used = time.monotonic() - self._begun[0], time.process_time() - self._begun[1]
        return {
            "samples": self.samples,
            "commands": self.commands,
            "state_to_command_s": self.state_to_command.summary(),
            "step_s": self.step.summary(),
            "age_s": {name: each.summary() for name, each in self.ages.items()},
            "steps_without_message": dict(self.missed),
            "ready_cpu_s": self.ready_cpu_s,
            "first_command_cpu_s": self.first_command_cpu_s,
            "processor_share": used / elapsed if elapsed > 0.0 else None,
            "peak_memory_mb": peak_memory_mb(),
        }


def peak_memory_mb() -> float:
    """Return the most memory that this program has had, MB.

    The system's count for a process would have that of the program which started it, too.
    """
    with suppress(OSError, InputError, ValueError):
        for line in read_bounded(_STATUS, _STATUS_BYTES).decode().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / _KB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KB
