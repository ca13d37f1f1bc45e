"""Actions of each tick, for synchronous aircraft and with phases and transmission times."""

import itertools

import numpy as np
import pytest

from testbed.core.errors import InputError
from testbed.flight.schedule import PHASE_HZ, make_clock

RATES = {"physics_hz": 200, "autopilot_hz": 50, "control_hz": 25, "broadcast_hz": 25, "log_hz": 10}
# Rates that divide one another, rates that do not, and equal rates.
COMBINATIONS = [
    (200, 50, 25, 25, 25),
    (200, 50, 25, 10, 20),
    (400, 100, 50, 10, 20),
    (200, 50, 40, 25, 8),
    (120, 60, 40, 24, 30),
    (50, 50, 50, 50, 50),
]
OWN_TIMES = {0: (0.0173, 0.4), 2: (0.11, 0.0021)}  # period and phase, s
all_rates = pytest.mark.parametrize("rates", COMBINATIONS, ids=str)


def clock_for(rates, **more):
    return make_clock(**dict(zip(RATES, rates, strict=True)), **more)


def events(clock, duration_s):
    """Yield (tick, action, row) of all actions; the leader's row is 0."""
    for tick, due, *_ in clock.schedule(duration_s):
        for action in ("guidance", "autopilot", "log"):
            if getattr(due, action):
                yield tick, action, None
        if due.broadcast is not None:
            yield from ((tick, "broadcast", m) for m in np.flatnonzero(due.broadcast).tolist())
        for group in due.control:
            yield from ((tick, "control", i + 1) for i in clock.groups[group])


@all_rates
@pytest.mark.parametrize("duration_s", [0.0, 0.1, 3.0, 3.999])
def test_synchronous_actions_at_multiples_of_periods(rates, duration_s):
    """The schedule agrees with a loop over all ticks that tests divisibility."""
    clock = clock_for(rates, aircraft=3)
    last = round(duration_s * rates[0])
    autopilot, control, broadcast, log = (rates[0] // rate for rate in rates[1:])
    expected = set()
    for tick in range(0, last + 1):
        for step, action, rows in (
            (control, "guidance", [None]),
            (autopilot, "autopilot", [None]),
            (log, "log", [None]),
            (broadcast, "broadcast", [0, 1, 2]),
            (control, "control", [1, 2]),
        ):
            if tick % step == 0:
                expected |= {(tick, action, row) for row in rows}
    found = list(events(clock, duration_s))
    assert len(found) == len(set(found))
    assert set(found) == expected


@all_rates
@pytest.mark.parametrize("phases", [None, (0.0, 0.3, 0.99)], ids=["synchronous", "phases"])
def test_each_tick_gives_the_distance_to_the_next(rates, phases):
    """Ticks follow each other without a gap, up to and including the end."""
    clock = clock_for(rates, aircraft=3, phases=phases)
    found = list(clock.schedule(2.0))
    assert found[0][0] == 0
    for (tick, _, ahead, _), (next_tick, *_) in itertools.pairwise(found):
        assert ahead > 0
        assert next_tick == tick + ahead
    last = 2 * rates[0]
    assert found[-1][0] == last  # every rate here has an event at 2 s
    assert found[-1][0] + found[-1][2] > last


@all_rates
@pytest.mark.parametrize("times", [None, {1: (0.0301, None), 2: (None, 0.0123)}], ids=str)
@pytest.mark.parametrize("all_motions", [False, True])
def test_needed_rows_are_those_of_the_next_tick(rates, times, all_motions):
    """Each tick gives the rows of the aircraft whose motion is read at the next."""
    clock = clock_for(rates, aircraft=3, phases=(0.0, 0.3, 0.99), transmit_times=times)
    found = list(clock.schedule(4.0, all_motions=all_motions))
    for (tick, _, ahead, rows), (next_tick, due, *_) in itertools.pairwise(found):
        assert next_tick == tick + ahead
        if all_motions or due.needed is None:
            assert rows is None, tick
        else:
            assert rows == tuple(np.flatnonzero(due.needed).tolist()), tick


def test_the_end_is_part_of_the_run():
    clock = make_clock(**RATES, aircraft=2)
    logged = [tick for tick, action, _ in events(clock, 1.0) if action == "log"]
    assert logged == [20 * k for k in range(11)]
    logged = [tick for tick, action, _ in events(clock, 0.999) if action == "log"]
    assert logged == [20 * k for k in range(11)]  # rounds to the tick of 1 s
    logged = [tick for tick, action, _ in events(clock, 0.99) if action == "log"]
    assert logged == [20 * k for k in range(10)]


def test_autopilot_ticks_are_equally_spaced():
    """Sensor errors have the autopilot's time step, so no autopilot tick may be skipped."""
    for rates in COMBINATIONS:
        for phases in (None, (0.0, 0.3, 0.99)):
            clock = clock_for(rates, aircraft=3, phases=phases)
            sensed = [tick for tick, action, _ in events(clock, 2.0) if action == "autopilot"]
            assert sensed == list(range(0, 2 * rates[0] + 1, clock.autopilot))


# phases


def test_phases_are_whole_ticks_after_the_leader():
    """Control and messages every 8 ticks; phases of 0.1, 0.5 and 0.99, computed by hand:
    multiples of 10 ms, two ticks."""
    clock = make_clock(**RATES, aircraft=4, phases=(0.0, 0.1, 0.5, 0.99))
    assert clock.control_phases == (0, 4, 6)
    assert clock.broadcast_phases == (0, 0, 4, 6)
    assert clock.groups == ((0,), (1,), (2,))
    found = list(events(clock, 0.2))
    for action, row, phase in (
        *(("control", i + 1, phase) for i, phase in enumerate((0, 4, 6))),
        *(("broadcast", m, phase) for m, phase in enumerate((0, 0, 4, 6))),
    ):
        ticks = [tick for tick, *event in found if event == [action, row]]
        # all actions happen at tick 0, and then at their phases
        assert ticks == sorted({0, *range(phase, 41, 8)}), (action, row)
    for action, step in (("guidance", 8), ("autopilot", 4), ("log", 20)):
        ticks = [tick for tick, which, _ in found if which == action]
        assert ticks == list(range(0, 41, step))


@all_rates
def test_every_aircraft_acts_at_all_of_its_phases(rates):
    rng = np.random.default_rng(80)
    for _ in range(5):
        phases = tuple(rng.random(6).tolist())
        clock = clock_for(rates, aircraft=6, phases=phases)
        found = list(events(clock, 4.0))
        assert len(found) == len(set(found))
        last = 4 * rates[0]
        for row in range(6):
            for action, step in (("control", clock.control), ("broadcast", clock.broadcast)):
                if action == "control" and row == 0:
                    continue
                grid = max(1, rates[0] // PHASE_HZ)
                phase = int(phases[row] * step / grid) * grid
                ticks = [tick for tick, *event in found if event == [action, row]]
                assert ticks == sorted({0, *range(phase, last + 1, step)})


def test_phases_do_not_depend_on_the_physics_rate() -> None:
    phases, found = (0.7, 0.51, 0.06, 0.99), []
    for rate in (100, 200, 400, 800):
        rates = RATES | {"physics_hz": rate, "control_hz": 25, "broadcast_hz": 10, "log_hz": 25}
        clock = make_clock(**rates, aircraft=4, phases=phases)
        of_broadcasts = [tick for tick in clock.broadcast_phases if tick is not None]
        found.append([tick / rate for tick in (*clock.control_phases, *of_broadcasts)])
    assert found[0] == found[1] == found[2] == found[3]
    assert found[0] == pytest.approx([0.02, 0.0, 0.03, 0.07, 0.05, 0.0, 0.09])


def test_followers_with_one_phase_form_a_group():
    clock = make_clock(**RATES, aircraft=5, phases=(0.7, 0.5, 0.0, 0.51, 0.06))
    assert clock.control_phases == (4, 0, 4, 0)
    assert clock.groups == ((1, 3), (0, 2))
    assert make_clock(**RATES, aircraft=5).groups == ((0, 1, 2, 3),)


def test_time_is_the_tick_over_the_base_rate():
    clock = make_clock(**RATES)
    assert clock.time_s(28) == 0.14
    assert (clock.ticks(0.14), clock.ticks(0.1424), clock.ticks(0.1426)) == (28, 28, 29)


@pytest.mark.parametrize("name", [name for name in RATES if name != "physics_hz"])
def test_rate_that_does_not_divide_is_an_error(name):
    with pytest.raises(InputError, match=rf"rates\.{name}: 30 does not divide physics_hz 200"):
        make_clock(**{**RATES, name: 30})


# transmission times


def test_transmission_times_between_ticks():
    """One aircraft transmits at 0.003 + k 0.031 s, two every 0.04 s; ticks of 5 ms."""
    clock = make_clock(**RATES, aircraft=3, transmit_times={1: (0.031, 0.003)})
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
        assert [tick for tick, row, _ in sent if row == m] == list(range(0, 201, 8))


def test_transmission_times_at_ticks():
    """A period of 0.04 s is 8 ticks, although most multiples of 0.04 are not exact in binary."""
    plain = make_clock(**RATES, aircraft=2)
    own = make_clock(**RATES, aircraft=2, transmit_times={0: (0.04, 0.0), 1: (None, None)})
    for (tick, due, ahead, _), (other, theirs, others, _) in zip(
        own.schedule(100.0), plain.schedule(100.0), strict=True
    ):
        assert (tick, ahead) == (other, others)
        assert np.array_equal(due.broadcast, theirs.broadcast)
        if due.sent_s is not None:
            assert due.sent_s == pytest.approx(tick / 200, abs=1e-12)


def test_ticks_with_transmission_times_have_no_gap():
    clock = make_clock(**RATES, aircraft=3, transmit_times=OWN_TIMES)
    found = list(clock.schedule(3.0))
    for (tick, _, ahead, _), (next_tick, *_) in itertools.pairwise(found):
        assert ahead > 0
        assert next_tick == tick + ahead
    sensed = [tick for tick, due, *_ in found if due.autopilot]
    assert sensed == list(range(0, 601, clock.autopilot))


@pytest.mark.parametrize("times", [None, OWN_TIMES], ids=["", "times"])
def test_motion_is_needed_only_to_step_or_transmit(times):
    clock = make_clock(**RATES, aircraft=4, phases=(0.0, 0.3, 0.5, 0.8), transmit_times=times)
    needed = 0
    for _, due, *_ in clock.schedule(5.0):
        if due.autopilot or due.log or due.guidance:
            assert due.needed is None
            continue
        sends = np.zeros(4, bool) if due.broadcast is None else due.broadcast
        steps = {1 + i for number in due.control for i in clock.groups[number]}
        assert due.needed == tuple(sends[row] or row in steps for row in range(4))
        needed += sum(due.needed)
    assert needed > 100
