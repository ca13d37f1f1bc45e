"""RADIO_STATUS: telemetry slows down for a radio whose buffer is full, as ArduPilot's does."""

from collections import Counter

import pytest
from mavlink_control import TO, RecordingControl, VehicleClient

from testbed.mavlink.radio_buffer import MAX_SLOWDOWN_MS, OUTDATED_S, RadioBuffer

RADIO = {"rssi": 255, "remrssi": 255, "noise": 255, "remnoise": 255, "rxerrors": 0, "fixed": 0}


def report(client, free):
    return client.send("RADIO_STATUS", system=51, component=68, txbuf=free, **RADIO)


# Share of the buffer that is free, %; slowdown before and after a report, ms.
STEPS = [
    (0, 0, 60), (19, 0, 60), (20, 0, 20), (49, 0, 20), (50, 100, 100), (90, 100, 100),
    (91, 100, 80), (95, 300, 280), (96, 300, 260), (96, 200, 180), (96, 20, 0), (100, 0, 0),
    (0, 1960, MAX_SLOWDOWN_MS), (0, 2000, 2000), (30, 1990, 2000),
]  # fmt: skip


@pytest.mark.parametrize(("free", "before", "after"), STEPS)
def test_slowdown_changes_by_the_steps_of_ardupilot(free, before, after):
    radio = RadioBuffer()
    radio.slowdown_ms = before
    radio.report(free, 0.0)
    assert radio.slowdown_ms == after


def rates(client, first, ticks=250):
    """Messages in 10 s, by name."""
    return Counter(
        each.name for tick in range(first, first + ticks) for each in client.update(tick)
    )


def test_reports_slow_all_messages_but_the_heartbeat():
    client = VehicleClient()
    before = rates(client, 1)
    assert before["ATTITUDE"] == pytest.approx(100, abs=2)
    for _ in range(15):
        assert report(client, 5) == []
    slow = rates(client, 300)  # 100 ms become 1 s
    assert slow["ATTITUDE"] == pytest.approx(10, abs=1)
    assert slow["SYS_STATUS"] == pytest.approx(10 / 1.4, abs=1)
    assert slow["HEARTBEAT"] == before["HEARTBEAT"] == 10
    for _ in range(60):
        report(client, 100)
    assert rates(client, 600) == pytest.approx(before, abs=2)


def test_lockstep_state_is_sent_with_every_sample():
    """A run that waits for answers must not wait for what a radio has slowed."""
    client = VehicleClient(RecordingControl(lockstep=True))
    for _ in range(40):
        report(client, 0)
    assert rates(client, 1, 50)["LOCAL_POSITION_NED"] == 50


def listed(client, seconds):
    """Values of a list in this time of polls, 100 a second."""
    polls = (client.poll(0.01) for _ in range(round(100 * seconds)))
    return sum(each.name == "PARAM_VALUE" for messages in polls for each in messages)


def test_a_list_waits_while_the_buffer_is_full():
    """And takes 40 values a second at most while a radio reports; ten a poll without one."""
    client = VehicleClient()
    report(client, 33)
    client.send("PARAM_REQUEST_LIST", **TO)
    assert listed(client, 1.0) == 0
    report(client, 34)
    assert listed(client, 0.5) == pytest.approx(17, abs=3)  # every third poll
    report(client, 10)
    assert listed(client, OUTDATED_S - 1.0) == 0
    assert listed(client, 1.5) > 30  # the report is too old


def test_any_free_share_is_taken():
    client = VehicleClient()
    for free in (*range(0, 256, 5), 255):
        assert report(client, free) == []
    assert 0 <= client.vehicle._context.radio.slowdown_ms <= MAX_SLOWDOWN_MS
