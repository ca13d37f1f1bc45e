"""Bounds of whole flights with sensor errors and with faults, each with its derivation."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from whole_flights import IN_FULL, UAVS, cells
from whole_flights import fly as fly_once

TABLE_1 = {"rectangles": (1.3, 1.4, 1.5), "circles": (1.3, 1.5, 1.5)}
WINGSPAN_M = 2.8
fly = functools.cache(fly_once)


def rms(metrics, window, key="rms_m"):
    """Return the errors of a window by follower, m; NaN of a follower lost before it."""
    found = metrics["windows"][window][key]
    return np.array([math.nan if found[name] is None else found[name] for name in UAVS])


# estimates


@IN_FULL
def test_table_1_holds_with_pixhawk_sensors() -> None:
    metrics = fly("simulation-3-pixhawk")
    for window, table in TABLE_1.items():
        assert (cells(metrics, window) <= table).all(), window


@IN_FULL
def test_common_gps_errors_cancel_own_errors_do_not() -> None:
    """Own drifts of the receivers give relative errors of 0.66 m.

    With time constants of one and five minutes, a thousand seconds hold at most 17 independent
    samples: the RMS is within a factor of 1.5.
    """
    metrics = fly("simulation-3-pixhawk")
    own = math.sqrt(2.0 * (0.25**2 + 0.25**2 + 0.3**2))
    for name in UAVS:
        relative = metrics["relative_position_error_m"][name]
        assert own / 1.5 < relative < own * 1.5
        assert metrics["estimate_error"][name]["horizontal_m"] > 1.5 * relative


def test_degraded_gps_errors_exceed_estimated_errors() -> None:
    """3 m, of which the estimates show a third; both parts are independent, so squares add."""
    metrics = fly("gps-degraded")
    true, believed = rms(metrics, "level"), rms(metrics, "level", "estimated_rms_m")
    own = math.sqrt(2.0 * (1.5**2 + 1.5**2 + 0.3**2))
    relative = np.array([metrics["relative_position_error_m"][name] for name in UAVS])
    # about four independent samples: within a factor of two
    assert ((own / 2.0 < true) & (true < own * 2.0)).all()
    assert (believed < 0.5 * true).all()
    # the relative errors are of the whole flight, a third longer than the window
    assert true == pytest.approx(np.hypot(believed, relative), rel=0.25)


# an engine


@IN_FULL
def test_engine_out_with_reassignment() -> None:
    """UAV 2 is lost, the run is completed, and UAV 3 flies in the slot of UAV 2."""
    metrics, calm = fly("engine-out-uav2"), fly("engine-out-uav2", "fleet.1.faults=[]")
    lost = metrics["lost_at_s"]
    assert [name for name, when in lost.items() if when is not None] == ["uav2"]
    assert 125.0 + 60.0 < lost["uav2"] < 125.0 + 110.0
    texts = [(e["source"], e["text"].split(":")[0]) for e in metrics["events"]]
    # only the aircraft without engine stalls, as it is commanded to climb
    stalls = [each for each in texts if "stalled" in each[1]]
    assert {name for name, _ in stalls} == {"uav2"}
    texts = [each for each in texts if each not in stalls]
    assert sorted(texts[:3]) == [(name, "joined") for name in ("uav1", "uav2", "uav3")]
    assert texts[3:] == [
        ("uav2", "engine out"),
        ("uav1", "uav2 has failed"),
        ("uav3", "uav2 has failed"),
        ("uav2", "leaves the formation"),
        ("uav1", "uav2 has left its slot"),
        ("uav3", "uav2 has left its slot, takes the slot of uav2"),
        ("uav2", "lost"),
    ]
    uav1, _, uav3 = np.arange(3)
    for window in ("before", "glide", "after"):
        ours, theirs = rms(metrics, window), rms(calm, window)
        assert ours[uav1] == theirs[uav1], "it uses no message of the other two"
    # in UAV 2's slot with UAV 2's gains; start and history differ
    assert rms(metrics, "after")[uav3] == pytest.approx(rms(calm, "after")[1], abs=0.03)
    assert rms(metrics, "glide")[uav3] == pytest.approx(rms(calm, "glide")[1], abs=0.03)
    assert metrics["min_separation_m"] > 5.0


@IN_FULL
def test_engine_out_without_response() -> None:
    """UAV 3 weighs the leader and the gliding UAV 2 equally: at most half of UAV 2's error."""
    metrics = fly("engine-out-uav2", "formation.on_failure.response=ignore")
    glide = rms(metrics, "glide")
    assert glide[0] < 0.75
    assert 0.2 * glide[1] < glide[2] <= 0.5 * glide[1]
    last = metrics["windows"]["after"]["max_error_m"]["uav3"]
    assert last < metrics["windows"]["glide"]["max_error_m"]["uav3"], "it comes back"
    assert metrics["min_separation_m"] > WINGSPAN_M


# a pitot tube


@IN_FULL
def test_follower_with_a_blocked_pitot_tube() -> None:
    """No effect 15 m higher, until the reading exceeds the bound of 30 m/s; none up to 40 m/s."""
    blocked = fly("airspeed-blocked")
    assert (rms(blocked, "low") < 0.75).all()
    assert rms(blocked, "high")[1] > 20.0
    assert rms(blocked, "high")[0] < 0.75, "UAV 1 does not use its messages"
    assert blocked["estimate_error"]["uav2"]["airspeed_mps"] > 5.0
    wide = fly("airspeed-blocked", "formation.speed_mps=[16, 40]")
    for window in ("low", "high"):
        assert (rms(wide, window) < 1.0).all()


def test_leader_with_a_blocked_pitot_tube() -> None:
    metrics = fly(
        "airspeed-blocked",
        "fleet.1.faults=[]",
        "leader.faults=[{kind: airspeed-blocked, at_s: 105}]",
        until="low",
    )
    assert (rms(metrics, "before") < 0.75).all()
    assert (rms(metrics, "low") > 20.0).all(), "it stalls, and no follower can fly as slowly"
