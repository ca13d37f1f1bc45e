"""The horizontal variant: the law sees the plane, and the middle loop holds the altitude."""

from dataclasses import replace

import numpy as np
import pytest
from formation_cases import (
    NOW,
    flags,
    make_law,
    make_middle,
    middle,
    mixed_options,
    results,
    states,
    step,
)
from reference.frames import velocity_frame

from testbed.core.records import Messages
from testbed.formation import leader_filter as leading

SOURCES = {"nothing": leading.NOTHING, "broadcast": leading.BROADCAST, "turn": leading.TURN}


def shaken(own, inbox, memory, rng):
    """The same motion on the map, with other vertical motions of all aircraft."""
    n = len(own.airspeed)

    def lifted(array):
        other = array.copy()
        other[..., 2] += rng.normal(0.0, 3.0, other.shape[:-1])
        return other

    rates = inbox.euler_rates.copy()
    rates[..., 1] += rng.normal(0.0, 0.3, rates.shape[:-1])
    own = own._replace(
        position_ned=lifted(own.position_ned),
        velocity_ned=lifted(own.velocity_ned),
        acceleration_ned=lifted(own.acceleration_ned),
    )
    inbox = inbox._replace(
        position_ned=lifted(inbox.position_ned),
        velocity_ned=lifted(inbox.velocity_ned),
        acceleration_ned=lifted(inbox.acceleration_ned),
        euler_rates=rates,
    )
    memory = memory._replace(
        gamma=memory.gamma + rng.normal(0.0, 0.1, n),
        gamma_dot=memory.gamma_dot + rng.normal(0.0, 0.1, n),
    )
    return own, inbox, memory


@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_vertical_motion_has_no_effect(source):
    rng = np.random.default_rng(50)
    n = 6
    for of_airspeed in (False, True):
        options = {
            **mixed_options(n, rng),
            "horizontal": flags(True, n),
            "acceleration_source": np.full(n, source),
        }
        law = make_law(n, rng, bounds_of_airspeed=of_airspeed, **options)
        own, inbox, memory = states(n, rng, never=0.1, old=0.1)
        memory.omega[:, :2] = memory.omega_dot[:, :2] = 0.0  # ω_g in the plane
        calm, first = step(law, NOW, own, inbox, memory)
        other, second = step(law, NOW, *shaken(own, inbox, memory, rng))
        for name in calm._fields:
            ours, theirs = getattr(calm, name), getattr(other, name)
            np.testing.assert_array_equal(theirs, ours, err_msg=name)
        assert np.array_equal(first.acceleration[:, :2], second.acceleration[:, :2])
        # and nothing vertical is asked for
        assert (calm.omega[:, 1] == 0.0).all()
        assert (calm.direction[:, 2] == 0.0).all()


def test_vertical_motion_matters_in_three_axes():
    rng = np.random.default_rng(51)
    law = make_law(6, rng)
    known = states(6, rng)
    calm, _ = step(law, NOW, *known)
    other, _ = step(law, NOW, *shaken(*known, rng))
    assert (abs(calm.speed - other.speed) > 1e-3).all()
    assert (abs(calm.omega[:, 2] - other.omega[:, 2]) > 1e-5).all()


def test_in_a_level_world_both_variants_are_one():
    """Without vertical motion, gains and offsets both variants are equal."""
    rng = np.random.default_rng(52)
    n = 5
    law = make_law(n, rng, **{**mixed_options(n, rng), "horizontal": flags(False, n)})
    law = replace(law, offsets=law.offsets * [1.0, 1.0, 0.0])
    own, inbox, memory = states(n, rng)
    plane = {"position_ned": -100.0, "velocity_ned": 0.0, "acceleration_ned": 0.0}
    for record in (own, inbox):
        for name, value in plane.items():
            getattr(record, name)[..., 2] = value
    inbox.euler_rates[..., 1] = 0.0
    memory.acceleration[:, 2] = 0.0
    memory.gamma[:] = memory.gamma_dot[:] = 0.0
    ours = results(step(law, NOW, own, inbox, memory))
    theirs = results(step(replace(law, horizontal=flags(True, n)), NOW, own, inbox, memory))
    for name, array in ours.items():
        np.testing.assert_allclose(theirs[name], array, rtol=1e-12, atol=1e-14, err_msg=name)


@pytest.mark.parametrize("source", [leading.BROADCAST, leading.TURN], ids=["broadcast", "turn"])
@pytest.mark.parametrize("gamma", [0.0, 0.3])
def test_slot_beside_a_helix_is_a_level_circle(source, gamma):
    """By hand: the leader's shadow on the map turns at σ̇, and so does the slot beside it.

    The law asks for that circle, whatever the leader climbs; pitch is the altitude's PID alone.
    """
    turn, sigma, speed = 0.2, -0.7, 22.0
    level = speed * np.cos(gamma)
    offsets = np.array([[0.0, 0.0, 0.0], [-5.0, 8.0, 0.0], [-5.0, -8.0, -4.0]])
    law = make_law(
        2,
        np.random.default_rng(53),
        offsets=offsets,
        horizontal=flags(True, 2),
        acceleration_blend=np.ones((2, 3)),
        acceleration_source=np.full(2, source),
        angular_acceleration_source=np.full(2, leading.ROLL_RATE),
    )
    shadow = level * np.array([np.cos(sigma), np.sin(sigma), 0.0])
    frame = velocity_frame(shadow[None])[0]
    omega = np.array([0.0, 0.0, turn])
    chi = (offsets * [1.0, 1.0, 0.0]) @ frame.T
    position = np.array([40.0, -30.0, -100.0]) + chi
    velocity = shadow + np.cross(omega, chi)
    own, _, _ = states(2, np.random.default_rng(54))
    depth = np.array([-103.0, -97.0])
    own = own._replace(
        position_ned=np.column_stack([position[1:, :2], depth]),
        velocity_ned=velocity[1:].copy(),
        acceleration_ned=np.cross(omega, velocity[1:]),
        airspeed=np.linalg.norm(velocity[1:], axis=1),
    )
    sinking = np.array([0.0, 0.0, -speed * np.sin(gamma)])
    broadcast_velocity = np.vstack([shadow + sinking, velocity[1:]])
    now = np.full((2, 3), NOW)
    # a bank at which the coordinated turn by its bank is this turn
    bank = np.arctan(turn * level / leading.PAPER_GRAVITY)
    inbox = Messages(
        now,
        now,
        *(
            np.stack([each] * 2)
            for each in (position, broadcast_velocity, np.cross(omega, velocity))
        ),
        np.tile([bank, 0.0, sigma], (2, 3, 1)),
        np.tile(omega, (2, 3, 1)),
    )
    inputs, _ = step(law, NOW, own, inbox, law.start(own))
    ground_speed = np.linalg.norm(velocity[1:], axis=1)
    assert inputs.speed_desired == pytest.approx(ground_speed, rel=1e-13)
    assert inputs.speed == pytest.approx(ground_speed, rel=1e-12)
    assert inputs.omega == pytest.approx(np.tile(omega, (2, 1)), abs=1e-13)
    assert (inputs.limiter_flags == 0).all()

    held = {"altitude_p": 0.026, "altitude_i": 0.0017, "altitude_d": 0.0105}
    loop = make_middle(2, altitude=np.array([100.0, 100.0]), **held)
    memory = loop.start()._replace(altitude=np.array([1.0, -2.0]))
    command, after, _ = middle(loop, own, inputs, memory)
    assert command.pitch == pytest.approx([-0.026 * 3.0 - 0.0017, 0.026 * 3.0 + 0.0034], abs=1e-14)
    assert command.roll == pytest.approx(np.arctan(turn * ground_speed / 9.81), abs=1e-12)
    assert after.altitude == pytest.approx([1.0 + 0.04 * 3.0, -2.0 - 0.04 * 3.0], abs=1e-14)


def test_a_mixed_team_is_each_of_its_own_kind():
    """One agent holds an altitude, its neighbour flies all three: rows do not mix."""
    rng = np.random.default_rng(55)
    law = make_law(2, rng)
    known = states(2, rng)
    kinds = [flags(value, 2) for value in (False, True)]
    both = [results(step(replace(law, horizontal=kind), NOW, *known)) for kind in kinds]
    mixed = results(step(replace(law, horizontal=np.array([False, True])), NOW, *known))
    for name, array in mixed.items():
        np.testing.assert_array_equal(array[0], both[0][name][0], err_msg=name)
        np.testing.assert_array_equal(array[1], both[1][name][1], err_msg=name)
