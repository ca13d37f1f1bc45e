"""A flight that returns to a saved moment goes on from there as it did."""

import os
import threading

import numpy as np
import pytest
from places import ROOT

import testbed
from testbed.core.errors import InputError
from testbed.core.saved_state import Replayed, SavedState, copy_state
from testbed.scenario import list_scenarios, load_scenario, set_duration

CLOCKS = ("wall_s", "real_time_factor")
SOME = ("simulation-3-pixhawk", "telemetry-radio", "own-law-integral", "engine-out-uav2")
OTHERS = ("simulation-3-ardupilot", "late-radio-loss")  # a program; begins as another, see below
ALL = [each for each in list_scenarios() if each not in OTHERS]
WHOLE = bool(os.environ.get("TESTBED_WHOLE"))
CHOSEN = ALL if WHOLE else SOME


def numbers(metrics):
    return str({key: value for key, value in metrics.items() if key not in CLOCKS})


def fly(simulation):
    """All numbers of some later moments, of the metrics and the events."""
    seen = []
    for until in (6.0, 6.7, 20.0):
        state = simulation.step(until=until)
        seen += [each.tobytes() for each in (*state.truth, *state.estimate, *state.command)]
    return seen, numbers(simulation.metrics), [str(each) for each in simulation.events]


def short(name, duration_s=10.0 if WHOLE else 7.0):
    return set_duration(load_scenario(name), duration_s)


@pytest.mark.parametrize("name", CHOSEN)
def test_restored_flight_goes_on_to_the_bit(name):
    simulation = testbed.Simulation(short(name))
    simulation.step(until=3.0)
    early = simulation.save()
    simulation.step(until=5.3)
    saved = simulation.save()
    flown = fly(simulation)
    assert simulation.outcome is not None
    assert simulation.restore(saved).time_s == pytest.approx(5.3, abs=0.02)
    assert simulation.outcome is None
    assert fly(simulation) == flown
    simulation.restore(early)
    simulation.step(until=5.3)
    assert fly(simulation) == flown


@pytest.mark.parametrize("name", CHOSEN)
def test_reset_rows_fly_as_new_ones(name):
    """With another seed and the same one; the rows beside stay as they are."""
    scenario = short(name, 10.0 if WHOLE else 2.5)
    batch = testbed.Batch(scenario, seeds=[1, 2, 3])
    expected = [numbers(each) for each in batch.run()]
    outer = [batch.aircraft[row].tobytes() for row in (0, 2)]
    for seed in (3, 3, 1):
        batch.reset([1], [seed])
        assert batch.times_s[1] == 0.0 and batch.outcomes[1] is None
        assert [batch.aircraft[row].tobytes() for row in (0, 2)] == outer
        batch.run()
        assert numbers(batch.metrics(1)) == expected[seed - 1]


@pytest.mark.parametrize("part", ["fleet", "radio", "estimators"])
def test_state_that_is_not_saved_is_noticed(part, monkeypatch):
    """The comparison with a flight that goes on fails where a part is left out."""
    simulation = testbed.Simulation(short("simulation-3-pixhawk"))
    simulation.step(until=5.3)
    world = simulation._world
    left = {"fleet": world.fleet, "radio": world.formation.radio, "estimators": world.estimators}
    own = SavedState(part=left[part])._arrays
    saved = simulation.save()
    state, flown = saved.state, fly(simulation)
    pairs = list(zip(state._arrays, state._copies, strict=True))
    kept = [pair for pair in pairs if not any(np.shares_memory(pair[0], each) for each in own)]
    monkeypatch.setattr(state, "_arrays", [each for each, _ in kept])
    monkeypatch.setattr(state, "_copies", [each for _, each in kept])
    assert 0 < len(kept) < len(pairs)
    simulation.restore(saved)
    assert fly(simulation) != flown


def begun(name, *changes, at_s=5.3):
    """The scenario that begins as one is at a time, with changes; without its windows."""
    settings = [
        f"scenario.begin={{scenario: {name}, at_s: {at_s}}}",
        "scenario.windows=null",
        "scenario.published=null",
        "expect={}",
    ]
    return set_duration(load_scenario(name, [*settings, *changes]), short(name).scenario.duration_s)


BEGUN = [each for each in CHOSEN if each != "own-law-repulsion"]
COMPILED = pytest.param(str(ROOT / "examples/integral-kernel.yaml"), id="compiled-law")


@pytest.mark.parametrize("name", [*BEGUN, COMPILED])
def test_flight_begins_as_another_to_the_bit(name):
    other, own = (testbed.Simulation(each) for each in (short(name), begun(name, at_s=5.3)))
    other.step(until=5.3)
    assert own.time_s == other.time_s
    assert fly(own)[0] == fly(other)[0]
    assert own.outcome == other.outcome


@pytest.mark.parametrize(
    ("changes", "anew"),
    [
        (["network.loss=0.9"], ""),
        (["controller.gain_scale=0.5"], ""),
        (["air.wind={speed_mps: 4, from_deg: 90}"], ""),
        (["fleet.*.sensors=gps-ins"], ""),
        (["controller.law=leader_follower:LeaderFollower"], "law and middle loop begin anew"),
    ],
)
def test_variants_begin_alike_and_part(changes, anew):
    own, other = (
        testbed.Simulation(begun("simulation-3", *changes)),
        testbed.Simulation(short("simulation-3")),
    )
    other.step(until=5.3)
    first = own.state.truth.position_ned
    np.testing.assert_array_equal(first, other.state.truth.position_ned)
    moved = fly(own)[0] != fly(other)[0]
    assert own.metrics["max_error_m"]["uav1"] < 20.0
    assert moved and own.outcome == "completed"
    text = next(each.text for each in own.events if each.text.startswith("begins as simulation-3"))
    assert text.endswith(anew or "simulation-3")


def test_run_batch_and_log_begin_alike(tmp_path):
    scenario = begun("simulation-3-noise", "network.loss=0.5")
    flown = testbed.run(scenario, out=tmp_path / "run")
    assert flown.metrics["begin_s"] == 5.32  # the first sample of the log
    sent = flown.metrics["network"]["links"]["leader"]["uav1"]["sent"]
    assert sent == pytest.approx(25 * (scenario.scenario.duration_s - 5.3), abs=2)
    batch = testbed.Batch(scenario, seeds=[1, 2, 1], threads=2)
    first, second, third = (numbers(each) for each in batch.run())
    assert first == third == numbers(flown.metrics) != second
    batch.reset([0], [2])
    batch.run()
    assert numbers(batch.metrics(0)) == second


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (["scenario.begin.at_s=10"], "begin.at_s: is not before the end"),
        (["scenario.begin.at_s=5.305"], "begin.at_s: is no time at which autopilots step"),
        (["scenario.begin.scenario=simulation-9"], "there is no scenario 'simulation-9'"),
        (["scenario.begin.scenario=hold-slot"], "hold-slot has other names than simulation-3"),
        (["rates.physics_hz=200"], "simulation-3 has other rates than simulation-3"),
        (["fleet.uav1.aircraft=skywalker_x8"], "simulation-3 has other airframes"),
        (["scenario.engine=jsbsim"], "flight models of JSBSim have no state"),
        (["scenario.windows={w: [1, 9]}"], "begins at 1 s, before the flight"),
        (["fleet.uav1.faults=[{kind: engine-out, at_s: 2}]"], "before the flight begins"),
        (["fleet.uav1.commanded_by=external"], "is not for flights that begin"),
    ],
)
def test_flights_that_cannot_begin_so_are_refused(changes, text):
    with pytest.raises(InputError) as caught:
        testbed.Simulation(begun("simulation-3", *changes))
    assert text in str(caught.value)


def test_other_flight_that_ends_earlier_is_named(tmp_path):
    brief = tmp_path / "brief.yaml"
    header = (
        "{name: brief, duration_s: 6, windows: {rectangles: null, circles: null}, published: null}"
    )
    brief.write_text(f"extends: simulation-3\nscenario: {header}\n")
    scenario = begun("simulation-3", f"scenario.begin={{scenario: {brief}, at_s: 6.5}}")
    with pytest.raises(InputError, match=r"begin.at_s: brief ends at 6 s: completed \(write an"):
        testbed.Simulation(scenario)


def test_commands_after_a_fork_make_variants():
    changes = ["fleet.uav1.commanded_by=external"]
    simulation = testbed.Simulation("simulation-1", changes)
    simulation.step(until=2.0)
    saved = simulation.save()
    ends = []
    for roll in (0.3, -0.3, 0.3):
        simulation.restore(saved)
        state = simulation.step({"uav1": (0.0, roll, 0.5)}, until=6.0)
        ends.append(state.truth.position_ned.copy())
    assert np.array_equal(ends[0], ends[2]) and ends[0][1, 0] < ends[1][1, 0] - 10.0


class Counting:
    """An observer that holds something."""

    zero_copy = True

    def __init__(self, held):
        self.held, self.count = held, 0

    def begin(self, info):
        pass

    def observe(self, sample):
        self.count += 1

    def end(self, summary, events):
        pass


def test_observers_are_saved_too():
    observer = Counting({"some": [1, 2.0]})
    simulation = testbed.Simulation(short("hold-slot"), observers=[observer])
    simulation.step(until=1.0)
    saved, count = simulation.save(), observer.count
    observer.held["some"].append("more")
    simulation.step(until=2.0)
    assert observer.count > count
    simulation.restore(saved)
    assert observer.count == count and observer.held == {"some": [1, 2.0]}


@pytest.mark.parametrize(
    ("held", "text"),
    [
        ((each for each in "ab"), "observers[0].held is a builtins.generator"),
        (threading.Lock(), "observers[0].held is a _thread.lock"),
        ([{"a": memoryview(b"1")}], "observers[0].held[0]['a'] is a builtins.memoryview"),
    ],
)
def test_what_cannot_be_saved_is_named(held, text):
    simulation = testbed.Simulation(short("hold-slot"), observers=[Counting(held)])
    with pytest.raises(InputError) as caught:
        simulation.save()
    assert text in str(caught.value)


def test_flights_with_state_elsewhere_are_refused(tmp_path):
    with testbed.Simulation(short("hold-slot"), out=tmp_path / "run") as simulation:
        with pytest.raises(InputError, match="run: a flight that writes files cannot be saved"):
            simulation.save()
    engine = set_duration(load_scenario("hold-slot", ["scenario.engine=jsbsim"]), 2.0)
    with pytest.raises(InputError, match=r"engine: jsbsim: .* \(write scenario.engine=compiled"):
        testbed.Simulation(engine).save()
    one, other = (testbed.Simulation(short("hold-slot")) for _ in range(2))
    saved = one.save()
    for wrong in (saved, None, "state"):
        with pytest.raises(InputError, match="saved: is not of this flight"):
            other.restore(wrong)
    one.reset()
    with pytest.raises(InputError, match="saved: is not of this flight"):
        one.restore(saved)


class Part:
    __slots__ = ("array", "number")

    def __init__(self, number):
        self.number, self.array = number, np.full(3, float(number))


class Open:
    UNSAVED = ("cache",)

    def __init__(self):
        self.kept, self.gone = 1, 2


def test_attributes_return_to_their_state():
    """Those that have come go, those that have gone come back; what is no state stays."""
    part = Open()
    state = SavedState(part=part)
    part.kept, part.new, part.cache = 5, 3, 4
    del part.gone
    state.restore()
    assert vars(part) == {"kept": 1, "gone": 2, "cache": 4}


def test_objects_return_to_their_state():
    """Arrays and containers keep their identity, and what refers to them."""
    shared = np.arange(4.0)
    whole = {"part": Part(1), "views": [shared[1:], shared[:2]], "set": {1}, "rng": None}
    whole["rng"] = np.random.default_rng(1)
    tail, part = whole["views"][0], whole["part"]
    state = SavedState(whole=whole)
    drawn = whole["rng"].standard_normal()
    shared[:] = 9.0
    part.number, part.array = 7, np.zeros(3)
    whole["views"].clear()
    whole["set"].add(2)
    whole["new"] = 1
    state.restore()
    assert set(whole) == {"part", "views", "set", "rng"} and whole["set"] == {1}
    assert whole["views"][0] is tail and tail.tolist() == [1.0, 2.0, 3.0]
    assert whole["part"] is part and part.number == 1 and part.array.tolist() == [1.0] * 3
    assert whole["rng"].standard_normal() == drawn


def test_replayed_iterators_go_back():
    holder = {"it": Replayed(lambda: iter(range(10)))}
    assert [next(holder["it"]) for _ in range(3)] == [0, 1, 2]
    state = SavedState(holder=holder)
    assert next(holder["it"]) == 3
    state.restore()
    assert [next(holder["it"]) for _ in range(2)] == [3, 4]


def test_copies_need_the_same_structure():
    target = Part(1)
    copy_state(Part(5), target)
    assert target.number == 5 and target.array.tolist() == [5.0] * 3
    with pytest.raises(TypeError, match="is a .*list.* here"):
        copy_state({"a": [1]}, {"a": (1,)})
    with pytest.raises(TypeError, match="cannot be exchanged"):
        copy_state([(1, 2)], [(1, 3)])
