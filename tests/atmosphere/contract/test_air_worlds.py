"""The air in whole runs: repeatable, shared or independent, with events and warnings."""

import shutil
from functools import cache

import numpy as np
import pytest
from cases import ALL, some
from run_flight import Collector

from testbed.atmosphere.turbulence_field import make_field
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, allocate
from testbed.plan import air
from testbed.plan.air import build_air, build_mean_wind
from testbed.plan.world import build
from testbed.probes.air_probe import ProbePath, fly_probes
from testbed.runs.run import run
from testbed.scenario import find_aircraft, load_scenario, set_duration
from testbed.scenario.schema import Scenario
from testbed.vehicle.jsbsim_adapter import airframe

SECONDS = 4.0 if ALL else 2.0
AIRS = {
    "dryden": ["air.turbulence.model=dryden"],
    "von-karman": ["air.turbulence.model=von-karman"],
    "coherent": ["air.turbulence.model=coherent", "air.wind.speed_mps=5"],
    "wake": ["air.wake.core_spans=0.05"],
    "profile": ["air.wind={speed_mps: 6, from_deg: 250, profile: {kind: log}}"],
    "recorded": ["air.wind={file: gusty-wind.csv}"],
    "gusts": ["air.gusts=[{kind: time, name: puff, velocity_mps: [1, 0, -2], at_s: 1, ramp_s: 1}]"],
}


@pytest.fixture(scope="module", autouse=True)
def fields():
    """In `make test` equal fields are made once: they take longer than a flight in them."""
    made = {}

    def make_once(seed, sigma, length, **options):
        key = seed, *sigma, *length, *options.items()
        if key not in made or ALL:
            made[key] = make_field(seed, sigma, length, **options)
        return made[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(air, "make_field", make_once)
        yield


class Watcher(Collector):
    """Stores all samples."""

    def wind(self, name):
        row = self.info.names.index(name)
        return np.array([frame.air.wind_ned[row] for frame in self.frames])

    def position(self, name):
        row = self.info.names.index(name)
        return np.array([frame.truth.position_ned[row] for frame in self.frames])


@cache
def fly(*overrides, scenario="simulation-3", seconds=SECONDS):
    watcher = Watcher()
    page = set_duration(load_scenario(scenario, list(overrides)), seconds)
    assert run(page, write=False, observers=[watcher]).outcome == "completed"
    return watcher


def events_of(watcher):
    return [event for frame in watcher.frames for event in frame.events]


def test_air_still_or_steady_is_not_simulated():
    for overrides in ([], ["air.wind.speed_mps=5"], ["air.turbulence.model=none"]):
        assert build(load_scenario("simulation-3", overrides)).air is None


@pytest.mark.parametrize("name", some(AIRS, 4))
def test_air_is_independent_of_the_log_rate(name):
    often, seldom = (fly(*AIRS[name], f"rates.log_hz={rate}") for rate in (50, 10))
    for each in often.info.names:
        assert np.array_equal(often.position(each)[::5], seldom.position(each))
    assert often.wind("uav1").any()


@pytest.mark.parametrize("model", ["dryden", "von-karman", "coherent"])
def test_air_differs_with_the_seed(model):
    one, two = fly(*AIRS[model]), fly(*AIRS[model], "scenario.seed=2")
    assert not np.array_equal(one.wind("uav1"), two.wind("uav1"))


@pytest.mark.parametrize("model", ["dryden", "von-karman", "coherent"])
def test_air_is_independent_of_the_elevation(model):
    """By probes, whose record does not depend on the density."""

    def probed(elevation):
        page = load_scenario(
            "simulation-3", [*AIRS[model], f"scenario.origin.elevation_m={elevation}"]
        )
        course = ProbePath(
            rate_hz=50.0,
            duration_s=1.0 + SECONDS,
            airspeed=22.0,
            course=0.3,
            height=150.0,
            separation=None,
        )
        return fly_probes(page, course)

    low, high = probed(0.0), probed(1500.0)
    assert np.array_equal(low.wind_ned, high.wind_ned)
    assert np.array_equal(low.wind_gradient_rates, high.wind_gradient_rates)


def test_field_is_shared_and_own_turbulence_is_not():
    own, shared = fly(*AIRS["von-karman"]), fly(*AIRS["coherent"])

    def apart(watcher):
        return np.abs(watcher.wind("uav2") - watcher.wind("uav3")).mean()

    # uav2 and uav3 start 28 m from each other in air whose scale length is 263 m
    assert apart(shared) < 0.7 * apart(own)


def test_own_turbulence_is_independent_of_the_fleet():
    three = fly(*AIRS["dryden"])
    page = load_scenario("simulation-3", [*AIRS["dryden"]]).model_dump(by_alias=True)
    page["scenario"]["published"] = None
    page["fleet"] = page["fleet"][:1]
    page["formation"] |= {
        "offsets_m": {"uav1": (-5.0, 5.0, 0.0)},
        "leader_gains": {"uav1": (1.0, 1.0, 1.0)},
        "neighbour_gains": {},
    }
    watcher = Watcher()
    alone = set_duration(Scenario.model_validate(page), SECONDS)
    assert run(alone, write=False, observers=[watcher]).outcome == "completed"
    for name in ("leader", "uav1"):
        assert np.array_equal(three.wind(name), watcher.wind(name))


def test_ideal_vehicle_in_gusts_keeps_its_path():
    """Its airspeed varies."""
    still = fly(scenario="ideal-figure-eight")
    rough = fly(*AIRS["dryden"], scenario="ideal-figure-eight")
    assert np.array_equal(still.position("uav1"), rough.position("uav1"))
    airspeeds = [frame.truth.airspeed[1] for frame in rough.frames]
    assert np.std(airspeeds) > 0.1


def test_gust_arrivals_are_events():
    """A standing front across the way of the leader, which starts 30 m before it at 22 m/s."""
    front = "name: front, velocity_mps: [0, 3, 0], at_m: [640, -50], towards_deg: 270"
    watcher = fly(
        f"air.gusts=[{{kind: front, {front}, length_m: 20, speed_mps: 0, shape: ramp}}]",
        seconds=4.0,
    )
    reached = {e.source: e.time_s for e in events_of(watcher) if e.text == "gust front reaches it"}
    assert list(reached) == ["leader", "uav1", "uav2", "uav3"]  # they fly 25 and 45 m behind it
    assert reached["leader"] == pytest.approx(30.0 / 22.0, abs=0.05)
    assert watcher.wind("leader")[-1] == pytest.approx([0.0, 3.0, 0.0], abs=1e-6)
    puff = [e for e in events_of(fly(*AIRS["gusts"])) if "puff" in e.text]
    assert [(e.source, e.text) for e in puff] == [("run", "gust puff reaches all aircraft")]
    assert puff[0].time_s == pytest.approx(1.0, abs=0.05)


def test_model_without_gust_inputs_gives_a_warning(tmp_path):
    folder = tmp_path / "deaf"
    shutil.copytree(find_aircraft("rascal110"), folder)
    text = (folder / "rascal110.xml").read_text().replace("air/q-rad_sec", "other/q-rad_sec")
    (folder / "deaf.xml").write_text(text)
    (folder / "rascal110.xml").unlink()
    engine = "scenario.engine=jsbsim"  # compiling takes seconds, and does not matter
    page = load_scenario(
        "simulation-3", [engine, f"fleet.0.aircraft={folder}", "air.turbulence.model=dryden"]
    )
    events = [
        (note.source, note.text)
        for note in build(page).initial_events
        if "air/q-rad_sec" in note.text
    ]
    assert [source for source, _ in events] == ["uav1"]


def test_field_without_wind_gives_a_warning():
    texts = [note.text for note in build(load_scenario("turbulence-moderate")).initial_events]
    assert not any("stands still" in text for text in texts)
    calm = load_scenario("simulation-3", ["air.turbulence.model=coherent"])
    assert any("stands still" in note.text for note in build(calm).initial_events)


def test_wakes_act_beside_and_behind():
    flown = run(set_duration(load_scenario("close-formation-wake"), 60.0), write=False)
    wind_down = {name: each["mean_ned_mps"][2] for name, each in flown.metrics["wind"].items()}
    assert wind_down["uav1"] < -0.02  # beside: upwash
    assert wind_down["uav2"] < -0.02
    assert wind_down["uav3"] > 0.05  # behind: downwash
    assert abs(wind_down["leader"]) < 0.01


def behind_in(*overrides):
    """Wind of a Rascal 9 m behind and 1 m right of another after 3 s, both in a wind of 5 m/s."""
    page = load_scenario("simulation-3", ["air.wake.core_spans=0.05", *overrides])
    rascal = airframe(find_aircraft("rascal110"))
    names = ["one", "two"]
    height, elevation = page.leader.start.altitude_m, page.scenario.origin.elevation_m
    mean = build_mean_wind(page.air.wind, height_m=height, duration_s=3.0)
    given = {"seed": 1, "height_m": height, "elevation_m": elevation, "dt": 0.02}
    air = build_air(page.air, mean, names, [rascal] * 2, **given, sheds=[True] * 2)
    aircraft = allocate(AIRCRAFT, 2)
    air.bind(aircraft)
    motion, wind = aircraft["truth"], aircraft["wind"]
    start = np.array([[0.0, 0.0, -100.0], [-9.0, 1.0, -100.0]])
    motion["velocity_ned"] = velocity = np.array([[22.0, 5.0, 0.0]] * 2)
    for k in range(151):
        motion["position_ned"] = start + velocity * 0.02 * k
        air.sample_wind(0.02 * k)
    return np.array(wind["wind_ned"][1]), float(wind["wake_delta_cl"][1])


def test_lasting_gust_moves_trails_as_the_mean_wind():
    mean = behind_in("air.wind={speed_mps: 5, from_deg: 270}")
    gust = "{kind: time, name: shift, velocity_mps: [0, 5, 0], at_s: 0, ramp_s: 0.01, shape: ramp}"
    shear = "{speed_mps: 5, from_deg: 270, profile: {kind: log, height_m: 100}}"
    for other in (behind_in(f"air.gusts=[{gust}]"), behind_in(f"air.wind={shear}")):
        assert other[0] == pytest.approx(mean[0], abs=2e-3)
        assert other[1] == pytest.approx(mean[1], rel=0.02)
    assert mean[0][2] > 0.1  # it is in the downwash
    assert abs(mean[1]) > 0.005


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["air.turbulence.height_m=2"], "that of 2 m above the ground.*air.turbulence.height_m"),
        (["air.turbulence.length_m=[2, 2, 2]"], "length of 2 m.*air.turbulence.length_m"),
    ],
)
def test_field_too_coarse_error_names_the_keys(overrides, message):
    page = load_scenario("simulation-3", ["air.turbulence.model=coherent", *overrides])
    with pytest.raises(InputError, match=message):
        build(page)
