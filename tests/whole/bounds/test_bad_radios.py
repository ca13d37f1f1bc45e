"""Bounds of whole flights with packet loss, latency and partitions."""

from __future__ import annotations

import pytest
from whole_flights import IN_FULL, cells, fly

HEALED_S, BACK_S = 324.0, 240.0


@IN_FULL
@pytest.mark.parametrize("seed", [1, 2])
def test_loss_and_latency_keep_the_formation(seed) -> None:
    """30 % loss and 200 ms, compensated: no aircraft is lost, mean errors stay below 3 m."""
    metrics = fly("loss-and-latency", f"scenario.seed={seed}")
    assert metrics["network"]["all"]["delivered_share"] == pytest.approx(0.7, abs=0.01)
    assert metrics["age_of_information_s"]["uav1"]["mean"] > 0.2
    for window in ("rectangles", "circles"):
        assert cells(metrics, window).mean() <= 3.0


@IN_FULL
@pytest.mark.parametrize("then", ["loiter", "straight"])
@pytest.mark.parametrize(
    "groups", ["[[leader, uav1], [uav2, uav3]]", "[[leader], [uav1], [uav2], [uav3]]"]
)
def test_partitioned_formation_rejoins(groups, then) -> None:
    """After a partition of 20 s all are within 5 m of their slots in 240 s, and stay there."""
    metrics = fly(
        "partition-and-heal",
        f"network.partitions.0.groups={groups}",
        f"controller.on_leader_timeout={then}",
        # a follower that flies straight on leaves the formation farther behind
        "limits.formation_lost_m=1000",
    )
    assert metrics["windows"]["divided"]["max_error_m"]["uav3"] > 50.0
    for name, recovery in metrics["recovery"].items():
        assert recovery["in_slot_since_s"] <= HEALED_S + BACK_S, name
    assert cells(metrics, "after").max() < 5.0
