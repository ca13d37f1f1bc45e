"""Who watches a run is handed the loop's arrays, or a copy to keep."""

import numpy as np

import testbed
from testbed.scenario import load, shorten


class Watcher:
    def __init__(self, borrows):
        self.borrows, self.frames, self.seen = borrows, [], []

    def begin(self, info):
        pass

    def observe(self, frame):
        self.frames.append(frame)
        self.seen.append(numbers(frame))

    def end(self, summary, events):
        pass


def numbers(frame):
    """Everything in a frame, copied."""
    records = (frame.truth, frame.estimate, frame.air, frame.command, frame.surfaces)
    every = [array for record in (*records, frame.formation, frame.links) for array in record]
    if frame.failing is not None:
        every += frame.failing
    return np.concatenate([array.ravel().astype(float) for array in (*every, frame.lost)])


def watched(page, *changes):
    keeper, borrower = Watcher(borrows=False), Watcher(borrows=True)
    scenario = shorten(load(page, ["log.mcap=false", *changes]), 1.0)
    testbed.run(scenario, write=False, observers=[borrower, keeper])
    return keeper, borrower


def test_who_keeps_frames_keeps_them_as_they_were():
    for page in ("simulation-3", "simulation-3-pixhawk", "engine-out-uav2", "ideal-figure-eight"):
        keeper, borrower = watched(page)
        assert len(keeper.frames) == 26
        for frame, seen, lent in zip(keeper.frames, keeper.seen, borrower.seen, strict=True):
            np.testing.assert_array_equal(numbers(frame), seen)
            np.testing.assert_array_equal(lent, seen)


def test_an_exact_estimate_is_the_truth_in_a_copy_too():
    keeper, borrower = watched("simulation-3")
    for frame in (*keeper.frames, *borrower.frames):
        assert frame.estimate is frame.truth
    keeper, _ = watched("simulation-3-pixhawk")
    assert all(frame.estimate is not frame.truth for frame in keeper.frames)


def test_what_is_lent_is_written_anew():
    """Or there would be nothing to keep: the same arrays at every frame."""
    _, borrower = watched("simulation-3")
    first, last = borrower.frames[0], borrower.frames[-1]
    assert first.truth.position_ned is last.truth.position_ned
    assert not np.array_equal(borrower.seen[0], borrower.seen[-1])
