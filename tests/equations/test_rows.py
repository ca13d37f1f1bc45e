"""Arrays of frames as rows of bytes: what comes out is what went in, whoever copies it."""

import numpy as np
import pytest

from testbed.rows import READY_GATHER, Rows, gather
from testbed.state import Frame, VehicleState

SOURCES = ("truth.position_ned", "truth.airspeed", "lost")


def rows(room=20):
    return Rows(
        SOURCES,
        lambda frame: (frame.truth.position_ned, frame.truth.airspeed, frame.lost),
        room=room,
    )


def blank(n=3):
    truth = VehicleState(*np.zeros((5, n, 3)), *np.zeros((2, n)))
    others = (None,) * 5
    return Frame(0, 0.0, truth, truth, *others, np.zeros(n, bool))


def write(frame, k):
    place = frame.truth.position_ned
    place[:] = k + np.arange(place.size).reshape(-1, 3) / 7.0
    frame.truth.airspeed[:] = -k
    frame.lost[:] = [(k + i) % 2 for i in range(len(frame.lost))]


def check(columns, frames):
    assert list(columns) == list(SOURCES)
    for k, frame in enumerate(frames):
        write(frame, k)
        assert np.array_equal(columns["truth.position_ned"][k], frame.truth.position_ned)
        assert np.array_equal(columns["truth.airspeed"][k], frame.truth.airspeed)
        assert np.array_equal(columns["lost"][k], frame.lost)
    assert len(columns["lost"]) == len(frames)


def test_rows_of_arrays_that_stay_that_are_new_and_that_take_turns():
    kept, (one, other) = rows(), (blank(), blank())
    frames = [one, one, one, one, other, one, other, other, other, blank(), blank(), one, one, one]
    for _ in range(2):
        for k, frame in enumerate(frames):
            write(frame, k)
            kept.append(frame)
        check(kept.columns(), frames)
        kept.clear()


def test_one_array_may_be_another_while_the_rest_stays():
    kept, frame = rows(), blank()
    for k in range(9):
        if k == 5:
            frame = frame._replace(lost=np.zeros(3, bool))
        write(frame, k)
        kept.append(frame)
    check(kept.columns(), [frame] * 9)


def test_whose_estimates_are_not_the_truth():
    kept, one = rows(), blank()
    other = one._replace(tick=8, estimate=blank().truth)
    for frame in (one, other, other, one._replace(tick=24)):
        kept.append(frame)
    assert (kept.tick, kept.erring) == ([0, 8, 8, 24], [1, 2])
    kept.clear()
    kept.append(other)
    assert (kept.tick, kept.erring) == ([8], [0])


def test_arrays_of_another_size_or_type_are_refused():
    kept = rows()
    kept.append(blank())
    with pytest.raises(ValueError, match="not as large as those of the first frame"):
        kept.append(blank(4))
    wrong = blank()._replace(lost=np.zeros(3))
    with pytest.raises(TypeError, match="lost: float64 instead of bool"):
        rows().append(wrong)


def test_the_compiled_copy():
    rng = np.random.default_rng(44)
    arrays = [
        rng.normal(size=(5, 3)),
        rng.integers(0, 255, 7, dtype=np.uint8),
        rng.random(11) < 0.5,
        rng.integers(0, 2**32, (2, 3), dtype=np.uint32),
        np.zeros((0, 3)),
    ]
    size = sum(each.nbytes for each in arrays)
    ours, theirs = np.zeros((2, 4 * size), np.uint8)
    copy = READY_GATHER(arrays, theirs)
    for k in (2, 0, 3):
        for each in arrays:
            np.copyto(each, rng.permutation(each))
        gather(arrays, ours, k * size)
        copy(k * size)
        assert np.array_equal(ours, theirs)
    assert ours.any()
    assert not ours[size : 2 * size].any()


def test_an_array_with_gaps_is_not_copied_wrongly():
    gaps = np.arange(12.0).reshape(4, 3)[:, :2]
    octets = np.zeros(8 * gaps.size, np.uint8)
    with pytest.raises((ValueError, BufferError), match="contiguous"):
        READY_GATHER([gaps], octets)(0)
    assert not octets.any()
