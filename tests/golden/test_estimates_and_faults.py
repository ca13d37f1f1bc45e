"""Whole flights on estimates and with faults, against bounds that have reasons of their own."""

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


def rms(metrics, portion, key="rms_m"):
    """Errors of a portion by follower, m; of one that is lost before, nan."""
    found = metrics["portions"][portion][key]
    return np.array([math.nan if found[name] is None else found[name] for name in UAVS])


# estimates


@IN_FULL
def test_table_1_holds_on_an_autopilots_own_sensors() -> None:
    metrics = fly("simulation-3-pixhawk")
    for portion, table in TABLE_1.items():
        assert (cells(metrics, portion) <= table).all(), portion


@IN_FULL
def test_what_all_receivers_share_cancels_and_what_each_owns_does_not() -> None:
    """Metres off the truth, of which own drifts leave 0.66 m between neighbours.

    Drifts of a minute, and of five, give a thousand seconds no more than seventeen draws: an RMS
    within a factor of 1.5 of that.
    """
    metrics = fly("simulation-3-pixhawk")
    own = math.sqrt(2.0 * (0.25**2 + 0.25**2 + 0.3**2))
    for name in UAVS:
        relative = metrics["relative_position_m"][name]
        assert own / 1.5 < relative < own * 1.5
        assert metrics["estimate_error"][name]["horizontal_m"] > 1.5 * relative


def test_under_trees_errors_are_those_of_the_receivers_and_nobody_knows() -> None:
    """3 m, of which the followers believe a third; squares add, as neither knows of the other."""
    metrics = fly("gps-degraded")
    true, believed = rms(metrics, "level"), rms(metrics, "level", "believed_rms_m")
    own = math.sqrt(2.0 * (1.5**2 + 1.5**2 + 0.3**2))
    relative = np.array([metrics["relative_position_m"][name] for name in UAVS])
    # four draws or so: within a factor of two
    assert ((own / 2.0 < true) & (true < own * 2.0)).all()
    assert (believed < 0.5 * true).all()
    # the relative errors are of the whole flight, a third longer than the portion
    assert true == pytest.approx(np.hypot(believed, relative), rel=0.25)


# an engine


@IN_FULL
def test_an_engine_out_leaves_the_others_undisturbed() -> None:
    """UAV 2 is lost on the ground; the run has flown, and UAV 3 is where UAV 2 would have been."""
    metrics, calm = fly("engine-out-uav2"), fly("engine-out-uav2", "fleet.1.faults=[]")
    lost = metrics["lost_at_s"]
    assert [name for name, when in lost.items() if when is not None] == ["uav2"]
    assert 125.0 + 60.0 < lost["uav2"] < 125.0 + 110.0
    told = [(e["source"], e["text"].split(":")[0]) for e in metrics["events"]]
    # a glider that is told to climb stalls again and again; of the others none does
    stalls = [each for each in told if "stalled" in each[1]]
    assert {name for name, _ in stalls} == {"uav2"}
    told = [each for each in told if each not in stalls]
    assert sorted(told[:3]) == [(name, "engaged") for name in ("uav1", "uav2", "uav3")]
    assert told[3:] == [
        ("uav2", "engine out"),
        ("uav1", "uav2 has failed"),
        ("uav3", "uav2 has failed"),
        ("uav2", "leaves the formation"),
        ("uav1", "uav2 has left its place"),
        ("uav3", "uav2 has left its place, takes the place of uav2"),
        ("uav2", "lost"),
    ]
    uav1, _, uav3 = np.arange(3)
    for portion in ("before", "glide", "after"):
        ours, theirs = rms(metrics, portion), rms(calm, portion)
        assert ours[uav1] == theirs[uav1], "it hears neither of the other two"
    # In UAV 2's place with UAV 2's gains; start and history differ.
    assert rms(metrics, "after")[uav3] == pytest.approx(rms(calm, "after")[1], abs=0.03)
    assert rms(metrics, "glide")[uav3] == pytest.approx(rms(calm, "glide")[1], abs=0.03)
    assert metrics["min_separation_m"] > 5.0


@IN_FULL
def test_who_does_not_heed_a_failure_is_drawn_along() -> None:
    """UAV 3 weighs the leader and the gliding UAV 2 alike: behind by up to half of its way."""
    metrics = fly("engine-out-uav2", "formation.on_failure.answer=fly-on")
    glide = rms(metrics, "glide")
    assert glide[0] < 0.75
    assert 0.2 * glide[1] < glide[2] <= 0.5 * glide[1]
    last = metrics["portions"]["after"]["max_error_m"]["uav3"]
    assert last < metrics["portions"]["glide"]["max_error_m"]["uav3"], "it comes back"
    assert metrics["min_separation_m"] > WINGSPAN_M


# a pitot tube


@IN_FULL
def test_a_follower_minds_a_blocked_pitot_tube_from_its_speed_bound_on() -> None:
    """15 m higher nothing happens; then the reading passes 30 m/s, and with bounds to 40 none."""
    blocked = fly("airspeed-blocked")
    assert (rms(blocked, "low") < 0.75).all()
    assert rms(blocked, "high")[1] > 20.0
    assert rms(blocked, "high")[0] < 0.75, "UAV 1 does not hear it"
    assert blocked["estimate_error"]["uav2"]["airspeed_mps"] > 5.0
    wide = fly("airspeed-blocked", "formation.speed_mps=[16, 40]")
    for portion in ("low", "high"):
        assert (rms(wide, portion) < 1.0).all()


def test_a_leader_minds_it_in_the_first_climb() -> None:
    metrics = fly(
        "airspeed-blocked",
        "fleet.1.faults=[]",
        "leader.faults=[{kind: airspeed-blocked, at_s: 105}]",
        until="low",
    )
    assert (rms(metrics, "before") < 0.75).all()
    assert (rms(metrics, "low") > 20.0).all(), "it stalls, and nobody can fly that slowly"
