"""Pacing of simulated time by a clock that the tests control."""

from types import SimpleNamespace

import pytest

from testbed.commands.tick_gate import RealTimePacer, TickGate
from testbed.core.errors import InputError
from testbed.flight.schedule import TickActions


class Clock:
    """A clock that advances only by waiting and by simulated work."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now

    def idle(self, left):
        self.now += left
        return True


def run(pacer, clock, ticks=1000, dt=0.02, work=lambda k: 0.0):
    for k in range(-10, 0):  # before the schedule starts
        pacer.wait(0.2 + k * dt, clock.idle)
    for k in range(ticks + 1):
        pacer.wait(0.2 + k * dt, clock.idle)
        clock.now += work(k)
    return pacer.summary()


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0, 50.0])
def test_pacer_run_takes_duration_over_pace(rate):
    clock = Clock()
    report = run(RealTimePacer(rate, clock), clock)
    assert clock.now - 1000.0 == pytest.approx(20.0 / rate)
    assert report["achieved"] == pytest.approx(rate)
    assert report["late_s"]["max"] == pytest.approx(0.0, abs=1e-9)


def test_pacer_catches_up_short_delays():
    clock = Clock()
    report = run(RealTimePacer(1.0, clock), clock, work=lambda k: 0.05 if k % 10 == 0 else 0.001)
    assert report["achieved"] == pytest.approx(1.0, rel=1e-3)
    # the tick after 50 ms of work is 30 ms late, the next 11 ms
    assert report["late_s"]["max"] == pytest.approx(0.03)
    assert report["late_s"]["mean"] == pytest.approx(0.041 / 10, rel=0.02)
    assert report["late_s"]["p99"] == pytest.approx(0.03, abs=2e-4)


def test_pacer_restarts_after_a_long_delay():
    clock = Clock()
    report = run(RealTimePacer(1.0, clock), clock, work=lambda k: 5.0 if k == 500 else 0.0)
    assert report["achieved"] == pytest.approx(20.0 / 24.98)
    assert report["late_s"]["max"] == pytest.approx(4.98)


def test_pacer_reports_achieved_pace():
    clock = Clock()
    assert run(RealTimePacer(4.0, clock), clock, work=lambda k: 0.01)["achieved"] == pytest.approx(
        2.0
    )


@pytest.mark.parametrize("rate", [0.0, -1.0, 1e-300, 1e9, float("nan"), float("inf")])
def test_pacer_rejects_pace_out_of_range(rate):
    with pytest.raises(InputError, match="--pace"):
        RealTimePacer(rate)


def test_pacer_aborted_wait_is_not_counted():
    clock = Clock()
    pacer = RealTimePacer(0.001, clock)
    run(pacer, clock, ticks=3)
    before = pacer.summary()
    waited = []
    pacer.wait(1.0, lambda left: bool(waited.append(left)))
    assert len(waited) == 1
    assert pacer.summary() == before


class SilentServer:
    """A server that receives nothing."""

    def __init__(self, clock):
        self.clock = clock

    def poll(self, now_s):
        pass

    def wait(self, seconds, now_s):
        self.clock.idle(seconds)


@pytest.mark.parametrize("with_server", [False, True], ids=["no server", "server"])
def test_stop_ends_wait_between_ticks(with_server, monkeypatch):
    clock = Clock()
    monkeypatch.setattr("testbed.commands.tick_gate.time", SimpleNamespace(sleep=clock.idle))
    stop_at = clock.now + 0.25
    pacer = RealTimePacer(0.001, clock)
    server = SilentServer(clock) if with_server else None
    gate = TickGate(None, server, pacer, lambda: clock.now >= stop_at)
    due = TickActions(None, None, (), guidance=True, autopilot=True, log=True, needed=None)
    assert not gate(0.2, due)
    assert gate(0.22, due)  # 20 s later
    assert clock.now - stop_at < 0.1
    assert pacer.summary()["late_s"]["max"] == 0.0
