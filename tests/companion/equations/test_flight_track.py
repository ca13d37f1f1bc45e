"""Jumps of position and time, stopped clocks and frozen positions, from samples in a row."""

import math

import pytest
from companion_flights import changed, observe

from testbed.companion.flight_track import ACCELERATION_MPS2, FlightTrack, PositionTrack


def circle(t, bank_deg, speed=22.0):
    """Position and velocity in a level turn: the acceleration is g tan(bank)."""
    rate = 9.81 * math.tan(math.radians(bank_deg)) / speed
    radius = speed / rate
    position = (radius * math.sin(rate * t), -radius * math.cos(rate * t), -100.0)
    return position, (speed * math.cos(rate * t), speed * math.sin(rate * t), 0.0)


@pytest.mark.parametrize("gap_s", [0.04, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("bank_deg", [0.001, 30, 56])
def test_no_manoeuvre_is_a_jump(bank_deg, gap_s):
    """A turn, also seen rarely: less acceleration than is allowed explains it."""
    track = PositionTrack()
    assert 9.81 * math.tan(math.radians(bank_deg)) < ACCELERATION_MPS2
    for k in range(60):
        track.add(k * gap_s, *circle(k * gap_s, bank_deg))
    assert track.excess_m <= 1e-9


@pytest.mark.parametrize("gap_s", [0.04, 1.0])
def test_a_jump_is_its_length_less_the_allowance(gap_s):
    track = PositionTrack()
    for k in range(50):
        place, velocity = circle(k * gap_s, 0.001)
        north = place[0] + (20.0 if k == 30 else 0.0)
        track.add(k * gap_s, (north, *place[1:]), velocity)
        if k < 30:
            assert track.excess_m == 0.0
        if k == 30:
            assert track.excess_m == pytest.approx(20 - 7.5 * gap_s**2, abs=1e-3)


def test_old_samples_and_no_numbers_count_nothing():
    track = PositionTrack()
    track.add(1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for time_s, north in ((1.0, 50.0), (0.5, 50.0), (2.0, math.nan), (2.0, math.inf)):
        track.add(time_s, (north, 0.0, 0.0), (0.0, 0.0, 0.0))
    track.add(1.04, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert track.excess_m == 0.0


def test_repeated_samples_in_lockstep_are_not_frozen():
    """The clock of a companion in lockstep is that of the samples."""
    track = FlightTrack()
    for _ in range(500):
        track.add(changed(observe(7.0), now_s=7.0))
    assert (track.frozen_s, track.stalled_s, track.pause_s) == (0.0, 0.0, 0.0)


def test_stopped_time_counts_by_the_own_clock():
    track = FlightTrack()
    for k in range(50):
        track.add(changed(observe(0.04 * k), boot_s=min(0.04 * k, 1.0)))
    assert track.stalled_s == pytest.approx(0.96)


def test_an_aircraft_that_stands_is_not_frozen():
    track = FlightTrack()
    for k in range(200):
        still = {"position_ned": (1.0, 2.0, 3.0), "velocity_ned": (0.1, 0.0, 0.0)}
        track.add(observe(0.04 * k, **still))
    assert track.frozen_s == 0.0


def test_drift_of_gps_time_is_no_jump():
    """50 ppm of the autopilot's clock, and rounding to a millisecond."""
    track = FlightTrack()
    for k in range(2000):
        track.add(observe(0.04 * k, base_ms=1_900_000_000_000 + round(0.04 * k * 0.05)))
        assert track.time_jump_s <= 0.002
    track.add(observe(80.1, base_ms=1_900_000_001_004))
    assert track.time_jump_s == pytest.approx(1.0)
