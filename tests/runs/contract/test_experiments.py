"""The paper's experiments on the Skywalker X8, and a mixed fleet: parameters and short runs."""

import functools

import numpy as np
import pytest
from run_flight import Collector

from testbed.flight.loop import fly
from testbed.plan.world import build
from testbed.runs.run import run
from testbed.scenario import ScenarioError, load_scenario, set_duration

EXPERIMENTS = ("experiment-1", "experiment-2", "experiment-3")
SECONDS = 56.0  # in slot, and in Experiment 1 once round the circle


# the bounds of the fleet's errors are of corners at 30 degrees of bank
BANK = {"mixed-fleet": ("leader.path.bank_limit_deg=30",)}


@functools.cache
def flight(name):
    """Return the metrics and samples of a run of SECONDS."""
    watcher = Collector()
    overrides = ["log.mcap=false", *BANK.get(name, ())]
    scenario = set_duration(load_scenario(name, overrides), SECONDS)
    return run(scenario, write=False, observers=[watcher]).metrics, watcher.frames


def stacked(name, record, field, *, since):
    """Return one field of one record over the samples from a time on."""
    frames = [frame for frame in flight(name)[1] if frame.time_s >= since]
    return np.array([getattr(getattr(frame, record), field) for frame in frames])


# parameters


@pytest.mark.parametrize(
    ("name", "about"),
    [("experiment-1", {"barrier", "slot"}), ("experiment-2", {"barrier"})],
)
def test_broken_hypotheses_are_warned_before_flight(name, about):
    """In Experiment 2 the leader's limits keep the slots within the bounds."""
    warnings = [
        event.text
        for event in build(load_scenario(name)).initial_events
        if event.level == "warning"
    ]
    kinds = {"no barrier": "barrier", "the slot may move": "slot"}
    found = {kind for text in warnings for words, kind in kinds.items() if words in text}
    assert found == about and len(warnings) == len(about)


def test_unknown_profile_lists_the_known_ones():
    with pytest.raises(ScenarioError, match=r"no profile 'nimble' \(write one of tuned"):
        load_scenario("experiment-1", ["controller.profile=nimble"])


# runs


@pytest.mark.parametrize(
    ("name", "largest", "rms"),
    [
        ("experiment-1", 2.0, 1.3),
        ("experiment-3", 6.0, 1.8),
        ("mixed-fleet", 1.4, 0.5),
    ],
)
def test_followers_join_and_stay_in_slot(name, largest, rms):
    metrics, samples = flight(name)
    assert metrics["outcome"] == "completed"
    assert samples[-1].time_s == SECONDS
    assert all(0.0 < at < 15.0 for at in metrics["joined_at_s"].values())
    joined = {e["source"]: e["text"] for e in metrics["events"] if "joined" in e["text"]}
    for follower, at in metrics["joined_at_s"].items():
        assert joined[follower].endswith(f"since {at:.1f} s")
    assert metrics["min_separation_m"] > 5.0
    late = np.linalg.norm(stacked(name, "formation", "error_ned", since=30.0), axis=-1)
    assert late.max() < largest
    assert np.sqrt((late**2).mean()) < rms


@pytest.mark.parametrize("name", ["experiment-2", "experiment-3"])
def test_unsynchronised_controllers_have_own_phases(name):
    """The ticks at which a follower's command changes."""
    collector = Collector()
    scenario = set_duration(load_scenario(name, ["log.mcap=false", "rates.log_hz=100"]), 3.0)
    fly(build(scenario), [collector], lambda now, due: False)
    rolls = np.array([frame.command.roll for frame in collector.frames])
    changes = [np.flatnonzero(np.diff(column)) + 1 for column in rolls.T]
    phases = [set((ticks[ticks > 10] % 10).tolist()) for ticks in changes[1:]]
    assert all(len(phase) == 1 for phase in phases), "each 10 Hz, always at the same phase"
    assert phases[0] != phases[1]
    assert set((changes[0] % 10).tolist()) <= {0}, "the leader's guidance is the clock"


def test_phases_depend_on_seed():
    phases = {
        build(load_scenario("experiment-2", [f"scenario.seed={seed}"])).clock.control_phases
        for seed in range(1, 6)
    }
    assert len(phases) > 3


def test_experiment_1_wind_is_4_mps_from_north_west():
    ground = stacked("experiment-1", "truth", "velocity_ned", since=10.0)[:, 0]
    airspeed = stacked("experiment-1", "truth", "airspeed", since=10.0)[:, 0]
    wind = np.array([-4.0, 4.0, 0.0]) * np.sqrt(0.5)
    np.testing.assert_allclose(np.linalg.norm(ground - wind, axis=-1), airspeed, atol=1e-6)
    assert abs(airspeed - 22.0).max() < 0.2
    speed = np.linalg.norm(ground, axis=-1)
    assert speed.min() == pytest.approx(18.0, abs=0.3)
    assert speed.max() == pytest.approx(26.0, abs=0.3)
    fastest = ground[speed.argmax()]
    assert np.degrees(np.arctan2(fastest[1], fastest[0])) == pytest.approx(135.0, abs=10.0)


def test_horizontal_variant_slots_are_at_80_and_120_m():
    slots = stacked("experiment-3", "formation", "slot_ned", since=0.0)
    assert (slots[..., 2] == [-80.0, -120.0]).all()
    positions = stacked("experiment-3", "truth", "position_ned", since=30.0)
    np.testing.assert_allclose(positions[:, 0, 2], -100.0, atol=1.0)
    np.testing.assert_allclose(positions[:, 1:, 2], [[-80.0, -120.0]] * len(positions), atol=3.0)
    # in the plane the slot keeps its distance to the leader
    beside = np.linalg.norm(slots[:, :, :2] - _leader_plane("experiment-3"), axis=-1)
    np.testing.assert_allclose(beside, np.sqrt(200.0), rtol=1e-9)


def _leader_plane(name):
    return stacked(name, "truth", "position_ned", since=0.0)[:, :1, :2]


def test_four_x8s_fly_the_path_of_simulation_3():
    """Parameters of the experiments at 25 Hz, with offsets of 5 m."""
    changes = ["log.mcap=false", "leader.aircraft=skywalker_x8", "fleet.*.aircraft=skywalker_x8"]
    metrics = run(
        set_duration(
            load_scenario(
                "simulation-3",
                [*changes, "scenario.windows={laps: [30, 75]}", "scenario.published=null"],
            ),
            75.0,
        ),
        write=False,
    ).metrics
    assert metrics["outcome"] == "completed"
    assert max(metrics["windows"]["laps"]["rms_m"].values()) < 0.7


def test_x8_middle_loop_has_gain_margin_of_two():
    """With every PID gain doubled, at 10 Hz, errors still decrease."""
    changes = ["log.mcap=false", "scenario.windows={corners: [20, 50]}", "scenario.published=null"]
    rms = [
        run(
            set_duration(
                load_scenario("experiment-2", [*changes, f"controller.gain_scale={scale}"]), 50.0
            ),
            write=False,
        ).metrics["windows"]["corners"]["mean_rms_m"]
        for scale in (1, 2)
    ]
    assert rms[1] < rms[0]


def test_mixed_fleet_has_own_speed_models():
    scenario = load_scenario("mixed-fleet")
    world = build(scenario)
    assert world.info.aircraft == ("rascal110", "skywalker_x8", "skywalker_x8", "rascal110")
    poles = {
        name: pole
        for group in world.formation.control.groups
        for name, pole in zip(group.config.names, group.config.speed_pole.tolist(), strict=True)
    }
    assert poles == {"uav1": 0.4, "uav2": 0.4, "uav3": 0.64}
    throttle = stacked("mixed-fleet", "command", "throttle", since=30.0).mean(axis=0)
    assert (throttle[1:3] > 0.6).all() and (throttle[[0, 3]] < 0.4).all()
