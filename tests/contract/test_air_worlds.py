"""Air in whole worlds: repeatable, each aircraft's own, and told of."""

import shutil

import numpy as np
import pytest

from testbed.errors import InputError
from testbed.scenario import find_aircraft, load, shorten
from testbed.scenario.schema import Scenario
from testbed.sim.airs import make_air, make_mean
from testbed.sim.probes import Course, fly_probes
from testbed.sim.run import run
from testbed.sim.world import build
from testbed.state import VehicleState
from testbed.vehicle.jsbsim_door import airframe

SECONDS = 4.0
AIRS = {
    "dryden": ["air.turbulence.model=dryden"],
    "von-karman": ["air.turbulence.model=von-karman"],
    "coherent": ["air.turbulence.model=coherent", "air.wind.speed_mps=5"],
    "wake": ["air.wake.core_spans=0.05"],
    "profile": ["air.wind={speed_mps: 6, from_deg: 250, profile: {kind: log}}"],
    "recorded": ["air.wind={file: gusty-wind.csv}"],
    "gusts": ["air.gusts=[{kind: time, name: puff, velocity_mps: [1, 0, -2], at_s: 1, ramp_s: 1}]"],
}


class Watcher:
    """Keeps the wind and the positions of every frame."""

    def begin(self, info):
        self.frames, self.events, self.names = [], [], info.names

    def observe(self, frame):
        self.frames.append(frame)
        self.events += frame.events

    def end(self, summary, events):
        """Nothing is left to do."""

    def wind(self, name):
        row = self.names.index(name)
        return np.array([frame.air.wind_ned[row] for frame in self.frames])

    def position(self, name):
        row = self.names.index(name)
        return np.array([frame.truth.position_ned[row] for frame in self.frames])


def fly(*overrides, scenario="simulation-3", seconds=SECONDS):
    watcher = Watcher()
    page = shorten(load(scenario, list(overrides)), seconds)
    assert run(page, write=False, observers=[watcher]).outcome == "flown"
    return watcher


def test_still_and_steady_air_cost_nothing():
    for overrides in ([], ["air.wind.speed_mps=5"], ["air.turbulence.model=none"]):
        assert build(load("simulation-3", overrides)).air is None


@pytest.mark.parametrize("air", AIRS.values(), ids=AIRS)
def test_the_same_page_is_the_same_air_to_the_bit(air):
    one, two = fly(*air), fly(*air)
    for name in one.names:
        assert np.array_equal(one.wind(name), two.wind(name))
        assert np.array_equal(one.position(name), two.position(name))
    assert one.wind("uav1").any()


@pytest.mark.parametrize("air", AIRS.values(), ids=AIRS)
def test_what_is_logged_moves_no_aircraft(air):
    often, seldom = fly(*air, "rates.log_hz=50"), fly(*air, "rates.log_hz=10")
    assert np.array_equal(often.position("uav2")[::5], seldom.position("uav2"))


@pytest.mark.parametrize("model", ["dryden", "von-karman", "coherent"])
def test_another_seed_is_another_air(model):
    one, two = fly(*AIRS[model]), fly(*AIRS[model], "scenario.seed=2")
    assert not np.array_equal(one.wind("uav1"), two.wind("uav1"))


@pytest.mark.parametrize("model", ["dryden", "von-karman", "coherent"])
def test_how_high_the_ground_lies_is_all_the_same_to_the_air(model):
    """A probe's record has nothing of the flight in it, whose air is thinner."""

    def felt(elevation):
        page = load("simulation-3", [*AIRS[model], f"scenario.origin.elevation_m={elevation}"])
        course = Course(
            rate_hz=50.0, duration_s=5.0, airspeed=22.0, course=0.3, height=150.0, separation=None
        )
        return fly_probes(page, course)

    low, high = felt(0.0), felt(1500.0)
    assert np.array_equal(low.wind_ned, high.wind_ned)
    assert np.array_equal(low.rates_body, high.rates_body)


def test_draws_of_their_own_differ_and_a_shared_field_does_not():
    own, shared = fly(*AIRS["von-karman"]), fly(*AIRS["coherent"])

    def apart(watcher):
        return np.abs(watcher.wind("uav2") - watcher.wind("uav3")).mean()

    # uav2 and uav3 start 28 m from each other in air whose scale length is 263 m
    assert apart(shared) < 0.7 * apart(own)


def test_one_aircraft_more_moves_no_dice():
    three = fly(*AIRS["dryden"])
    page = load("simulation-3", [*AIRS["dryden"]]).model_dump(by_alias=True)
    page["scenario"]["published"] = None
    page["fleet"] = page["fleet"][:1]
    page["formation"] |= {
        "offsets_m": {"uav1": (-5.0, 5.0, 0.0)},
        "leader_gains": {"uav1": (1.0, 1.0, 1.0)},
        "neighbour_gains": {},
    }
    watcher = Watcher()
    alone = shorten(Scenario.model_validate(page), SECONDS)
    assert run(alone, write=False, observers=[watcher]).outcome == "flown"
    for name in ("leader", "uav1"):
        assert np.array_equal(three.wind(name), watcher.wind(name))


def test_an_ideal_vehicle_is_moved_by_no_gust_but_flies_in_it():
    still = fly(scenario="ideal-figure-eight")
    rough = fly(*AIRS["dryden"], scenario="ideal-figure-eight")
    assert np.array_equal(still.position("uav1"), rough.position("uav1"))
    airspeeds = [frame.truth.airspeed[1] for frame in rough.frames]
    assert np.std(airspeeds) > 0.1


def test_gusts_are_told_of_when_they_arrive():
    """A standing front across the way of the leader, which starts 30 m before it at 22 m/s."""
    front = "name: front, velocity_mps: [0, 3, 0], at_m: [640, -50], towards_deg: 270"
    watcher = fly(f"air.gusts=[{{kind: place, {front}, length_m: 20, speed_mps: 0, shape: ramp}}]")
    reached = {e.source: e.time_s for e in watcher.events if e.text == "gust front reaches it"}
    assert list(reached) == ["leader", "uav1", "uav2", "uav3"]  # they fly 25 and 45 m behind it
    assert reached["leader"] == pytest.approx(30.0 / 22.0, abs=0.05)
    assert watcher.wind("leader")[-1] == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)
    puff = [e for e in fly(*AIRS["gusts"]).events if "puff" in e.text]
    assert [(e.source, e.text) for e in puff] == [("run", "gust puff reaches everyone")]
    assert puff[0].time_s == pytest.approx(1.0, abs=0.05)


def test_a_model_that_cannot_feel_turns_says_so(tmp_path):
    folder = tmp_path / "deaf"
    shutil.copytree(find_aircraft("rascal110"), folder)
    text = (folder / "rascal110.xml").read_text().replace("air/q-rad_sec", "other/q-rad_sec")
    (folder / "deaf.xml").write_text(text)
    (folder / "rascal110.xml").unlink()
    page = load("simulation-3", [f"fleet.0.aircraft={folder}", "air.turbulence.model=dryden"])
    said = [(note.source, note.text) for note in build(page).notes if "air/q-rad_sec" in note.text]
    assert [source for source, _ in said] == ["uav1"]


def test_a_field_that_stands_still_is_told_of():
    told = [note.text for note in build(load("turbulence-moderate")).notes]
    assert not any("stands still" in text for text in told)
    calm = load("simulation-3", ["air.turbulence.model=coherent"])
    assert any("stands still" in note.text for note in build(calm).notes)


def test_wakes_are_felt_beside_and_behind():
    flown = run(shorten(load("close-formation-wake"), 60.0), write=False)
    felt = {name: each["mean_ned_mps"][2] for name, each in flown.metrics["wind"].items()}
    assert felt["uav1"] < -0.02  # beside: upwash
    assert felt["uav2"] < -0.02
    assert felt["uav3"] > 0.05  # behind: downwash
    assert abs(felt["leader"]) < 0.01


def behind_in(*overrides):
    """What a Rascal 9 m behind and 1 m right of another feels after 3 s, both blown by 5 m/s."""
    page = load("simulation-3", ["air.wake.core_spans=0.05", *overrides])
    rascal = airframe(find_aircraft("rascal110"))
    names = ["one", "two"]
    air = make_air(page, make_mean(page), names, [rascal] * 2, dt=0.02, sheds=[True] * 2)
    start = np.array([[0.0, 0.0, -100.0], [-9.0, 1.0, -100.0]])
    velocity = np.array([[22.0, 5.0, 0.0]] * 2)
    none, zero = np.zeros((2, 3)), np.zeros(2)
    for k in range(151):
        motion = VehicleState(start + velocity * 0.02 * k, velocity, none, none, none, zero, zero)
        felt = air.felt(0.02 * k, motion)
    return felt.wind_ned[1], felt.roll_coefficient[1]


def test_a_gust_that_stays_carries_trails_as_the_mean_wind_does():
    mean = behind_in("air.wind={speed_mps: 5, from_deg: 270}")
    gust = "{kind: time, name: shift, velocity_mps: [0, 5, 0], at_s: 0, ramp_s: 0.01, shape: ramp}"
    shear = "{speed_mps: 5, from_deg: 270, profile: {kind: log, height_m: 100}}"
    for other in (behind_in(f"air.gusts=[{gust}]"), behind_in(f"air.wind={shear}")):
        assert other[0] == pytest.approx(mean[0], abs=2e-3)
        assert other[1] == pytest.approx(mean[1], rel=0.02)
    assert mean[0][2] > 0.1  # it is in the downwash
    assert abs(mean[1]) > 0.005


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["air.turbulence.height_m=2"], "that of 2 m above the ground.*air.turbulence.height_m"),
        (["air.turbulence.length_m=[2, 2, 2]"], "length of 2 m.*air.turbulence.length_m"),
    ],
)
def test_a_field_too_coarse_for_its_air_is_refused_with_the_pages_keys(overrides, said):
    page = load("simulation-3", ["air.turbulence.model=coherent", *overrides])
    with pytest.raises(InputError, match=said):
        build(page)
