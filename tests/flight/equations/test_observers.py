"""Observers of a flight are handed the run's arrays, or a copy to keep."""

import numpy as np
import pytest

import testbed
from testbed.scenario import load_scenario, set_duration


class Watcher:
    def __init__(self, zero_copy):
        self.zero_copy, self.frames, self.seen = zero_copy, [], []

    def begin(self, info):
        pass

    def observe(self, sample):
        self.frames.append(sample)
        self.seen.append(numbers(sample))

    def end(self, summary, events):
        pass


def numbers(frame):
    """Everything in a frame, copied."""
    records = (frame.truth, frame.estimate, frame.air, frame.command, frame.surfaces)
    every = [array for record in (*records, frame.formation, frame.links) for array in record]
    if frame.faults is not None:
        every += frame.faults
    return np.concatenate([array.ravel().astype(float) for array in (*every, frame.lost)])


@pytest.mark.parametrize(
    "name", ["simulation-3", "simulation-3-pixhawk", "engine-out-uav2", "ideal-figure-eight"]
)
def test_kept_samples_do_not_change(name):
    keeper, borrower = Watcher(zero_copy=False), Watcher(zero_copy=True)
    scenario = set_duration(load_scenario(name, ["log.mcap=false"]), 1.0)
    testbed.run(scenario, write=False, observers=[borrower, keeper])
    assert len(keeper.frames) == 26
    for frame, seen, lent in zip(keeper.frames, keeper.seen, borrower.seen, strict=True):
        np.testing.assert_array_equal(numbers(frame), seen)
        np.testing.assert_array_equal(lent, seen)
    first, last = borrower.frames[0], borrower.frames[-1]
    assert first.truth.position_ned is last.truth.position_ned
    assert not np.array_equal(borrower.seen[0], borrower.seen[-1])
    exact = name != "simulation-3-pixhawk"
    for frame in (*keeper.frames, *borrower.frames):
        assert (frame.estimate is frame.truth) == exact
