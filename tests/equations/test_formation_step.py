"""One step of the whole law: who sees what, in whose order, and what silence does."""

import numpy as np
import pytest
from formation_cases import (
    HIGH,
    LOW,
    leaves,
    make_law,
    middle_gains,
    reorder,
    results,
    same,
    states,
)

from testbed.formation import law as room
from testbed.formation.flags import Guard, Saturation
from testbed.formation.law import paper_step
from testbed.formation.measurement import corrected_positions
from testbed.state import Inbox

NOW = 100.0


def engines():
    """The law as it is read and, where numba is, as it flies."""
    found = {"numpy": paper_step}
    try:
        from testbed.formation import twin
    except ImportError:
        return found
    return {**found, "numba": twin.paper_step}


ENGINES = engines()
each_engine = pytest.mark.parametrize("step", ENGINES.values(), ids=ENGINES)


def assert_same(ours, theirs, **tolerance):
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        np.testing.assert_allclose(array, theirs[name], err_msg=name, **tolerance)


# measurement correction, sec. 8.3


def test_measurements_are_brought_to_now_by_hand():
    # sent at 99.7, received at 99.9, used at 100: 0.1 s of 20 m/s or 0.3 s of it
    inbox = Inbox(
        np.array([[99.7]]),
        np.array([[99.9]]),
        np.array([[[5.0, 1.0, -100.0]]]),
        np.array([[[20.0, -10.0, 1.0]]]),
        np.zeros((1, 1, 3)),
        np.zeros((1, 1, 3)),
    )
    receipt = corrected_positions(inbox, NOW, from_timestamp=False)
    assert receipt[0, 0] == pytest.approx([7.0, 0.0, -99.9], abs=1e-11)
    stamped = corrected_positions(inbox, NOW, from_timestamp=True)
    assert stamped[0, 0] == pytest.approx([11.0, -2.0, -99.7], abs=1e-11)


@each_engine
def test_without_a_delay_both_ways_agree(step):
    rng = np.random.default_rng(20)
    law = make_law(3, rng)
    own, inbox, memory = states(3, rng)
    inbox = inbox._replace(received_s=inbox.stamp_s)
    ours = results(step(law, NOW, own, inbox, memory))
    theirs = results(step(law._replace(from_timestamp=True), NOW, own, inbox, memory))
    assert_same(ours, theirs, rtol=0, atol=0)


# silence


@each_engine
def test_who_has_not_heard_the_leader_flies_wings_level_at_trim(step):
    rng = np.random.default_rng(21)
    law = make_law(3, rng, middle=middle_gains(3, trim_throttle=0.31))
    own, inbox, memory = states(3, rng)
    for each in inbox:
        each[1, 0] = np.nan
    command, after, diagnosis = step(law, NOW, own, inbox, memory)
    assert (command.pitch[1], command.roll[1], command.throttle[1]) == (0.0, 0.0, 0.31)
    assert [float(integral[1]) for integral in after.integrals] == [0.0, 0.0, 0.0]
    assert np.isnan(diagnosis.age_s[1, 0])
    for name, array in results((command, after, diagnosis)).items():
        assert name == "diagnosis.age_s" or np.isfinite(array).all(), name
    # nothing of that leaks to the others
    assert command.throttle[0] != 0.31
    assert after.integrals.climb[0] != 0.0


@each_engine
def test_a_neighbour_not_heard_is_left_out_of_the_sum(step):
    rng = np.random.default_rng(22)
    law = make_law(3, rng, gains=rng.uniform(0.5, 1.0, (3, 4, 3)))
    own, inbox, memory = states(3, rng)
    without = law._replace(gains=law.gains.copy())
    without.gains[0, 2] = 0.0
    silent = Inbox(*(each.copy() for each in inbox))
    for each in silent:
        each[0, 2] = np.nan
    ours = step(law, NOW, own, silent, memory)
    theirs = step(without, NOW, own, inbox, memory)
    assert_same(
        results((*ours[:2], ours[2]._replace(age_s=theirs[2].age_s))), results(theirs), rtol=1e-12
    )
    heard = step(law, NOW, own, inbox, memory)[2]
    assert abs(ours[2].course_desired[0] - heard.course_desired[0]) > 1e-3


@each_engine
def test_without_feedback_gains_the_leader_is_still_followed_in_velocity(step):
    # β_i = 0 removes the position feedback alone: (7), (10), (22) hear the leader all the same
    rng = np.random.default_rng(23)
    law = make_law(2, rng, gains=np.zeros((2, 3, 3)), offsets=np.zeros((3, 3)))
    own, inbox, memory = states(2, rng)
    diagnosis = step(law, NOW, own, inbox, memory)[2]
    leader = inbox.velocity_ned[:, 0]
    assert diagnosis.course_desired == pytest.approx(np.arctan2(leader[:, 1], leader[:, 0]))
    assert diagnosis.speed_desired == pytest.approx(np.linalg.norm(leader, axis=1))


# guards


@each_engine
def test_guards_say_what_they_did(step):
    rng = np.random.default_rng(24)
    law = make_law(3, rng, gains=np.zeros((3, 4, 3)), offsets=np.zeros((4, 3)))
    own, inbox, memory = states(3, rng)
    course = np.array([1.0, 0.0, 0.0])
    # all is well; the leader is too slow; own speed is beyond the bound
    inbox.velocity_ned[:, 0] = np.array([[22.0], [15.0], [22.0]]) * course
    inbox.acceleration_ned[:] = 0.0
    memory.leader_acceleration[:] = 0.0
    inbox.euler_rates[:] = 0.0
    own.velocity_ned[:] = np.array([[22.0], [20.0], [31.0]]) * course
    own.airspeed[:] = own.velocity_ned[:, 0]
    diagnosis = step(law, NOW, own, inbox, memory)[2]
    margin = law.speeds.margin[1]
    assert diagnosis.guards[0] == 0
    assert diagnosis.guards[1] & Guard.SPEED_DESIRED_CLAMPED
    assert diagnosis.speed_desired == pytest.approx([22.0, LOW + margin, 22.0], abs=1e-12)
    assert diagnosis.guards[2] == Guard.OUTSIDE_SPEED_SET | Guard.SPEED_COMMAND_CLIPPED
    assert diagnosis.speed_command[2] == LOW
    assert diagnosis.guards.dtype == diagnosis.saturations.dtype == np.uint8


@each_engine
def test_the_commanded_airspeed_stays_in_the_bounds(step):
    rng = np.random.default_rng(25)
    law = make_law(400, rng)
    diagnosis = step(law, NOW, *states(400, rng))[2]
    assert (diagnosis.speed_command >= LOW).all()
    assert (diagnosis.speed_command <= HIGH).all()
    clipped = (diagnosis.guards & Guard.SPEED_COMMAND_CLIPPED) != 0
    at_bound = (diagnosis.speed_command == LOW) | (diagnosis.speed_command == HIGH)
    assert (clipped == at_bound).all()
    assert 0 < clipped.sum() < 400


# the error of (21)


@each_engine
@pytest.mark.parametrize("wind", [0.0, 5.0])
def test_the_two_readings_of_21_differ_by_the_wind(step, wind):
    """As printed, s_a − u asks for u in the air; the other asks for u over the ground."""
    rng = np.random.default_rng(26)
    p_only = middle_gains(2, speed_i=0.0, speed_p=0.01, eta_speed=0.0, eta_bank=0.0)
    law = make_law(2, rng, middle=p_only, gains=np.zeros((2, 3, 3)), offsets=np.zeros((3, 3)))
    own, inbox, memory = states(2, rng, low=21.0, high=23.0)
    inbox.velocity_ned[:, 0] = 1.01 * own.velocity_ned
    inbox.acceleration_ned[:] = 0.0
    inbox.euler_rates[:] = 0.0
    memory.leader_acceleration[:] = 0.0
    own.airspeed[:] = np.linalg.norm(own.velocity_ned, axis=1) + wind
    ground, _, told = step(law, NOW, own, inbox, memory)
    printed, _, _ = step(law._replace(airspeed_error_as_printed=True), NOW, own, inbox, memory)
    assert (told.guards == 0).all()
    assert ground.throttle == pytest.approx(
        0.22 - 0.01 * (own.airspeed - told.speed_command), abs=1e-14
    )
    # s_a − u = s − u + wind
    assert printed.throttle == pytest.approx(ground.throttle - 0.01 * wind, abs=1e-12)


# the composition


@each_engine
@pytest.mark.parametrize("gamma", [0.0, 0.3, -0.25])
def test_whoever_is_in_its_slot_on_a_steady_helix_asks_for_that_helix(step, gamma):
    """Leader and slots turn about one axis, so every rate is known and every error is zero.

    Then s_d = s, u = s, γ_d = γ, σ_d = σ and σ̇_d is the leader's σ̇: (19) is γ, (20) is the bank
    of a coordinated turn at the agent's own speed, and (21) is its feed-forward.
    """
    n, turn, sigma = 3, 0.2, 2.9
    law = make_law(
        n,
        np.random.default_rng(37),
        offsets=np.array([[0.0, 0.0, 0.0], [-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0], [9.0, 0.0, 4.0]]),
        acceleration_blend=np.ones(3),
        rate_blend=np.ones(n),
    )
    cs, ss, cg, sg = np.cos(sigma), np.sin(sigma), np.cos(gamma), np.sin(gamma)
    matrix = np.array([[cg * cs, -ss, sg * cs], [cg * ss, cs, sg * ss], [-sg, 0.0, cg]])
    omega = np.array([0.0, 0.0, turn])
    chi = law.offsets @ matrix.T
    position = np.array([40.0, -30.0, -100.0]) + chi
    velocity = 22.0 * matrix[:, 0] + np.cross(omega, chi)
    acceleration = np.cross(omega, velocity)
    speed = np.linalg.norm(velocity[1:], axis=1)
    own, inbox, _ = states(n, np.random.default_rng(38))
    own = own._replace(
        position_ned=position[1:].copy(),
        velocity_ned=velocity[1:].copy(),
        acceleration_ned=acceleration[1:].copy(),
        airspeed=speed + 2.0,
    )
    now = np.full((n, n + 1), NOW)
    rates = np.tile(omega, (n, n + 1, 1))
    heard = (np.stack([each] * n) for each in (position, velocity, acceleration))
    command, after, told = step(law, NOW, own, Inbox(now, now, *heard, rates), law.start(own))

    climb = np.arcsin(-velocity[1:, 2] / speed)
    assert told.speed_desired == pytest.approx(speed, rel=1e-13)
    assert told.speed_command == pytest.approx(speed + 2.0, rel=1e-12)
    assert (told.guards == 0).all()
    assert command.pitch == pytest.approx(climb, abs=1e-12)
    assert command.roll == pytest.approx(np.arctan(turn * speed * np.cos(climb) / 9.81), abs=1e-12)
    bank = np.cos(own.euler[:, 0]) ** -2 - 1.0
    assert command.throttle == pytest.approx(
        np.clip(0.22 + 0.12 * bank + 0.1 * (speed + 2.0 - 22.0), 0.0, 1.0), abs=1e-12
    )
    for integral in after.integrals:
        assert integral == pytest.approx(np.zeros(n), abs=1e-12)


# filters


@each_engine
def test_filters_are_exponential_averages(step):
    rng = np.random.default_rng(27)
    law = make_law(3, rng)
    own, inbox, memory = states(3, rng)
    _, after, _ = step(law, NOW, own, inbox, memory)
    heard, last = inbox.acceleration_ned[:, 0], memory.leader_acceleration
    blend = law.acceleration_blend
    assert after.leader_acceleration == pytest.approx((1 - blend) * last + blend * heard, abs=1e-14)
    start = law.start(own)
    keep = 1.0 - law.rate_blend
    for name in ("course_rate", "climb_rate"):
        measured = getattr(start, name)
        expected = keep * getattr(memory, name) + law.rate_blend * measured
        assert getattr(after, name) == pytest.approx(expected, abs=1e-14)


# symmetries


@each_engine
def test_the_order_of_the_agents_does_not_matter(step):
    rng = np.random.default_rng(28)
    n, order = 5, np.array([3, 0, 4, 1, 2])
    everyone = np.concatenate([[0], order + 1])
    for _ in range(20):
        law = make_law(n, rng)
        own, inbox, memory = states(n, rng, silence=0.1)
        ours = results(step(law, NOW, own, inbox, memory))
        law, own, inbox, memory = reorder(law, own, inbox, memory, order)
        theirs = results(step(law, NOW, own, inbox, memory))
        expected = {name: array[order] for name, array in ours.items()}
        expected["diagnosis.age_s"] = expected["diagnosis.age_s"][:, everyone]
        # sums over neighbours run in another order; (14) magnifies that where D is small
        assert_same(theirs, expected, rtol=1e-9, atol=1e-11)


@each_engine
def test_an_agent_alone_is_the_same_agent_in_a_crowd(step):
    """To the bit: an agent is moved to the front, and the rows of the others are cut off."""
    rng = np.random.default_rng(29)
    n = 7
    law = make_law(n, rng)
    # the leader and one neighbour: sums of two terms, whose order changes no bit
    law.gains[:, 1:] = 0.0
    law.gains[np.arange(n), 1 + (np.arange(n) + 1) % n] = rng.uniform(0.2, 1.0, (n, 3))
    own, inbox, memory = states(n, rng)
    together = results(step(law, NOW, own, inbox, memory))
    for i in range(n):
        order = np.roll(np.arange(n), -i)
        moved = reorder(law, own, inbox, memory, order)
        alone = results(step(first(moved[0]), NOW, *map(first, moved[1:])))
        for name, array in alone.items():
            if name != "diagnosis.age_s":
                assert np.array_equal(array[0], together[name][i]), name


def first(record):
    """Row 0 of everything that has a row per agent."""
    shared = ("offsets", "acceleration_blend")
    cut = {}
    for name, value in zip(record._fields, record, strict=True):
        if isinstance(value, np.ndarray) and name not in shared:
            cut[name] = np.ascontiguousarray(value[:1])
        elif name in ("speeds", "middle", "integrals"):
            cut[name] = first(value)
    return record._replace(**cut)


@each_engine
def test_the_world_may_be_turned_about_the_vertical_and_moved(step):
    rng = np.random.default_rng(30)
    n, angle, shift = 4, 2.2, np.array([300.0, -700.0, 40.0])
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    level = np.ones((n, n + 1, 3)) * rng.uniform(0.2, 1.0, (n, n + 1, 1))
    for _ in range(20):
        law = make_law(n, rng, gains=level)  # per-axis gains would not turn with the world
        own, inbox, memory = states(n, rng, low=LOW + 0.5, high=HIGH - 0.5)
        straight = results(step(law, NOW, own, inbox, memory))
        own = own._replace(
            position_ned=own.position_ned @ turn.T + shift,
            velocity_ned=own.velocity_ned @ turn.T,
            acceleration_ned=own.acceleration_ned @ turn.T,
            euler=own.euler + [0.0, 0.0, angle],
        )
        inbox = inbox._replace(
            position_ned=inbox.position_ned @ turn.T + shift,
            velocity_ned=inbox.velocity_ned @ turn.T,
            acceleration_ned=inbox.acceleration_ned @ turn.T,
        )
        memory = memory._replace(leader_acceleration=memory.leader_acceleration @ turn.T)
        turned = results(step(law, NOW, own, inbox, memory))
        heading = "diagnosis.course_desired"
        off = turned.pop(heading) - straight.pop(heading) - angle
        assert np.sin(0.5 * off) == pytest.approx(0.0, abs=1e-12)
        accelerated = "memory.leader_acceleration"
        straight[accelerated] = straight[accelerated] @ turn.T
        # positions of 700 m carry 1e-13 m; (14) magnifies that where D is small
        assert_same(turned, straight, rtol=1e-8, atol=1e-10)


# purity


@each_engine
def test_a_step_writes_into_nothing_it_is_given(step):
    rng = np.random.default_rng(31)
    law = make_law(3, rng)
    given = (law, *states(3, rng, silence=0.2))
    before = [{name: np.copy(a) for name, a in leaves(record)} for record in given]
    step(given[0], NOW, *given[1:])
    for record, copies in zip(given, before, strict=True):
        for name, array in leaves(record):
            np.testing.assert_array_equal(array, copies[name], err_msg=name)


@each_engine
def test_an_agent_sees_its_own_row_alone(step):
    """Changing what one agent knows changes that agent's command and no other's."""
    rng = np.random.default_rng(32)
    n = 4
    law = make_law(n, rng)
    own, inbox, memory = states(n, rng)
    calm = results(step(law, NOW, own, inbox, memory))
    others = np.arange(n) != 2
    for record in (own, inbox, *memory[:1], memory):
        for name, array in leaves(record):
            array[2] += 0.5
            shaken = results(step(law, NOW, own, inbox, memory))
            array[2] -= 0.5
            for result, values in shaken.items():
                np.testing.assert_array_equal(
                    values[others], calm[result][others], err_msg=f"{name} -> {result}"
                )


def test_the_law_starts_at_rest_with_the_rates_it_measures():
    rng = np.random.default_rng(33)
    law = make_law(3, rng)
    own, _, _ = states(3, rng)
    memory = law.start(own)
    assert all((integral == 0.0).all() for integral in memory.integrals)
    horizontal = own.velocity_ned[:, 0] ** 2 + own.velocity_ned[:, 1] ** 2
    across = (
        own.velocity_ned[:, 0] * own.acceleration_ned[:, 1]
        - own.velocity_ned[:, 1] * own.acceleration_ned[:, 0]
    )
    assert memory.course_rate == pytest.approx(across / horizontal, rel=1e-12)


def test_saturated_commands_are_flagged():
    rng = np.random.default_rng(34)
    law = make_law(200, rng, middle=middle_gains(200, roll_limit=0.3))
    command, _, diagnosis = paper_step(law, NOW, *states(200, rng))
    rolled = (diagnosis.saturations & Saturation.ROLL) != 0
    assert (rolled == (abs(command.roll) == 0.3)).all()
    assert 0 < rolled.sum() < 200


def test_the_step_that_flies_is_the_step_that_is_read():
    assert room.STEP.__wrapped__ is paper_step
    law = make_law(2, np.random.default_rng(35))
    own, inbox, memory = states(2, np.random.default_rng(36))
    flown = results(law.step(NOW, own, inbox, memory))
    assert_same(flown, results(paper_step(law, NOW, own, inbox, memory)), rtol=1e-10, atol=1e-12)
    assert (law.k == same(law.k[0], 2)).sum() == 1
