"""Simulated time against a clock that a test turns."""

from types import SimpleNamespace

import pytest

from testbed.errors import InputError
from testbed.sim.clock import Due
from testbed.sim.gate import Gate
from testbed.sim.pace import Pace


class Clock:
    """A wall clock that moves only while somebody waits, or works."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now

    def idle(self, left):
        self.now += left
        return True


def run(pace, clock, ticks=1000, dt=0.02, work=lambda k: 0.0):
    for k in range(-10, 0):  # before the schedule begins
        pace.wait(0.2 + k * dt, clock.idle)
    for k in range(ticks + 1):
        pace.wait(0.2 + k * dt, clock.idle)
        clock.now += work(k)
    return pace.report()


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0, 50.0])
def test_a_run_takes_its_length_over_the_pace(rate):
    clock = Clock()
    report = run(Pace(rate, clock), clock)
    assert clock.now - 1000.0 == pytest.approx(20.0 / rate)
    assert report["achieved"] == pytest.approx(rate)
    assert report["late_s"]["max"] == pytest.approx(0.0, abs=1e-9)


def test_work_inside_a_tick_is_made_good():
    clock = Clock()
    report = run(Pace(1.0, clock), clock, work=lambda k: 0.05 if k % 10 == 0 else 0.001)
    assert report["achieved"] == pytest.approx(1.0, rel=1e-3)
    # the tick after 50 ms of work is 30 ms late, the next 11 ms
    assert report["late_s"]["max"] == pytest.approx(0.03)
    assert report["late_s"]["mean"] == pytest.approx(0.041 / 10, rel=0.02)
    assert report["late_s"]["p99"] == pytest.approx(0.03, abs=2e-4)


def test_what_is_lost_in_a_long_wait_is_not_raced_after():
    clock = Clock()
    report = run(Pace(1.0, clock), clock, work=lambda k: 5.0 if k == 500 else 0.0)
    assert report["achieved"] == pytest.approx(20.0 / 24.98)
    assert report["late_s"]["max"] == pytest.approx(4.98)


def test_a_machine_that_is_too_slow_says_how_fast_it_was():
    clock = Clock()
    assert run(Pace(4.0, clock), clock, work=lambda k: 0.01)["achieved"] == pytest.approx(2.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_pace_is_above_zero(rate):
    with pytest.raises(InputError, match="--pace"):
        Pace(rate)


def test_a_wait_that_is_given_up_counts_for_nothing():
    clock = Clock()
    pace = Pace(0.001, clock)
    run(pace, clock, ticks=3)
    before = pace.report()
    waited = []
    pace.wait(1.0, lambda left: bool(waited.append(left)))
    assert len(waited) == 1
    assert pace.report() == before


class Silence:
    """A station that nobody speaks to."""

    def __init__(self, clock):
        self.clock = clock

    def poll(self, now_s):
        pass

    def wait(self, seconds, now_s):
        self.clock.idle(seconds)


@pytest.mark.parametrize("accompanied", [False, True], ids=["alone", "with a station"])
def test_a_stop_is_heeded_between_two_ticks_however_slow_the_pace(accompanied, monkeypatch):
    clock = Clock()
    monkeypatch.setattr("testbed.sim.gate.time", SimpleNamespace(sleep=clock.idle))
    asked = clock.now + 0.25
    pace = Pace(0.001, clock)
    gate = Gate(None, Silence(clock) if accompanied else None, pace, lambda: clock.now >= asked)
    due = Due(None, None, (), lead=True, autopilot=True, log=True, wanted=None)
    assert not gate(0.2, due)
    assert gate(0.22, due)  # 20 s later
    assert clock.now - asked < 0.1
    assert pace.report()["late_s"]["max"] == 0.0
