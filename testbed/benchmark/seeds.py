"""Seeds of the flights: public ones for practice, and ones that nobody has chosen for ranks."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

from testbed.core.errors import InputError

SEEDS = 12  # of each task and level
PRACTICE = tuple(range(1, SEEDS + 1))
TUNING = (1001,)  # of the tuning tasks
_PULSE = re.compile(r"[0-9a-f]{16,1024}")


def read_pulse(text: str) -> str:
    """Return a public number as it is used: lower-case hexadecimal digits.

    Raises:
        InputError: it is another text.
    """
    pulse = text.strip().lower().removeprefix("0x")
    if not _PULSE.fullmatch(pulse):
        raise InputError(
            f"--pulse {text[:40]}: write 16 to 1024 hexadecimal digits, of a number that was "
            "published after the entries' digests"
        )
    return pulse


def rank_seeds(benchmark: str, entries: Iterable[str], pulse: str) -> tuple[int, ...]:
    """Return the seeds of ranks, which follow from what was fixed before the pulse, and from it.

    Args:
        benchmark: its name and the digest of its manifest.
        entries: digests of all entries that are ranked together, in any order.
        pulse: see `read_pulse`.
    """
    text = "\n".join([benchmark, *sorted(entries), pulse])
    digests = (hashlib.sha256(f"{text}\n{k}".encode()).digest() for k in range(SEEDS))
    return tuple(int.from_bytes(each[:8], "little") >> 1 for each in digests)
