"""Ticks: what happens when, alone and at phases of one's own, and that nothing is missed."""

import itertools

import numpy as np
import pytest

from testbed.errors import InputError
from testbed.sim.clock import make_clock

RATES = {"physics_hz": 200, "autopilot_hz": 50, "control_hz": 25, "broadcast_hz": 25, "log_hz": 10}
# One rate within another, none within another, and one tick for everything.
COMBINATIONS = [
    (200, 50, 25, 25, 25),
    (200, 50, 25, 10, 20),
    (400, 100, 50, 10, 20),
    (200, 50, 40, 25, 8),
    (120, 60, 40, 24, 30),
    (50, 50, 50, 50, 50),
]
every = pytest.mark.parametrize("rates", COMBINATIONS, ids=str)


def clock_of(rates, **more):
    return make_clock(**dict(zip(RATES, rates, strict=True)), **more)


def events(clock, duration_s):
    """(tick, what, who) of everything that happens; who of the aircraft, 0 the leader."""
    for tick, due, *_ in clock.schedule(duration_s):
        for what in ("lead", "autopilot", "log"):
            if getattr(due, what):
                yield tick, what, None
        if due.broadcast is not None:
            yield from ((tick, "broadcast", m) for m in np.flatnonzero(due.broadcast).tolist())
        for group in due.control:
            yield from ((tick, "control", i + 1) for i in clock.groups[group])


@every
@pytest.mark.parametrize("duration_s", [0.0, 0.1, 3.0, 3.999])
def test_synchronous_aircraft_do_everything_at_multiples_of_its_period(rates, duration_s):
    """As a loop over all ticks finds it that asks of each tick what it divides."""
    clock = clock_of(rates, aircraft=3)
    last = round(duration_s * rates[0])
    autopilot, control, broadcast, log = (rates[0] // rate for rate in rates[1:])
    expected = set()
    for tick in range(0, last + 1):
        for step, what, who in (
            (control, "lead", [None]),
            (autopilot, "autopilot", [None]),
            (log, "log", [None]),
            (broadcast, "broadcast", [0, 1, 2]),
            (control, "control", [1, 2]),
        ):
            if tick % step == 0:
                expected |= {(tick, what, each) for each in who}
    found = list(events(clock, duration_s))
    assert len(found) == len(set(found))
    assert set(found) == expected


@every
@pytest.mark.parametrize("phases", [None, (0.0, 0.3, 0.99)], ids=["together", "phases"])
def test_ticks_follow_each_other_without_a_gap(rates, phases):
    """Each says how many ticks the next lies ahead; the end itself is flown, none after it."""
    clock = clock_of(rates, aircraft=3, phases=phases)
    found = list(clock.schedule(2.0))
    assert found[0][0] == 0
    for (tick, _, ahead, _), (following, *_) in itertools.pairwise(found):
        assert ahead > 0
        assert following == tick + ahead
    last = 2 * rates[0]
    assert found[-1][0] == last  # every rate here has an event at 2 s
    assert found[-1][0] + found[-1][2] > last


@every
@pytest.mark.parametrize("beats", [None, {1: (0.0301, None), 2: (None, 0.0123)}], ids=str)
@pytest.mark.parametrize("everyone", [False, True])
def test_legs_lead_to_where_somebody_may_be_told_something(rates, beats, everyone):
    """They are given at autopilots' periods and frames, reach to the next, and leave none out."""
    clock = clock_of(rates, aircraft=3, phases=(0.0, 0.3, 0.99), beats=beats)
    found = list(clock.schedule(4.0, everyone=everyone))
    known = []
    for (tick, due, ahead, legs), (_, then, *_) in itertools.pairwise(found):
        assert bool(legs) == (due.autopilot or due.log) == (not known)
        known = known or list(legs)
        leg = known.pop(0)
        assert leg == (ahead, None if everyone else then.wanted), tick


def test_the_end_is_part_of_the_run():
    clock = make_clock(**RATES, aircraft=2)
    logged = [tick for tick, what, _ in events(clock, 1.0) if what == "log"]
    assert logged == [20 * k for k in range(11)]
    logged = [tick for tick, what, _ in events(clock, 0.999) if what == "log"]
    assert logged == [20 * k for k in range(11)]  # rounds to the tick of 1 s
    logged = [tick for tick, what, _ in events(clock, 0.99) if what == "log"]
    assert logged == [20 * k for k in range(10)]


def test_errors_move_on_at_equal_spaces():
    """The estimators' time step is the autopilot's, so none of its moments may be passed over."""
    for rates in COMBINATIONS:
        for phases in (None, (0.0, 0.3, 0.99)):
            clock = clock_of(rates, aircraft=3, phases=phases)
            sensed = [tick for tick, what, _ in events(clock, 2.0) if what == "autopilot"]
            assert sensed == list(range(0, 2 * rates[0] + 1, clock.autopilot))


# phases


def test_phases_are_whole_ticks_after_the_leader():
    """By hand: control every 8 ticks, messages every 8; a tenth, a half and 0.99 of that."""
    clock = make_clock(**RATES, aircraft=4, phases=(0.0, 0.1, 0.5, 0.99))
    assert clock.control_phases == (0, 4, 7)
    assert clock.broadcast_phases == (0, 0, 4, 7)
    assert clock.groups == ((0,), (1,), (2,))
    found = list(events(clock, 0.2))
    for what, who, phase in (
        *(("control", i + 1, phase) for i, phase in enumerate((0, 4, 7))),
        *(("broadcast", m, phase) for m, phase in enumerate((0, 0, 4, 7))),
    ):
        ticks = [tick for tick, which, whose in found if (which, whose) == (what, who)]
        # at tick 0 everything happens once, and then at its own phase
        assert ticks == sorted({0, *range(phase, 41, 8)}), (what, who)
    for what, step in (("lead", 8), ("autopilot", 4), ("log", 20)):
        ticks = [tick for tick, which, _ in found if which == what]
        assert ticks == list(range(0, 41, step))


@every
def test_at_phases_nobody_misses_an_event(rates):
    rng = np.random.default_rng(80)
    for _ in range(5):
        phases = tuple(rng.random(6).tolist())
        clock = clock_of(rates, aircraft=6, phases=phases)
        found = list(events(clock, 4.0))
        assert len(found) == len(set(found))
        last = 4 * rates[0]
        for who in range(6):
            for what, step in (("control", clock.control), ("broadcast", clock.broadcast)):
                if what == "control" and who == 0:
                    continue
                phase = int(phases[who] * step)
                ticks = [tick for tick, which, whose in found if (which, whose) == (what, who)]
                assert ticks == sorted({0, *range(phase, last + 1, step)})


def test_aircraft_of_one_phase_step_together():
    clock = make_clock(**RATES, aircraft=5, phases=(0.7, 0.5, 0.0, 0.51, 0.06))
    assert clock.control_phases == (4, 0, 4, 0)
    assert clock.groups == ((1, 3), (0, 2))
    assert make_clock(**RATES, aircraft=5).groups == ((0, 1, 2, 3),)


def test_time_is_a_tick_over_the_base_rate():
    clock = make_clock(**RATES)
    assert clock.time_s(28) == 0.14
    assert (clock.ticks(0.14), clock.ticks(0.1424), clock.ticks(0.1426)) == (28, 28, 29)


@pytest.mark.parametrize("name", [name for name in RATES if name != "physics_hz"])
def test_a_rate_that_does_not_divide_is_refused(name):
    with pytest.raises(InputError, match=rf"rates\.{name}: 30 does not divide physics_hz 200"):
        make_clock(**{**RATES, name: 30})


# beats


def test_an_aircraft_sends_at_moments_of_its_own():
    """By hand: at 0.003 + k 0.031 s, between ticks of 5 ms, beside two who send every 0.04 s."""
    clock = make_clock(**RATES, aircraft=3, beats={1: (0.031, 0.003)})
    sent = [
        (tick, m, due.sent_s[m] if due.sent_s is not None else tick / 200)
        for tick, due, *_ in clock.schedule(1.0)
        if due.broadcast is not None
        for m in range(3)
        if due.broadcast[m]
    ]
    own = [(tick, time) for tick, m, time in sent if m == 1]
    assert [time for _, time in own] == pytest.approx(
        [0.003 + 0.031 * k for k in range(33)], abs=1e-12
    )
    for tick, time in own:
        assert -1e-9 <= time - tick / 200 < 0.005
    for m in (0, 2):
        assert [tick for tick, who, _ in sent if who == m] == list(range(0, 201, 8))


def test_a_beat_at_the_ticks_is_that_of_all_others():
    """0.04 s from 0 s is every 8th tick, though most multiples of 0.04 are not binary."""
    plain = make_clock(**RATES, aircraft=2)
    own = make_clock(**RATES, aircraft=2, beats={0: (0.04, 0.0), 1: (None, None)})
    for (tick, due, ahead, _), (other, theirs, others, _) in zip(
        own.schedule(100.0), plain.schedule(100.0), strict=True
    ):
        assert (tick, ahead) == (other, others)
        assert np.array_equal(due.broadcast, theirs.broadcast)
        if due.sent_s is not None:
            assert due.sent_s == pytest.approx(tick / 200, abs=1e-12)


def test_ticks_of_beats_follow_each_other_without_a_gap():
    clock = make_clock(**RATES, aircraft=3, beats={0: (0.0173, 0.4), 2: (0.11, 0.0021)})
    found = list(clock.schedule(3.0))
    for (tick, _, ahead, _), (following, *_) in itertools.pairwise(found):
        assert ahead > 0
        assert following == tick + ahead
    sensed = [tick for tick, due, *_ in found if due.autopilot]
    assert sensed == list(range(0, 601, clock.autopilot))


@pytest.mark.parametrize("beats", [None, {0: (0.0173, 0.4), 2: (0.11, 0.0021)}], ids=["", "beats"])
def test_who_neither_steps_nor_sends_is_not_wanted_between_periods(beats):
    clock = make_clock(**RATES, aircraft=4, phases=(0.0, 0.3, 0.5, 0.8), beats=beats)
    some = 0
    for _, due, *_ in clock.schedule(5.0):
        if due.autopilot or due.log or due.lead:
            assert due.wanted is None
            continue
        heard = np.zeros(4, bool) if due.broadcast is None else due.broadcast
        steps = {1 + i for number in due.control for i in clock.groups[number]}
        assert due.wanted == tuple(heard[row] or row in steps for row in range(4))
        some += sum(due.wanted)
    assert some > 100
