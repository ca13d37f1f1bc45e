"""What the closed loop does not care about: where, which way, in whose order, in whose company."""

import numpy as np
import pytest
from closed_loop import State, fly
from reference.formation_laws import SpeedSet
from reference.frames import velocity_frame
from theorem_cases import one_formation, random_formations, scattered

TIMES = np.linspace(0.0, 5.0, 101)
# Two flights differ by roundings of positions of 1e3 m, and the loop forgets them as it converges.
SAME = 1e-9


def rotation(axis, angle):
    """The rotation matrix by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


@pytest.fixture(scope="module")
def original():
    """Three formations of four different agents, and what becomes of them."""
    rng = np.random.default_rng(15)
    formations = random_formations(rng, 3, 4)
    start = scattered(rng, formations)
    return formations, start, end_of(formations, start)


def end_of(formations, start):
    *_, (_, state) = fly(formations, start, TIMES)
    return state


def assert_same(found, expected):
    for ours, theirs in zip(found, expected, strict=True):
        assert ours == pytest.approx(theirs, abs=SAME)


def mapped(state, matrix):
    return State(state.q @ matrix.T, state.y @ matrix.T, state.s)


def test_rotation_about_the_vertical(original):
    formations, start, end = original
    turn = rotation([0.0, 0.0, 1.0], 2.1)
    lead = formations.leader
    turned = lead._replace(origin=lead.origin @ turn.T, course=lead.course + 2.1)
    found = end_of(formations.change(leader=turned), mapped(start, turn))
    assert_same(found, mapped(end, turn))


def test_translation(original):
    formations, start, end = original
    by = np.array([700.0, -300.0, 150.0])
    moved = formations.leader._replace(origin=formations.leader.origin + by)
    found = end_of(formations.change(leader=moved), start._replace(q=start.q + by))
    assert_same(found, end._replace(q=end.q + by))


def test_reflection(original):
    """East and west exchanged: slots to the right are then slots to the left."""
    formations, start, end = original
    mirror = np.diag([1.0, -1.0, 1.0])
    lead = formations.leader
    mirrored = lead._replace(
        origin=lead.origin @ mirror, course=-lead.course, course_rate=-lead.course_rate
    )
    found = end_of(
        formations.change(leader=mirrored, offsets=formations.offsets @ mirror),
        mapped(start, mirror),
    )
    assert_same(found, mapped(end, mirror))


def test_rotation_of_straight_flight_about_any_axis():
    """A straight flight may be turned about any axis if slots are turned with it, not by (24)."""
    formations = one_formation("straight")
    start = scattered(np.random.default_rng(16), formations)
    turn = rotation([1.0, -2.0, 0.7], 0.8)
    lead = formations.leader
    _, velocity, _ = lead.motion(0.0)
    after = velocity @ turn.T
    climb = -np.arcsin(after[:, 2] / lead.speed)
    course = np.arctan2(after[:, 1], after[:, 0])
    assert abs(climb[0]) > 0.3
    before_frame, after_frame = velocity_frame(velocity)[0], velocity_frame(after)[0]
    turned = formations.change(
        leader=lead._replace(origin=lead.origin @ turn.T, climb=climb, course=course),
        offsets=formations.offsets @ before_frame.T @ turn.T @ after_frame,
    )
    assert_same(end_of(turned, mapped(start, turn)), mapped(end_of(formations, start), turn))
    # the zero-roll frames themselves do not turn into each other
    assert abs(turn @ before_frame - after_frame).max() > 0.02


def chosen(formations, agents, columns):
    """The same formations with these agents (m n,) of theirs, and these columns of their gains."""
    pick = {name: getattr(formations, name)[agents] for name in ("k", "a", "b", "c", "pole")}
    return formations.change(
        offsets=formations.offsets.reshape(-1, 3)[agents].reshape(-1, len(columns) - 1, 3),
        gains=formations.gains[agents][:, columns],
        mu=type(formations.mu)(*(each[agents] for each in formations.mu)),
        barrier=type(formations.barrier)(*(each[agents] for each in formations.barrier)),
        speeds=SpeedSet(*(each[agents] for each in formations.speeds)),
        **pick,
    )


def test_permutation_of_the_agents(original):
    formations, start, end = original
    order = np.array([2, 0, 3, 1])
    agents = (np.arange(3)[:, None] * 4 + order).ravel()
    relabelled = chosen(formations, agents, np.concatenate([[0], order + 1]))
    found = end_of(relabelled, State(*(each[agents] for each in start)))
    assert_same(found, State(*(each[agents] for each in end)))


def test_formations_of_a_batch_are_independent(original):
    """What a batch of formations does, each does alone: the other tests fly batches."""
    formations, start, end = original
    for one in range(3):
        agents = np.arange(4 * one, 4 * one + 4)
        alone = chosen(formations, agents, np.arange(5)).change(
            leader=type(formations.leader)(*(each[one : one + 1] for each in formations.leader))
        )
        found = end_of(alone, State(*(each[agents] for each in start)))
        assert_same(found, State(*(each[agents] for each in end)))
