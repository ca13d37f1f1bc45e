"""Oscillations in signals against sums of sinusoids with known frequency and damping."""

import math

import numpy as np
import pytest

from testbed.core import oscillations
from testbed.core.oscillations import find_oscillations

DT = 0.04
TIMES = np.arange(0.0, 12.0, DT)


def sinusoid(frequency_hz, damping, amplitude=1.0, phase=0.0):
    """The damping ratio is σ / √(σ² + ω²), ω the frequency of the zero crossings."""
    omega = 2.0 * math.pi * frequency_hz
    sigma = damping / math.sqrt(1.0 - damping**2) * omega
    return amplitude * np.exp(-sigma * TIMES) * np.cos(omega * TIMES + phase)


def found(*signals):
    return [
        (each.frequency_hz, each.damping)
        for each in find_oscillations(np.stack(signals, axis=-1), DT)
    ]


def test_oscillations_close_modes_are_separated():
    """Two of 0.90 and 0.93 Hz in two signals, beside a slow decay."""
    slow = 0.7 * np.exp(-0.3 * TIMES)
    bank = sinusoid(0.90, 0.05) - 0.8 * sinusoid(0.93, 0.09, phase=1.0) + slow
    pitch = 0.3 * sinusoid(0.93, 0.09) + sinusoid(1.75, 0.21, 0.5) - slow
    assert found(bank, pitch) == [
        pytest.approx(pair, rel=1e-3) for pair in ((0.90, 0.05), (0.93, 0.09), (1.75, 0.21))
    ]


@pytest.mark.parametrize("damping", [-0.02, 0.0, 1e-3])
def test_oscillations_without_damping_are_found(damping):
    """Also where it begins at a hundredth of the rest."""
    [least, _] = found(sinusoid(0.9, damping, 0.02) + sinusoid(1.4, 0.3))
    assert least == pytest.approx((0.9, damping), rel=1e-4, abs=1e-7)


def test_oscillations_negligible_ones_are_left_out(monkeypatch):
    """A ripple of 0.1 % without damping is none; with another threshold it is."""
    response = sinusoid(0.9, 0.2) + sinusoid(5.0, 0.0, 1e-3)
    assert found(response) == [pytest.approx((0.9, 0.2), rel=1e-3)]
    monkeypatch.setattr(oscillations, "NEGLIGIBLE", 1e-4)
    assert found(response)[0] == pytest.approx((5.0, 0.0), abs=1e-4)


def test_oscillations_none_in_a_decay_or_in_nothing():
    assert found(np.exp(-TIMES), np.exp(-0.2 * TIMES)) == []
    assert found(np.zeros_like(TIMES)) == []
