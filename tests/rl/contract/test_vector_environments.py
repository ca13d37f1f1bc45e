"""Vector environments: many episodes as rows of a batch."""

import gymnasium
import numpy as np
import pytest
from cases import ALL
from gymnasium.vector import AutoresetMode

import testbed
import testbed.rl
from testbed.core.errors import InputError
from testbed.rl.episodes import NEAREST, OWN
from testbed.rl.formation import FormationEnv
from testbed.rl.vector import FormationVectorEnv

ID = "testbed/HoldSlot-v0"
NOISY = ["fleet.*.sensors=gps-ins", "network.loss=0.1"]
SHOWN = ("time_s", "slot_error_m", "mean_slot_error_m", "rms_slot_error_m")


def make(num_envs=3, **options):
    options = {"duration_s": 1.0, "starts": 4 if ALL else 2} | options
    return gymnasium.make_vec(ID, num_envs=num_envs, **options)


@pytest.fixture(scope="module")
def twins():
    """Two alike; a reset with a seed begins all their episodes."""
    return make(duration_s=2.0), make(duration_s=2.0)


@pytest.fixture(scope="module")
def brief():
    """Of episodes with three steps."""
    return make(duration_s=0.6)


@pytest.fixture(scope="module")
def noisy():
    """Two alike, of episodes with five steps and noise."""
    return [make(overrides=NOISY) for _ in range(2)]


def actions(count, seed, bound=0.3):
    return np.random.default_rng(seed).uniform(-bound, bound, (count, 3)).astype(np.float32)


def same_start(**options):
    """The only start of a vector environment, for an environment of one flight."""
    return {"randomize": {"fleet.uav1.start_m.0": [-12.0]}, "duration_s": 1.0} | options


@pytest.mark.parametrize("threads", [1, 2])
def test_episodes_are_those_of_one_flight(threads):
    """Observations, rewards, ends and infos to the bit, with noise, beside other rows."""
    options = same_start(overrides=NOISY)
    envs, alone = make(starts=1, threads=threads, **options), gymnasium.make(ID, **options)
    seen, infos = envs.reset(seed=5)
    for k in range(2):
        seed = int(infos["seed"][k])
        observation, _ = alone.reset(seed=seed)
        np.testing.assert_array_equal(seen[k], observation)
    last, steps = observation, 0
    while True:
        asked = actions(3, steps)
        seen, rewards, terminated, truncated, infos = envs.step(asked)
        last, reward, *over, info = alone.step(asked[1])
        np.testing.assert_array_equal(seen[1], last)
        assert rewards[1] == pytest.approx(reward, rel=1e-12)
        assert [terminated[1], truncated[1]] == over
        for key in SHOWN:
            assert infos[key][1] == pytest.approx(info[key], rel=1e-12)
        steps += 1
        if any(over):
            break
    assert steps == 5 and truncated.all()


def test_numbers_are_those_of_a_simulation(noisy):
    envs, _ = noisy
    envs.reset(seed=3)
    row = envs.flown[2]
    simulation = testbed.Simulation(envs.batch.scenario(row))
    simulation.step()
    for step in range(4):
        envs.step(actions(3, step))
        command = envs.batch.commands[row, 1].tolist()
        state = simulation.step({"uav1": command}, until=0.02 + 0.2 * (step + 1))
        truth = envs.batch.aircraft["truth"]["position_ned"][row]
        np.testing.assert_array_equal(state.truth.position_ned, truth)


def test_same_seed_gives_the_same_episodes(noisy):
    """Starts, seeds and numbers, over the ends of episodes."""
    flown = []
    for seed, envs in zip((1, 1, 2), (*noisy, noisy[0]), strict=True):
        seen = [envs.reset(seed=seed)[0]]
        starts = []
        for step in range(8):  # an episode has five and its reset
            seen.append(envs.step(actions(3, step))[0])
            starts.append(envs.flown.tolist())
        flown.append((np.array(seen).tobytes(), starts))
    assert flown[0] == flown[1] and flown[0] != flown[2]
    assert len({tuple(each) for each in flown[0][1]}) > 1


def test_next_step_begins_the_next_episode(brief):
    envs = brief
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    envs.reset(seed=1)
    for _ in range(3):
        *_, truncated, infos = envs.step(np.zeros((3, 3)))
    assert truncated.all() and infos["time_s"] == pytest.approx(0.6)
    seen, rewards, terminated, truncated, infos = envs.step(np.ones((3, 3)))
    assert infos["time_s"] == pytest.approx(0.02) and not rewards.any()
    assert not terminated.any() and not truncated.any()
    names = [each.name for each in OWN]
    assert not seen[:, names.index("last_roll_action")].any()


def test_same_step_shows_the_end_and_the_next_episode():
    envs = make(duration_s=0.6, autoreset_mode="SameStep")
    envs.reset(seed=1)
    for _ in range(3):
        seen, _, _, truncated, infos = envs.step(np.full((3, 3), 0.1))
    assert truncated.all() and infos["_final_obs"].all()
    assert infos["final_info"]["time_s"] == pytest.approx(0.6)
    assert infos["time_s"] == pytest.approx(0.02)
    assert not np.array_equal(seen, infos["final_obs"])


def test_leaving_terminates_one_of_many():
    options = {"limit_m": 13.0, "duration_s": 20.0, "autoreset_mode": "SameStep"}
    envs = make(num_envs=4, **options)
    envs.reset(seed=2)
    ended = 0
    while not 0 < ended < 4:
        _, rewards, terminated, truncated, infos = envs.step(np.zeros((4, 3)))
        for k in np.flatnonzero(terminated):
            assert infos["final_info"]["slot_error_m"][k] > 13.0 and rewards[k] <= 0.0
        ended = (terminated | truncated).sum()
        assert infos["time_s"].max() < 12.0


def test_followers_of_a_flight_end_together():
    """Of each flight all followers, in order; the one that left is terminated."""
    options = {"duration_s": 4.0, "limit_m": 60.0, "randomize": {"fleet.1.start_m.0": [-90.0]}}
    envs = FormationVectorEnv(2, starts=1, **options)
    alone = FormationEnv(**options)
    seen, infos = envs.reset(seed=1)
    assert seen.shape == (6, len(OWN) + len(NEAREST)) and envs.followers == tuple(
        alone.possible_agents
    )
    observations, _ = alone.reset(seed=int(infos["seed"][0]))
    np.testing.assert_array_equal(seen[:3], list(observations.values()))
    seen, _, terminated, truncated, _ = envs.step(np.zeros((6, 3)))
    assert terminated.tolist() == [False, True, False] * 2
    assert truncated.tolist() == [True, False, True] * 2
    still = {each: np.zeros(3, np.float32) for each in alone.agents}
    observations, *_ = alone.step(still)
    np.testing.assert_array_equal(seen[:3], list(observations.values()))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"num_envs": 0}, "num_envs: "),
        ({"starts": -1}, "starts: "),
        ({"starts_seed": 1.5}, "starts_seed: "),
        ({"autoreset_mode": "Never"}, "autoreset_mode: is "),
        ({"threads": 0}, "threads: "),
        ({"out": "episodes"}, "out: has no effect here"),
        ({"follower": "uav9"}, "uav9: no such follower"),
        ({"render_mode": "human"}, "render_mode: is "),
        ({"limit": 3}, "limit: "),
    ],
)
def test_wrong_arguments_of_vectors_are_named(options, text):
    with pytest.raises(InputError) as caught:
        make(**options)
    assert text in str(caught.value)


WRONG_ACTIONS = (np.zeros((2, 3)), np.zeros(3), "up", np.full((3, 3), np.nan))


def test_refused_actions_keep_all_episodes(twins):
    envs, _ = twins
    for each in twins:
        each.reset(seed=1)
    for step, wrong in enumerate(WRONG_ACTIONS):
        with pytest.raises(InputError, match="actions: "):
            envs.step(wrong)
        np.testing.assert_array_equal(
            *(each.step(actions(3, step))[0] for each in twins), err_msg=str(wrong)
        )


def test_a_mask_begins_some_episodes_only(twins):
    envs, twin = twins
    for each in twins:
        each.reset(seed=1)
        for step in range(3):
            each.step(actions(3, step))
    envs.reset(options={"reset_mask": np.array([True, False, False])})
    seen, *_, infos = envs.step(actions(3, 9))
    beside, *_, others = twin.step(actions(3, 9))
    assert infos["time_s"] == pytest.approx([0.22, 0.82, 0.82])
    np.testing.assert_array_equal(seen[1:], beside[1:])
    for key in SHOWN:
        np.testing.assert_array_equal(infos[key][1:], others[key][1:])
    envs.reset(options={})
    assert envs.step(actions(3, 9))[-1]["time_s"] == pytest.approx([0.22] * 3)


def test_a_mask_begins_an_ended_episode(brief):
    """The step after it flies; without a mask it would begin the next episode."""
    envs = brief
    envs.reset(seed=1)
    for _ in range(3):
        *_, truncated, _ = envs.step(np.zeros((3, 3)))
    assert truncated.all()
    envs.reset(options={"reset_mask": np.array([True, False, False])})
    assert envs.step(np.zeros((3, 3)))[-1]["time_s"] == pytest.approx([0.22, 0.02, 0.02])


WRONG_OPTIONS = (
    ({"reset_masks": np.ones(3, bool)}, "write reset_mask"),
    ({"reset_mask": np.ones(2, bool)}, "write 3 times true or false"),
    ({"reset_mask": np.zeros(3, bool)}, "one of them true"),
    ({"reset_mask": [1, 0, 0]}, "write 3 times true or false"),
    ("reset_mask", "options: is 'reset_mask'"),
)


def test_wrong_options_keep_all_episodes(twins):
    envs, _ = twins
    for each in twins:
        each.reset(seed=1)
        each.step(actions(3, 0))
    for step, (options, text) in enumerate(WRONG_OPTIONS, 1):
        with pytest.raises(InputError) as caught:
            envs.reset(seed=4, options=options)
        assert text in str(caught.value)
        np.testing.assert_array_equal(
            *(each.step(actions(3, step))[0] for each in twins), err_msg=str(options)
        )


def test_a_mask_needs_whole_flights():
    flights = FormationVectorEnv(2, duration_s=1.0, starts=1)
    flights.reset(seed=1)
    with pytest.raises(InputError, match="the 3 followers of a flight begin together"):
        flights.reset(options={"reset_mask": np.arange(6) == 0})
    flights.reset(options={"reset_mask": np.arange(6) < 3})
    assert flights.step(np.zeros((6, 3)))[-1]["time_s"] == pytest.approx(0.22)


def test_new_and_closed_environments_refuse_steps():
    envs = make(num_envs=2, starts=1)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((2, 3)))
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset(seed=1)
    envs.close()
    for call in (envs.reset, lambda: envs.step(np.zeros((3, 3)))):
        with pytest.raises(InputError, match="is closed"):
            call()


def test_one_flight_has_no_options():
    alone = gymnasium.make(ID, duration_s=1.0)
    alone.reset(options={})
    with pytest.raises(InputError, match="options: is "):
        alone.reset(options={"reset_mask": True})
