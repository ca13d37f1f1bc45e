"""The compiled laws do what the readable ones say, on thousands of random states."""

import ast
import importlib
import itertools
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from formation_cases import (
    HIGH,
    LOW,
    PAPERS_MU,
    choose,
    leaves,
    make_law,
    make_middle,
    middle_gains,
    middle_states,
    mixed_options,
    results,
    some_of,
    states,
    velocities,
)

import testbed
from testbed.formation import middle_loop as numpy_loop
from testbed.formation import paper_law as numpy_law
from testbed.formation.barrier import Barrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.formation.flags import Guard, Saturation
from testbed.formation.geometry import true_slots
from testbed.formation.measurement import ages
from testbed.formation.together import begun, silent, together
from testbed.frames import euler_rates

pytest.importorskip("numba")

from testbed.formation import (  # noqa: E402
    geometry_twin,
    laws_twin,
    middle_loop_twin,
    paper_twin,
    together_twin,
)
from testbed.vehicle import twin as vehicle_twin  # noqa: E402

FUNCTIONS = [PAPERS_MU, example_1(2.5e5, 1.0, 0.8), EXAMPLE_2, EXAMPLE_3]
BARRIERS = [Barrier(4, 0.02), Barrier(5, 0.05), Barrier(6, 1.0), Barrier(7, 0.0)]
AGENTS, STATES = 8, 100  # times four choices that all agents share: 3,200 states of agents
# The two take the same sums in other orders, so they differ by roundings of 1e-16, which (14)
# magnifies by 1/D, and example 5 by 1/(1 − tanh²), some 1e3 at 34 m/s.
TOLERANCE = 1e-11


def compare(ours, theirs):
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert theirs[name].dtype == array.dtype, name
        assert theirs[name].shape == array.shape, name
        np.testing.assert_array_equal(np.isnan(theirs[name]), np.isnan(array), err_msg=name)
        np.testing.assert_allclose(
            theirs[name], array, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name
        )


def any_of(choices, rng):
    return [choices[i] for i in rng.integers(0, len(choices), AGENTS)]


def test_the_formation_law():
    """Every agent with options of its own; agents of one law differ in all of them."""
    rng = np.random.default_rng(40)
    seen, deaf, held, dropped, known_news, news = 0, 0, 0, 0, 0, 0
    for from_timestamp, of_airspeed in itertools.product([False, True], repeat=2):
        for k in range(STATES):
            law = make_law(
                AGENTS,
                rng,
                mu=any_of(FUNCTIONS, rng),
                barrier=any_of(BARRIERS, rng),
                from_timestamp=from_timestamp,
                bounds_of_airspeed=of_airspeed,
                stale_after=rng.choice([0.2, 5.0]),
                **mixed_options(AGENTS, rng),
            )
            gaps = {"silence": 0.1, "old": 0.1} if k % 3 == 0 else {}
            own, inbox, memory = states(AGENTS, rng, **gaps)
            begun = np.where(rng.random(AGENTS) < 0.5, 1.0, np.nan)
            memory = memory._replace(
                silent_since=begun * rng.uniform(90.0, 99.0, AGENTS),
                silent_course=begun * rng.uniform(-np.pi, np.pi, AGENTS),
            )
            # bounds of the airspeed lie no farther from it than those of the ground speed do
            own = own._replace(airspeed=np.clip(own.airspeed, LOW - 4.0, HIGH + 4.0))
            ours = results(numpy_law.paper_step(law, 100.0, own, inbox, memory))
            compare(ours, results(paper_twin.paper_step(law, 100.0, own, inbox, memory)))
            seen |= int(np.bitwise_or.reduce(ours["told.guards"]))
            lost = (ours["told.guards"] & Guard.LEADER_SILENT) != 0
            stale = ~(100.0 - inbox.received_s <= law.stale_after) & ~lost[:, None]
            known = law.hold & ~np.isnan(memory.place[:, :, 0])
            heeded = (law.gains != 0.0).any(axis=2)[:, 1:]
            deaf += int(lost.sum())
            held += int((heeded & (stale & known)[:, 1:]).sum())
            dropped += int((heeded & (stale & ~known)[:, 1:]).sum())
            placed = ours["memory.place_time_s"] > memory.place_time_s
            fresh = heeded & (law.hold & known & ~stale & ~lost[:, None])[:, 1:]
            news += int((fresh & placed[:, 1:]).sum())
            known_news += int((fresh & ~placed[:, 1:]).sum())
    # the states reach every branch
    assert seen == sum(Guard) - Guard.SPEED_COMMAND_CLIPPED
    assert min(deaf, held, dropped, news, known_news) > 100


def test_a_law_of_some_of_the_agents():
    """Agents that step apart from the others know the same, and more aircraft than they are."""
    rng = np.random.default_rng(43)
    for _ in range(50):
        law = make_law(AGENTS, rng, **mixed_options(AGENTS, rng))
        own, inbox, memory = states(AGENTS, rng, silence=0.1, old=0.1)
        rows = rng.permutation(AGENTS)[:3]
        part = some_of(law, rows)
        given = (part, 100.0, *(choose(each, rows) for each in (own, inbox, memory)))
        compare(results(numpy_law.paper_step(*given)), results(paper_twin.paper_step(*given)))


def test_the_law_over_many_steps_of_its_own_memory():
    """What one engine remembers is what the other remembers, message after message."""
    rng = np.random.default_rng(44)
    law = make_law(AGENTS, rng, **{**mixed_options(AGENTS, rng), "hold": True})
    own, _, _ = states(AGENTS, rng)
    ours = theirs = law.start(own)
    for k in range(200):
        now = 100.0 + 0.04 * k
        own, inbox, _ = states(AGENTS, rng, silence=0.02, old=0.05, now=now)
        told, ours = numpy_law.paper_step(law, now, own, inbox, ours)
        said, theirs = paper_twin.paper_step(law, now, own, inbox, theirs)
        compare(results((told, ours)), results((said, theirs)))


def test_the_middle_loop():
    """Agents that hold an altitude beside agents that do not, with every gain there is."""
    rng = np.random.default_rng(45)
    seen = {"guards": 0, "saturations": 0}
    extras = ("altitude_p", "altitude_i", "altitude_d", "turn_incidence", "roll_lead", "eta_climb")
    for as_printed in (False, True):
        for _ in range(200):
            more = {name: rng.uniform(0.0, 0.1, AGENTS) for name in extras}
            gains = middle_gains(
                AGENTS,
                **more,
                incidence=rng.integers(0, 2, AGENTS),
                lead_filter=rng.uniform(0.0, 0.2, AGENTS),
                rate_filter=rng.choice([0.0, 0.06], AGENTS),
            )
            holds = np.where(rng.random(AGENTS) < 0.4, rng.normal(0.0, 10.0, AGENTS), np.nan)
            loop = replace(make_middle(AGENTS, altitude=holds, as_printed=as_printed), gains=gains)
            given = (loop, *middle_states(AGENTS, rng))
            ours = results(numpy_loop.middle_step(*given))
            compare(ours, results(middle_loop_twin.middle_step(*given)))
            for kind in seen:
                seen[kind] |= int(np.bitwise_or.reduce(ours[f"diagnosis.{kind}"]))
    assert seen == {"guards": sum(Guard), "saturations": sum(Saturation)}


def test_a_whole_step_of_some_of_the_agents():
    """Law, middle loop and ages behind one door, in rows of arrays that more agents share."""
    rng = np.random.default_rng(47)
    law = make_law(AGENTS, rng, **{**mixed_options(AGENTS, rng), "hold": True})
    loop = make_middle(AGENTS, altitude=np.where(rng.random(AGENTS) < 0.4, 90.0, np.nan))
    aircraft, engines = (
        law.gains.shape[1],
        (partial(partial, together), together_twin.ready_together),
    )
    for hold in (False, True):
        rows = rng.permutation(AGENTS)[:3]
        mine, middle = replace(some_of(law, rows), hold=hold), choose(loop, rows)
        unheeded, patience = rng.random((3, aircraft)) < 0.2, rng.uniform(0.1, 5.0, aircraft)
        both = []
        for _ in range(2):
            own, _, _ = states(AGENTS, np.random.default_rng(48))
            said = silent(np.zeros((3, AGENTS)), aircraft)
            both.append((begun(mine, middle, choose(own, rows)), said))
        for k in range(100):
            now = 100.0 + 0.04 * k
            own, inbox, _ = states(AGENTS, rng, silence=0.05, old=0.05, now=now)
            given = (mine, middle, unheeded, patience, rows, own, inbox, inbox.stamp_s)
            for ready, (memory, said) in zip(engines, both, strict=True):
                ready(*given, memory, said)(now)
            ours, theirs = ((*leaves(memory), *leaves(said)) for memory, said in both)
            compare(dict(ours), dict(theirs))
        (_, said), others = both[0], [i for i in range(AGENTS) if i not in rows]
        assert not said.command.pitch[others].any()
        assert said.command.roll[rows].all()
        assert 0 < np.isnan(said.age_s[rows]).sum() < said.age_s[rows].size


def test_ages():
    rng = np.random.default_rng(44)
    stamp = 100.0 - rng.uniform(0.0, 8.0, (40, 5))
    received = stamp + rng.uniform(0.0, 1.0, stamp.shape)
    received[rng.random(stamp.shape) < 0.2] = np.nan
    unheeded = rng.random(stamp.shape) < 0.3
    for limit, led in ((4.0, True), (np.array([4.0, 2.0, 2.0, np.inf, np.inf]), False)):
        given = (100.0, stamp, received, unheeded, limit, led)
        ours = ages(*given)
        assert 0 < np.isnan(ours).sum() < ours.size
        np.testing.assert_array_equal(laws_twin.ages(*given), ours)
    # who is held is not too old, as long as something was heard of it
    assert np.array_equal(np.isnan(ours)[:, 3:], (unheeded | np.isnan(received))[:, 3:])


def test_true_slots_and_errors():
    rng = np.random.default_rng(41)
    for n in (1, 3, 40):
        position, offsets = rng.normal(0.0, 300.0, (2, n + 1, 3))
        velocity = velocities(rng, (n + 1,), 10.0, 35.0)
        altitudes = np.where(rng.random(n) < 0.5, rng.normal(100.0, 10.0, n), np.nan)
        ours = true_slots(position, velocity, offsets, altitudes)
        theirs = geometry_twin.true_slots(position, velocity, offsets, altitudes)
        for one, two in zip(ours, theirs, strict=True):
            assert two == pytest.approx(one, abs=1e-12)  # roundings of some 1e3 m


def test_euler_rates():
    rng = np.random.default_rng(42)
    euler, rates = rng.uniform(-1.4, 1.4, (500, 3)), rng.normal(0.0, 1.0, (500, 3))
    ours, theirs = euler_rates(euler, rates), vehicle_twin.euler_rates(euler, rates)
    assert theirs == pytest.approx(ours, rel=1e-13, abs=1e-14)


def test_no_twin_goes_without_such_a_test():
    """Many of them are compared where their rooms are tested."""
    found = set()
    for path in Path(testbed.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            kind = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
            if kind in ("twin_of", "ready_of"):
                function, module = node.args
                twins = importlib.import_module(module.value)
                names = [function.id, f"ready_{function.id}"][: 1 + (kind == "ready_of")]
                assert any(hasattr(twins, name) for name in names)
                found.add(function.id)
    elsewhere = {"fbwa", "fly", "lost", "advance_ticks", "report"}
    elsewhere |= {"read", "write", "note", "look", "sense_air", "blow", "command"}  # flight models'
    elsewhere |= {"sample", "write_filters", "add_turbulence", "add_wakes"}  # the air's
    elsewhere |= {"befall", "post_round", "send_round", "take_due", "count"}  # the network's
    elsewhere |= {"sense", "jitter"}  # the sensors'
    elsewhere |= {"fly", "fly_ideal"}  # the leader's
    elsewhere |= {"beyond", "held", "gather"}  # of upsets, slots that are held, and rows
    elsewhere |= {"heard"}  # of who hears whom
    here = {"paper_step", "middle_step", "ages", "together"}
    here |= {"write_true_slots", "write_euler_rates"}
    assert found == here | elsewhere
