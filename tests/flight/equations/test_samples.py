"""Blocks and copies of samples equal the samples, also of arrays of the loop."""

import numpy as np
import pytest

from testbed.core import samples as core_samples
from testbed.core.records import AIRCRAFT, FOLLOWER, LINK, FaultState, VehicleState, allocate
from testbed.core.samples import SampleBuffer, copy_sample, make_sample
from testbed.flight.observers import Observers

N = 3


def new_run(n=N):
    return allocate(AIRCRAFT, n), allocate(FOLLOWER, n - 1), allocate(LINK, n - 1, n)


def sample_of(run, *, exact=False, faults=False):
    return make_sample(*run, exact=exact, faults=faults)


def fill(run, seed):
    """Write other numbers into every field of the records of a run."""
    rng = np.random.default_rng(seed)
    for records in run:
        _fill(records, rng)


def _fill(records, rng):
    for name in records.dtype.names:
        kind, field = records.dtype[name].base, records[name]
        if kind.names:
            _fill(field, rng)
        elif kind.kind == "b":
            field[...] = rng.random(field.shape) < 0.5
        elif kind.kind in "iu":
            field[...] = rng.integers(0, 100, field.shape)
        else:
            field[...] = rng.normal(size=field.shape)


def arrays(sample):
    """Every array of a sample by its path, copied."""
    found = {"lost": np.array(sample.lost)}
    records = ("truth", "estimate", "air", "command", "surfaces", "formation", "links", "faults")
    for name in records:
        record = getattr(sample, name)
        if record is not None:
            found |= {f"{name}.{field}": np.array(each) for field, each in record._asdict().items()}
    return found


def without_records(sample):
    """A sample as an own program makes it: arrays that are no views of records."""
    copied = {}
    for name in sample._fields:
        value = getattr(sample, name)
        if hasattr(value, "_fields"):
            copied[name] = type(value)(*(np.array(each) for each in value))
    return sample._replace(**copied, lost=np.array(sample.lost), records=None)


@pytest.mark.parametrize("change", [lambda sample: sample, without_records], ids=["run", "own"])
def test_columns_of_a_block_are_the_samples_one_by_one(change, monkeypatch):
    monkeypatch.setattr(core_samples, "_BLOCK_AIRCRAFT_SAMPLES", 10 * N)
    run, buffer = new_run(), SampleBuffer(N)
    sample = sample_of(run)
    for taken, count in ((0, 7), (7, 3), (10, 4), (14, 0)):
        ticks, kept = [8 * k for k in range(taken, taken + count)], []
        for tick in ticks:
            fill(run, tick)
            buffer.append(change(sample._replace(tick=tick)))
            kept.append(arrays(sample))
        assert buffer.is_full == (buffer.total == 10)
        new = buffer.since(taken)
        assert new.ticks.tolist() == ticks
        assert {len(rows) for rows in new.columns.values()} == {count}
        for k, expected in enumerate(kept):
            assert set(new.columns) == set(expected)
            for path, rows in new.columns.items():
                assert rows.dtype == expected[path].dtype, path
                np.testing.assert_array_equal(rows[k], expected[path], err_msg=path)


def test_block_marks_inexact_estimates():
    run, buffer = new_run(), SampleBuffer(N)
    for tick, exact in ((0, True), (8, False), (16, False), (24, True)):
        buffer.append(sample_of(run, exact=exact)._replace(tick=tick))
    assert buffer.since(0).inexact.tolist() == [False, True, True, False]
    assert buffer.since(2).inexact.tolist() == [True, False]


@pytest.mark.parametrize("change", [lambda sample: sample, without_records], ids=["run", "own"])
def test_samples_of_other_sizes_are_refused(change):
    block = SampleBuffer(N)
    block.append(change(sample_of(new_run())))
    with pytest.raises(ValueError, match=f"the sample has {N + 1} aircraft"):
        block.append(change(sample_of(new_run(N + 1))))


def test_sample_views_records_and_copies_do_not():
    run = new_run()
    sample = sample_of(run, faults=True)
    assert isinstance(sample.truth, VehicleState)
    assert isinstance(sample.faults, FaultState)
    fill(run, 1)
    seen, copied = arrays(sample), copy_sample(sample._replace(tick=3, time_s=0.5))
    fill(run, 2)
    assert (copied.tick, copied.time_s) == (3, 0.5)
    for path, array in arrays(copied).items():
        np.testing.assert_array_equal(array, seen[path], err_msg=path)
    now = arrays(sample)
    assert not np.array_equal(now["truth.position_ned"], seen["truth.position_ned"])
    assert np.array_equal(now["truth.position_ned"], run[0]["truth"]["position_ned"])


@pytest.mark.parametrize("exact", [False, True])
def test_an_exact_estimate_is_the_truth_in_a_copy_too(exact):
    sample = sample_of(new_run(), exact=exact)
    for each in (sample, copy_sample(sample)):
        assert (each.estimate is each.truth) == exact


class Watcher:
    def __init__(self, **attributes):
        self.frames, self.seen = [], []
        self.__dict__.update(attributes)

    def observe(self, sample):
        self.frames.append(sample)
        self.seen.append(arrays(sample))


def test_observers_get_arrays_or_copies():
    run = new_run()
    keeper, other, borrower = Watcher(), Watcher(zero_copy=False), Watcher(zero_copy=True)
    observers, sample = Observers([keeper, borrower, other], N), sample_of(run)
    for k in range(3):
        fill(run, k)
        observers.observe(sample._replace(tick=k))
    for k, (frame, seen, lent) in enumerate(
        zip(keeper.frames, keeper.seen, borrower.seen, strict=True)
    ):
        assert frame.tick == k
        for path, array in arrays(frame).items():
            np.testing.assert_array_equal(array, seen[path], err_msg=path)
            np.testing.assert_array_equal(lent[path], seen[path], err_msg=path)
    assert all(one is two for one, two in zip(keeper.frames, other.frames, strict=True))
    first, last = borrower.frames[0], borrower.frames[-1]
    assert first.truth.position_ned is last.truth.position_ned
