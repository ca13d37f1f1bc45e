"""Loss by distance and behind airframes: worked geometry, and what must not matter."""

import numpy as np
import pytest
from reference.frames import rotation_ned_body

from testbed.network.fading import fading, make_curves
from testbed.network.links import resolve_links
from testbed.scenario.network import Network

NAMES = ("leader", "uav1", "uav2")
LINEAR = [[0, 0], [90, 0.9]]  # a loss of one percent per degree
SHADOWING = {"shadowing": {"loss": LINEAR}}


def faded(network, position, euler_deg):
    curves = make_curves(resolve_links(NAMES[: len(position)], Network.model_validate(network)))
    return fading(np.array(position, float), np.radians(euler_deg), curves)


def one_link(position, euler_deg, network=SHADOWING):
    """Loss from the leader, at the origin, to a follower at a position."""
    return faded(network, [[0, 0, 0], position], euler_deg)[0, 0]


LEVEL = [0, 0, 0]


@pytest.mark.parametrize(
    ("distance", "loss"), [(100, 0.0), (500, 0.0), (750, 0.25), (1000, 0.5), (2000, 1.0), (9e3, 1)]
)
def test_loss_by_distance_is_interpolated(distance, loss):
    network = {"range_loss": [[500, 0], [1000, 0.5], [2000, 1]]}
    assert one_link([0.6 * distance, 0, -0.8 * distance], [LEVEL, LEVEL], network) == (
        pytest.approx(loss)
    )


# Position of the follower, the leader being at the origin; attitudes of both; and how many degrees
# the airframes are in the way at either end. Antennas are below: with the right wing down they look
# to the left.
GEOMETRY = {
    "level and abeam: nothing in the way": ([0, 9, 0], LEVEL, LEVEL, 0, 0),
    "follower 30 degrees higher: the leader's wings": ([-np.sqrt(3), 0, -1], LEVEL, LEVEL, 30, 0),
    "follower 30 degrees lower: its own wings": ([-np.sqrt(3), 0, 1], LEVEL, LEVEL, 0, 30),
    "leader banks right by 90, follower left of it": ([0, -9, 0], [90, 0, 0], LEVEL, 0, 0),
    "leader banks right by 90, follower right of it": ([0, 9, 0], [90, 0, 0], LEVEL, 90, 0),
    "leader banks left by 40, follower left of it": ([0, -9, 0], [-40, 0, 0], LEVEL, 40, 0),
    "the same, flying east": ([9, 0, 0], [-40, 0, 90], LEVEL, 40, 0),
    "both bank right by 30, follower right": ([0, 9, 0], [30, 0, 0], [30, 0, 0], 30, 0),
    "both bank right by 30, follower left": ([0, -9, 0], [30, 0, 0], [30, 0, 0], 0, 30),
    "towards each other": ([0, 9, 0], [20, 0, 0], [-50, 0, 0], 20, 50),
    "leader's nose 10 up, follower behind": ([-9, 0, 0], [0, 10, 0], LEVEL, 10, 0),
    "leader's nose 10 down, follower behind": ([-9, 0, 0], [0, -10, 0], LEVEL, 0, 0),
    "follower upside down above": ([0, 0, -9], LEVEL, [180, 0, 0], 90, 90),
}


@pytest.mark.parametrize(
    ("position", "leader", "own", "first", "second"), GEOMETRY.values(), ids=GEOMETRY
)
def test_shadow_of_either_airframe(position, leader, own, first, second):
    expected = 1 - (1 - 0.01 * first) * (1 - 0.01 * second)
    assert one_link(position, [leader, own]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("position", "leader", "own", "first", "second"), GEOMETRY.values(), ids=GEOMETRY
)
def test_antenna_above_mirrors_one_below(position, leader, own, first, second):
    """Down becomes up: positions and pitch change sign, roll is past the vertical the other way."""
    mirrored = [position[0], position[1], -position[2]]
    flipped = [[-each[0], -each[1], each[2]] for each in (leader, own)]
    above = {"shadowing": {"antenna": "above", "loss": LINEAR}}
    expected = one_link(position, [leader, own])
    assert one_link(mirrored, flipped, above) == pytest.approx(expected, abs=1e-12)


def test_distance_and_airframes_are_independent():
    network = {"range_loss": [[0, 0.5]], **SHADOWING}
    loss = one_link([0, 9, 0], [[20, 0, 0], [-50, 0, 0]], network)
    assert loss == pytest.approx(1 - 0.5 * 0.8 * 0.5)


def turned(euler, rotation):
    """The attitudes (N, 3) after the world was turned."""
    body = rotation @ rotation_ned_body(euler)
    return np.stack(
        [
            np.arctan2(body[:, 2, 1], body[:, 2, 2]),
            -np.arcsin(body[:, 2, 0]),
            np.arctan2(body[:, 1, 0], body[:, 0, 0]),
        ],
        axis=-1,
    )


def random_formation(seed, aircraft):
    rng = np.random.default_rng(seed)
    euler = rng.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], (aircraft, 3))
    return rng.normal(0.0, 300.0, (aircraft, 3)), euler, rng


BOTH = {"range_loss": [[100, 0], [900, 1]], "shadowing": {"loss": [[5, 0.1], [60, 0.95]]}}


@pytest.mark.parametrize("seed", range(5))
def test_rotation_and_translation_change_nothing(seed):
    position, euler, rng = random_formation(seed, 7)
    names = tuple(f"uav{k}" for k in range(7))
    curves = make_curves(resolve_links(names, Network.model_validate(BOTH)))
    rotation = rotation_ned_body(rng.uniform(-3.0, 3.0, 3))
    moved = position @ rotation.T + [1e3, -2e3, 500.0]
    before = fading(position, euler, curves)
    assert before.min() >= 0.0 and before.max() <= 1.0 and np.ptp(before) > 0.5
    assert np.allclose(fading(moved, turned(euler, rotation), curves), before, atol=1e-9)


def test_both_directions_of_a_link_fade_alike():
    """The two ends change places, and what is in the way is the same."""
    position, euler, _ = random_formation(5, 6)
    curves = make_curves(resolve_links(tuple("abcdef"), Network.model_validate(BOTH)))
    loss = fading(position, euler, curves)
    between = loss[:, 1:]
    assert np.allclose(between, between.T, atol=1e-12)


def test_all_links_match_each_link_alone():
    network = {
        **SHADOWING,
        "links": {
            "leader": {"uav2": {"range_loss": [[0, 0.2], [1000, 0.6]], "shadowing": {"loss": []}}},
            "uav1": {"*": {"shadowing": {"antenna": "above", "loss": [[0, 0.1], [80, 1]]}}},
        },
    }
    position, euler, _ = random_formation(6, 3)
    loss = faded(network, position, np.degrees(euler))
    assert loss[0, 1] == loss[1, 2] == 0.0  # own links
    distance = np.linalg.norm(position[2] - position[0])
    assert loss[1, 0] == pytest.approx(np.interp(distance, [0, 1000], [0.2, 0.6]))

    def past(end, other, sign):
        sight = position[other] - position[end]
        below = rotation_ned_body(euler[end])[:, 2] @ sight / np.linalg.norm(sight)
        return np.degrees(np.arcsin(-sign * below))

    for (i, m), sign, curve in (
        ((0, 0), 1, LINEAR),
        ((0, 2), 1, LINEAR),
        ((1, 1), -1, [[0, 0.1], [80, 1]]),
    ):
        x, p = np.transpose(curve)
        ends = np.interp([past(m, i + 1, sign), past(i + 1, m, sign)], x, p)
        assert loss[i, m] == pytest.approx(1 - np.prod(1 - ends)), (i, m)


def test_two_aircraft_in_one_place_are_not_shadowed():
    assert one_link([0, 0, 0], [[90, 0, 0], LEVEL]) == 0.0


def test_no_curves_give_none():
    for network in ({}, {"range_loss": []}, {"shadowing": {"loss": []}}):
        assert make_curves(resolve_links(NAMES, Network.model_validate(network))) is None
