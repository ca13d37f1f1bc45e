"""What measures speed: bare and full do the same steps, and every room is found."""

import importlib
import itertools
from pathlib import Path

import pytest

from testbed.scenario import load, shorten
from testbed.sim.world import build
from testbed.study.plan import load_study

ROOT = Path(__file__).parents[2]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_every_room_but_the_loop_has_doors(benchmark):
    rooms = benchmark("rooms")
    assert {*rooms.DOORS, "loop"} == set(rooms.ROOMS)


def test_a_flight_is_found_in_its_rooms(benchmark):
    rooms, ratio = benchmark("rooms"), benchmark("full_over_bare")
    page = shorten(load("simulation-3"), 4.0)
    # a clock that goes on by one whenever somebody looks at it
    watch = rooms.Rooms(itertools.count().__next__)
    with watch.within():
        ratio.full(page, watch)
    assert sum(watch.shares.values()) == pytest.approx(1.0)
    ticks, frames = 4 * page.rates.autopilot_hz + 1, 4 * page.rates.log_hz + 1
    # the log is entered once for every frame
    visits = {room: frames * share / watch.shares["log"] for room, share in watch.shares.items()}
    assert visits["physics"] == visits["autopilot"] == pytest.approx(ticks)
    assert visits["leader"] == pytest.approx(frames)
    # what learns and then steps, and what takes the slots and then the frame
    assert visits["control"] == visits["metrics"] == pytest.approx(2 * frames)
    assert visits["air"] == 0.0  # still
    assert min(visits[room] for room in ("truth", "sensing", "network", "events")) > frames
    assert max(visits, key=visits.__getitem__) == "loop"  # between any two of them


def test_numbers_of_turns(benchmark):
    ratio, speed = benchmark("full_over_bare"), benchmark("speed")
    cost = ratio.Cost
    page = shorten(load("simulation-3"), 10.0)  # 40 aircraft-seconds
    turns = [
        ratio.Turn(
            cost(1.0, 0.8), cost(2.0, 2.0), cost(2.1, 2.1), 0.1, cost(1.1, 1.0), cost(1.5, 1.0)
        ),
        ratio.Turn(
            cost(0.9, 0.8), cost(2.7, 2.4), cost(3.0, 2.4), 0.2, cost(1.1, 1.2), cost(1.62, 1.0)
        ),
        ratio.Turn(
            cost(2.0, 1.6), cost(5.0, 4.0), cost(5.0, 4.0), 0.3, cost(2.0, 2.0), cost(3.2, 1.0)
        ),
    ]
    told = speed.numbers(page, turns, {"physics": 0.5, "log": 0.5})
    assert told["full_over_bare"] == 2.5
    assert told["full_over_bare_spread"] == pytest.approx([2.0, 3.0])
    assert told["full_over_bare_processor_spread"] == pytest.approx([2.5, 3.0])
    assert told["least_full_over_least_bare"] == pytest.approx(2.0 / 0.9)
    assert told["real_time_factor"] == pytest.approx(10.0 / 2.7)
    each = told["us_per_aircraft_second"]
    assert each["full"] == pytest.approx(2.4e6 / 40.0) and each["bare"] == pytest.approx(0.8e6 / 40)
    assert each["physics"] == pytest.approx(each["full"] / 2.0)
    assert told["looking_costs"] == 1.0 and told["build_s"] == 0.2
    assert told["held_over_bare_processor"] == pytest.approx(1.25)
    crew = told["crew"]  # medians of 1.5, 1.8 and 1.6 bare loops, and of 1.5, 1.62 and 3.2 s
    assert crew["full_over_bare"] == 1.6
    assert crew["full_over_bare_spread"] == pytest.approx([1.5, 1.8])
    assert crew["real_time_factor"] == pytest.approx(10.0 / 1.62)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_vees_have_as_many_flight_models_as_they_say(benchmark, count):
    fleets = benchmark("fleets")
    page = fleets.vee(count, 1.0)
    fleet = build(page).fleet
    assert benchmark("full_over_bare").flight_models(page) == len(fleet.bare_runs()) == count


def test_all_troubles_are_those_of_their_pages(benchmark):
    page, radio, air = benchmark("fleets").busy(), load("bursty-wifi"), load("turbulence-moderate")
    assert (page.network, page.rates) == (radio.network, radio.rates)
    assert page.air == air.air and page.controller.bounds_of == air.controller.bounds_of
    pixhawk = load("simulation-3-pixhawk").leader.sensors
    assert {each.sensors for each in page.aircraft} == {pixhawk}


def test_the_study_of_rates_flies_every_case_that_its_table_needs(benchmark):
    convergence = benchmark("convergence")
    page = load_study(convergence.STUDY).page
    steps = {
        convergence.TWICE,
        *(c for each in convergence.LADDERS.values() for c in each.values()),
    }
    assert set(page.cases) == {name + step for name in convergence.SIMULATIONS for step in steps}
    base = load("simulation-3").rates
    own = {"physics": base.physics_hz, "autopilot": base.autopilot_hz, "frames": base.log_hz}
    own["control and messages"] = base.control_hz
    for what, ladder in convergence.LADDERS.items():
        assert [rate for rate, case in ladder.items() if not case] == [own[what]]
        for rate, case in ladder.items():
            assert not case or case.endswith(f"-{rate}")
