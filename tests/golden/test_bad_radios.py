"""Bounds of whole flights on bad radios."""

from __future__ import annotations

import pytest
from whole_flights import IN_FULL, cells, fly

HEALED_S, BACK_S = 330.0, 240.0


@IN_FULL
@pytest.mark.parametrize("seed", [1, 2])
def test_loss_and_latency_together_are_borne(seed) -> None:
    """30 % loss and 200 ms, compensated: nobody is lost, and the mean error stays below 3 m."""
    metrics = fly("loss-and-latency", f"scenario.seed={seed}")
    assert metrics["network"]["all"]["delivered_share"] == pytest.approx(0.7, abs=0.01)
    assert metrics["age_of_information_s"]["uav1"]["mean"] > 0.2
    for portion in ("rectangles", "circles"):
        assert cells(metrics, portion).mean() <= 3.0


@IN_FULL
@pytest.mark.parametrize("then", ["loiter", "straight"])
@pytest.mark.parametrize(
    "groups", ["[[leader, uav1], [uav2, uav3]]", "[[leader], [uav1], [uav2], [uav3]]"]
)
def test_a_divided_formation_comes_together_again(groups, then) -> None:
    """After 20 s apart everybody is back within 5 m of its slot in 240 s, and stays there."""
    metrics = fly(
        "partition-and-heal",
        f"network.partitions.0.groups={groups}",
        f"controller.silence.then={then}",
        # who flies straight on may be farther off than those who wait for one another
        "limits.formation_m=1000",
    )
    assert metrics["portions"]["divided"]["max_error_m"]["uav3"] > 50.0
    for name, recovery in metrics["recovery"].items():
        assert recovery["inside_for_good_from_s"] <= HEALED_S + BACK_S, name
    assert cells(metrics, "after").max() < 5.0
