"""Claims of the whole benchmark hold on seeds of a pulse: none is reversed, most are made again."""

import os

import pytest

from testbed.benchmark.campaign import Campaign, fly_campaign, practice_seeds, pulse_seeds
from testbed.benchmark.entry import open_entries, shipped_names
from testbed.benchmark.ranking import rank
from testbed.benchmark.score import agreement
from testbed.benchmark.task import load_benchmark

PULSE = "0123456789abcdef" * 4
LEAST_SHARE = 0.85

pytestmark = pytest.mark.skipif(
    "TESTBED_BENCHMARK" not in os.environ, reason="two whole benchmarks: TESTBED_BENCHMARK=1"
)


def test_a_second_set_of_seeds_reverses_no_claim(tmp_path):
    benchmark, entries = load_benchmark(), open_entries(shipped_names())
    first, second = (
        rank(fly_campaign(Campaign(entries, seeds, tmp_path), report=print), benchmark)
        for seeds in (practice_seeds(), pulse_seeds(benchmark, entries, PULSE))
    )
    found = agreement(first, second)
    print(found)
    assert found.claimed > 0
    assert found.reversed == 0
    assert found.again >= LEAST_SHARE * found.claimed
