"""Ringing of a bank: damped oscillations of known frequency and damping, and needed banks."""

import math

import numpy as np
import pytest

from testbed.core.frames import GRAVITY
from testbed.metrics.ringing import RingingMonitor, needed_bank

RATE_HZ, BASE_RATE_HZ = 25, 200
TIME_S = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
START_S = 5.0
SPEED, G = 22.0, 9.80665


def oscillation(zeta, period_s, amplitude_deg):
    """A bank that turns to 30° and oscillates about it from 5 s on; period_s is the damped one."""
    since = np.maximum(TIME_S - START_S, 0.0)
    pulse = 2.0 * math.pi / period_s
    decay = np.exp(-zeta / math.sqrt(1.0 - zeta**2) * pulse * since)
    swing = np.where(TIME_S >= START_S, amplitude_deg * decay * np.sin(pulse * since), 0.0)
    return np.radians(30.0 + swing)


def straight(right=0.0):
    """Slots of one follower (K, 1, 3) on a straight line, `right` of it by (K,) m."""
    slot = np.zeros((TIME_S.size, 1, 3))
    slot[:, 0, 0], slot[:, 0, 1] = SPEED * TIME_S, right
    return slot


def ringing(bank, *, slot=None, wind_ned=0.0, exact=True, cut=None):
    """Duration, last time, period and damping ratio of one follower, and the samples assessed."""
    slot = straight() if slot is None else slot
    tick = np.rint(TIME_S * BASE_RATE_HZ).astype(np.int64)
    wind = np.zeros((TIME_S.size, 1, 3)) + wind_ned
    columns = (tick, bank[:, None], slot, np.ones((TIME_S.size, 1)), wind)
    columns = (*columns, np.full(TIME_S.size, exact))
    monitor = RingingMonitor(1, BASE_RATE_HZ)
    for part in (slice(None),) if cut is None else (slice(cut), slice(cut - 2, None)):
        monitor.add(*(each[part] for each in columns))
    return monitor.numbers()[0], int(monitor.assessed[0])


@pytest.mark.parametrize(("zeta", "period_s"), [(0.07, 1.1), (0.03, 0.6), (-0.02, 1.7)])
def test_ringing_has_its_period_and_damping(zeta, period_s):
    amplitude = 2.0 if zeta < 0.0 else 20.0
    (seconds, last_s, period, damping), _ = ringing(oscillation(zeta, period_s, amplitude))
    # extrema are known to half a sample: 0.02 s in each of the ends, and 1 % of an amplitude
    assert period == pytest.approx(period_s, rel=0.04 / seconds)
    assert damping == pytest.approx(zeta, abs=2e-3)
    if zeta > 0.0:  # it ends where a swing is below 3°, half a period before or after
        pulse = 2.0 * math.pi / period_s
        decay = zeta / math.sqrt(1.0 - zeta**2) * pulse
        end = START_S + math.log(2.0 * amplitude / 3.0) / decay
        assert last_s == pytest.approx(end, abs=period_s)
        assert seconds == pytest.approx(end - START_S, abs=period_s)


@pytest.mark.parametrize(
    ("zeta", "period_s", "amplitude_deg"),
    [(0.17, 1.1, 60.0), (0.05, 4.0, 20.0), (0.05, 0.3, 20.0), (0.0, 1.1, 1.4)],
)
def test_damped_slow_fast_or_small_is_no_ringing(zeta, period_s, amplitude_deg):
    numbers, assessed = ringing(oscillation(zeta, period_s, amplitude_deg))
    assert numbers[0] == 0.0 and np.isnan(numbers[1:]).all()
    assert assessed == TIME_S.size - 2


def test_needed_oscillation_is_no_ringing():
    pulse, amplitude = 2.0 * math.pi / 1.1, 0.1
    slot = straight(amplitude * np.sin(pulse * TIME_S))
    bank = np.arctan(-amplitude * pulse**2 * np.sin(pulse * TIME_S) / G)
    assert ringing(bank, slot=slot)[0][0] == 0.0
    assert ringing(bank)[0][0] > 25.0  # the same bank behind a straight slot


def test_gusts_and_estimates_are_not_assessed():
    bank = oscillation(0.03, 1.1, 20.0)
    assert ringing(bank)[0][0] > 5.0
    gusts = np.random.default_rng(1).normal(0.0, 1.0, (TIME_S.size, 1, 3))
    for changes in ({"wind_ned": gusts}, {"exact": False}):
        numbers, assessed = ringing(bank, **changes)
        assert numbers[0] == 0.0 and assessed < 0.05 * TIME_S.size
    # a wind that changes with height, as in a climb of 3 m/s through 0.1 m/s per metre
    shear = np.zeros((TIME_S.size, 1, 3))
    shear[:, 0, 0] = 0.3 * TIME_S
    assert ringing(bank, wind_ned=shear)[0] == pytest.approx(ringing(bank)[0])


@pytest.mark.parametrize("cut", [RATE_HZ * 6, RATE_HZ * 6 + 7, RATE_HZ * 6 + 14])
def test_ringing_across_blocks_is_the_same(cut):
    bank = oscillation(0.05, 1.1, 20.0)
    assert ringing(bank, cut=cut)[0].tolist() == ringing(bank)[0].tolist()


def test_needed_bank_of_a_turn_in_wind():
    # a circle of 120 m through the air, which drifts with a wind of 8 m/s
    rate, radius = SPEED / 120.0, 120.0
    wind = np.broadcast_to([5.0, -6.0, 0.0], (TIME_S.size, 1, 3))
    slot = wind * TIME_S[:, None, None]
    slot[:, 0, 0] += radius * np.sin(rate * TIME_S)
    slot[:, 0, 1] += radius * (1.0 - np.cos(rate * TIME_S))
    index = np.ones((TIME_S.size, 1))
    index[400:] = 2.0  # it changes its slot
    bank = needed_bank(TIME_S, slot, index, wind)[:, 0]
    # the second difference is too small by x²/12, x = rate / 25 Hz: 4e-6
    known = np.ones(TIME_S.size - 2, dtype=bool)
    known[398:400] = False
    assert bank[known] == pytest.approx(math.atan(SPEED**2 / radius / GRAVITY), rel=1e-5)
    assert np.isnan(bank[~known]).all()
