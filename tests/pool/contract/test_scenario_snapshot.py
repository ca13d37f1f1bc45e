"""What of a scenario decides its numbers."""

from pathlib import Path

from testbed.pool.scenario_snapshot import snapshot
from testbed.scenario import load_scenario

BOUND, STOP = "expect.max_error_m.max=9", "limits.on_violation=stop"


def of(*overrides):
    return snapshot(load_scenario("ideal-figure-eight", overrides), Path())


def test_bounds_count_where_they_end_a_flight():
    assert of(BOUND) == of()
    assert "on_violation" not in of()["limits"]
    stopped = of(BOUND, STOP)
    assert stopped["limits"]["on_violation"] == "stop"
    assert stopped["expect"] == {"max_error_m": {"max": 9.0}}
    assert stopped != of(STOP) != of()


def test_link_of_companions_counts_where_it_is_mavlink():
    link = "controller.companion.link=mavlink"
    assert of("controller.companion.acceleration=imu") == of()
    assert set(of()["controller"]["companion"]) == {"state_latency_s", "command_latency_s"}
    assert of(link)["controller"]["companion"]["acceleration"] == "velocity"
    assert of(link, "controller.companion.acceleration=imu") != of(link)
