"""Environments for reinforcement learning: their APIs' checkers, and the flight of the testbed."""

import copy
import inspect
import math
import pickle
import re

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test
from places import ROOT

import testbed
import testbed.rl
from testbed.core.errors import InputError
from testbed.rl.episodes import DEFAULT_RANGES, NEAREST, OWN
from testbed.rl.formation import FormationEnv

ID = "testbed/HoldSlot-v0"
NOISY = ["fleet.*.sensors=gps-ins", "network.loss=0.1"]


def make(**options):
    return gymnasium.make(ID, **{"duration_s": 2.0} | options)


def episode(env, seed, action=(0.1, -0.2, 0.3)):
    """Fly an episode with one action; return its observations and the last step."""
    observation, info = env.reset(seed=seed)
    seen, step = [observation], (None, 0.0, False, False, info)
    while not (step[2] or step[3]):
        step = env.step(np.array(action, np.float32))
        seen.append(step[0])
    return np.array(seen), step


@pytest.mark.filterwarnings("error")
def test_gymnasium_checker_passes():
    check_env(make().unwrapped)


@pytest.mark.filterwarnings("ignore:.*No longer supported.*")
def test_pettingzoo_checkers_pass():
    parallel_api_test(FormationEnv(duration_s=1.0), num_cycles=20)
    parallel_seed_test(lambda: FormationEnv(duration_s=1.0), num_cycles=6)


def test_episode_is_the_flight_of_a_simulation():
    """To the bit: scenario and seed of an episode fly the same again, step by step."""
    env = make(overrides=NOISY).unwrapped
    seen, (*_, info) = episode(env, 5)
    assert info["time_s"] == 2.0
    assert np.array_equal(seen, episode(env, 5)[0])
    assert not np.array_equal(seen, episode(env, 6)[0])
    episode(env, 5)
    flown = env.simulation
    assert flown.scenario.scenario.seed == 5
    again = testbed.Simulation(flown.scenario)
    again.step()
    while again.outcome is None:
        again.step(flown.commands, until=again.time_s + 0.2)
    for ours, theirs in zip(flown.state.truth, again.state.truth, strict=True):
        assert np.array_equal(ours, theirs)


def test_actions_span_limits_around_the_trim():
    env = make().unwrapped
    env.reset(seed=1)
    trim = env.simulation.commands["uav1"]
    assert trim[0] != 0.0 and 0.1 < trim[2] < 0.9
    limit = math.radians(20.0), math.radians(50.0)
    cases = {
        0.0: trim,
        1.0: (*limit, 1.0),
        -1.0: (-limit[0], -limit[1], 0.0),
        -0.5: (0.5 * (trim[0] - limit[0]), -0.5 * limit[1], 0.5 * trim[2]),
    }
    for action, expected in cases.items():
        env.step(np.full(3, action, np.float32))
        assert env.simulation.commands["uav1"] == pytest.approx(expected)


def test_observation_has_slot_in_course_axes():
    env = make(randomize={}, overrides=["leader.start.course_deg=90", "fleet.0.start_m=[-15,0,1]"])
    observation, info = env.reset(seed=1)
    values = dict(zip((each.name for each in OWN), observation, strict=True))
    bounds = {each.name: each.bound for each in OWN}
    slot = [
        values[f"slot_{axis}"] * bounds[f"slot_{axis}"] for axis in ("forward", "right", "down")
    ]
    assert slot == pytest.approx([10.0, 5.0, -1.0], abs=0.2)
    assert info["slot_error_m"] == pytest.approx(math.dist(slot, (0, 0, 0)), abs=0.1)
    assert values["airspeed"] == pytest.approx(0.0, abs=0.01)
    assert values["message_age"] * 2.0 == pytest.approx(0.02)


def test_reward_counts_error_and_change_of_the_action():
    env = make(limit_m=40.0, smoothness=0.1)
    env.reset(seed=1)
    action = np.array((0.5, 0.0, -0.5), np.float32)
    _, first, _, _, info = env.step(action)
    assert first == pytest.approx(1.0 - info["slot_error_m"] / 40.0 - 0.1 * 0.5)
    _, second, _, _, info = env.step(action)
    assert second == pytest.approx(1.0 - info["slot_error_m"] / 40.0)


def test_time_limit_truncates_and_leaving_terminates():
    _, (_, _, terminated, truncated, info) = episode(make(), 1)
    assert (terminated, truncated) == (False, True)
    assert info["metrics"]["outcome"] == "completed"
    assert info["mean_slot_error_m"] <= info["rms_slot_error_m"]
    _, (_, reward, terminated, truncated, info) = episode(make(limit_m=13.0, duration_s=20), 1)
    assert (terminated, truncated) == (True, False)
    assert info["slot_error_m"] > 13.0 and reward <= 0.0


def test_crash_terminates():
    env = make(overrides=["leader.start.altitude_m=8"], randomize={}, duration_s=10)
    seen, (_, _, terminated, truncated, _) = episode(env, 1, (-1.0, 0.0, 0.0))
    assert (terminated, truncated) == (True, False)
    assert env.unwrapped.simulation.state.lost[1]
    assert np.isfinite(seen).all()


def test_followers_end_one_by_one():
    """An agent that left flies its trim; the rest of the formation goes on."""
    env = FormationEnv(duration_s=4.0, limit_m=60.0, randomize={"fleet.1.start_m.0": [-90.0]})
    observations, _ = env.reset(seed=1)
    assert {each.shape for each in observations.values()} == {(len(OWN) + len(NEAREST),)}
    still = {each: np.zeros(3, np.float32) for each in env.agents}
    _, _, terminations, _, _ = env.step(still)
    assert [each for each, over in terminations.items() if over] == ["uav2"]
    assert env.agents == ["uav1", "uav3"]
    while env.agents:
        observations, _, _, truncations, infos = env.step(
            {each: still[each] for each in env.agents}
        )
    assert truncations == {"uav1": True, "uav3": True}
    assert infos["uav1"]["metrics"]["outcome"] == "completed"


def test_environments_run_in_processes():
    options = {"num_envs": 2, "vectorization_mode": "async", "duration_s": 0.4}
    envs = gymnasium.make_vec(ID, **options)
    try:
        observations, infos = envs.reset(seed=3)
        assert infos["seed"].tolist() == [3, 4]
        for seed, observation in zip((3, 4), observations, strict=True):
            assert np.array_equal(make().reset(seed=seed)[0], observation)
        actions = np.zeros((2, 3), np.float32)
        envs.step(actions)
        _, _, _, truncations, _ = envs.step(actions)
        assert truncations.all()
    finally:
        envs.close()


def test_episodes_write_run_directories(tmp_path):
    env = make(out=tmp_path, duration_s=0.4)
    episode(env, 1)
    env.reset()
    env.close()
    env.close()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["episode-00001", "episode-00002"]
    assert testbed.load_run(tmp_path / "episode-00001").metrics["outcome"] == "completed"
    again = make(out=str(tmp_path), duration_s=0.4)  # another process, or another day
    again.reset()
    again.close()
    assert (tmp_path / "episode-00003" / "run.mcap").is_file()


def test_refused_reset_leaves_no_directory(tmp_path):
    env = make(out=tmp_path / "episodes", overrides=["leader.path.speed_mps=90"])
    with pytest.raises(InputError, match="degrees of bank"):
        env.reset(seed=1)
    assert [*tmp_path.rglob("*")] == []


@pytest.mark.parametrize("out", ["\0", "a/\0", "\ud800"])
def test_folder_that_is_no_path_is_refused(out):
    with pytest.raises(InputError, match="^out: is .*, not (a path|UTF-8 text)"):
        make(out=out)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_copy_of_a_flight_is_refused(copied):
    env = make().unwrapped
    env.reset(seed=1)
    for each in (env.simulation, *([] if copied is copy.copy else [env])):
        with pytest.raises(TypeError, match="cannot be copied or pickled .make another") as caught:
            copied(each)
        assert isinstance(caught.value, InputError)
    assert np.isfinite(env.step(np.zeros(3, np.float32))[1])


def test_drawn_values_stay_in_their_ranges():
    env = make().unwrapped
    radii, directions = set(), set()
    for seed in range(6):
        env.reset(seed=seed)
        curve = env.simulation.scenario.leader.path.curve
        radii.add(curve.radius_m)
        directions.add(curve.direction)
    low, high = DEFAULT_RANGES["leader.path.curve.radius_m"]
    assert len(radii) == 6 and low <= min(radii) <= max(radii) <= high
    assert directions == {"clockwise", "anticlockwise"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"follower": "uav9"}, "no such follower"),
        ({"control_ticks": 0}, "control_ticks: is 0 .write a number at least 1"),
        ({"scenario": "ideal-figure-eight"}, "uav1 is an ideal vehicle"),
        (
            {"randomize": {}, "overrides": ["fleet.0.start_m=[-2,0,0]"]},
            "ends at its start: .*leader: 2.0 m",
        ),
        ({"randomize": {"air.wind.speed_mps": 3}}, r"write \(low, high\)"),
    ],
)
def test_wrong_arguments_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        make(**options).reset(seed=1)


def test_docs_have_every_component():
    page = (ROOT / "docs" / "rl.md").read_text(encoding="utf-8")
    page = page.partition("## Observations")[2]
    rows = re.findall(r"^\| (`.+`) \| (\S+) \| ([\d.]+) \|", page, re.M)
    listed = [
        (name, unit, float(bound))
        for names, unit, bound in rows
        for name in re.findall(r"`(\w+)`", names)
    ]
    assert listed == [tuple(each) for each in (*OWN, *NEAREST)]


@pytest.mark.parametrize("name", ["FormationEnv", "HoldSlotEnv"])
def test_docstring_of_environment_has_components(name):
    text = inspect.getdoc(getattr(testbed.rl, name))
    components = (*OWN, *NEAREST) if name == "FormationEnv" else OWN
    assert f"({len(components)},)" in text
    for stem in {each.name.removesuffix("_right").removesuffix("_down") for each in components}:
        assert stem in text
    for each in components:
        assert f" {each.unit} " in text and re.search(rf"\b{each.bound:g}\b", text), each
