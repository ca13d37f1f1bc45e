"""Times of telemetry: the vehicle's clock after restarts, and times of receipt beside it."""

from types import SimpleNamespace

import numpy as np
import pytest

from testbed.flight_logs.tlog_clock import Received, VehicleClock


def received(times, boot_s, first=0):
    """Return every second message, by times of receipt and of the vehicle's clock, s."""
    return [
        Received(first + 2 * k, float(at), SimpleNamespace(number=lambda name, s=boot: 1e3 * s))
        for k, (at, boot) in enumerate(zip(times, boot_s, strict=True))
    ]


SECONDS = np.arange(10.0)


def test_restart_without_room_comes_after_all_before():
    """The receiver's clock steps back at the restart: the times of both parts do not overlap."""
    before = received(SECONDS, 100.0 + SECONDS)
    after = received(3.0 + SECONDS, SECONDS, first=20)
    clock = VehicleClock([*before, *after])
    times = clock.from_boot_times([*before, *after])
    assert times[:10] == pytest.approx(SECONDS)
    assert times[10:] == pytest.approx(10.001 + SECONDS)  # a pause of 1.001 s
    assert clock.starts == pytest.approx((10.001,))


def test_restart_with_room_is_by_the_receiver():
    """Where the receiver's clock has gone on, the second part begins at its time."""
    before = received(SECONDS, 100.0 + SECONDS)
    after = received(30.0 + SECONDS, SECONDS, first=20)
    clock = VehicleClock([*before, *after])
    assert clock.from_boot_times(after) == pytest.approx(30.0 + SECONDS)
    assert clock.starts == pytest.approx((30.0,))


def test_messages_after_the_last_attitude_keep_apart():
    """A message 3 s after the last attitude is at +3 s, one 2 s before the first at −2 s."""
    attitudes = received(SECONDS, 50.0 + SECONDS, first=1)
    clock = VehicleClock(attitudes)
    others = [
        Received(0, -2.0, SimpleNamespace()),
        Received(6, 2.5, SimpleNamespace()),
        Received(20, 12.0, SimpleNamespace()),
        Received(21, 8.0, SimpleNamespace()),  # the receiver's clock has stepped back
    ]
    assert clock.from_receipt(others) == pytest.approx([-2.0, 2.5, 12.0, 9.0])
