"""Cases of slow tests: a seeded sample in `make test`, and all of them in `make check-all`.

Only for cases that run the same code as others: what one case alone would find is always run.
"""

import os
import random

import pytest

ALL = os.environ.get("TESTBED_CASES") == "all"
SEED = 52
in_full = pytest.mark.skipif(not ALL, reason="run by make check-all, with TESTBED_CASES=all")


def some(cases, count):
    """Return so many of these cases, drawn by a seed, in their order; all where `ALL`."""
    cases = list(cases)
    if ALL or count >= len(cases):
        return cases
    drawn = random.Random(SEED).sample(range(len(cases)), count)
    return [cases[each] for each in sorted(drawn)]
