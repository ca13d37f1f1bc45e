"""A flight that ends when a bound of `expect` is violated, whatever follows."""

import json

import pytest

import testbed
from testbed.metrics import accumulator
from testbed.metrics.document import BOUND_VIOLATED

WALL_CLOCK = ("wall_s", "real_time_factor")
STOP = "limits.on_violation=stop"
PUBLISHED, WINDOW = "scenario.published=null", "scenario.windows={late: [5, 20]}"
BROKEN = [PUBLISHED, WINDOW, "expect.max_error_m.max=0.01", STOP]


@pytest.fixture(scope="module", autouse=True)
def short_spans():
    """Bounds are looked at every 10 s in place of 40, as often as samples are summed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accumulator, "SPAN", accumulator.SPAN // 4)
        yield


def fly(*overrides, duration_s=22.0):
    settings = [PUBLISHED, WINDOW, *overrides]
    return testbed.Batch("simulation-3", settings, duration_s=duration_s, threads=1).run()[0]


def timeless(metrics):
    return {key: value for key, value in metrics.items() if key not in WALL_CLOCK}


KEPT = ("expect.rms_m.max=1e3", "expect.min_separation_m.min=0.1", "expect.left_speed_set.max=99")


def test_a_flight_that_keeps_its_bounds_is_the_same():
    whole, stopped = fly(*KEPT), fly(*KEPT, STOP)
    assert timeless(whole) == timeless(stopped)
    assert whole["outcome"] == "completed"
    assert whole["expect"]["checked"] == 7


# of the quantity, whose value in the whole flight is taken, and the side of its bound
QUANTITIES = {
    "rms_m": "max",
    "mean_rms_m": "max",
    "estimated_rms_m": "max",
    "percent_error": "max",
    "max_error_m": "max",
    "min_separation_m": "min",
}


def numbers(metrics, quantity):
    window = metrics["windows"]["late"]
    value = window[quantity] if quantity in window else metrics[quantity]
    return list(value.values()) if isinstance(value, dict) else [value]


@pytest.fixture(scope="module")
def whole():
    return fly()


@pytest.mark.parametrize(("quantity", "side"), QUANTITIES.items(), ids=QUANTITIES)
def test_only_a_bound_beyond_the_whole_flight_ends_it(whole, quantity, side):
    """Just beyond the number of the whole flight it is not ended; far beyond it is, and earlier."""
    values = numbers(whole, quantity)
    just, far = (max(values), 0.1 * max(values)) if side == "max" else (min(values), 1e3)
    kept = fly(f"expect.{quantity}.{side}={just!r}", STOP)
    assert kept["outcome"] == "completed"
    assert {key: kept[key] for key in timeless(whole)} == timeless(whole)
    ended = fly(f"expect.{quantity}.{side}={far!r}", STOP)
    assert ended["outcome"] == BOUND_VIOLATED
    assert ended["simulated_s"] < 18.0
    assert ended["expect"]["violated"] > 0


@pytest.mark.parametrize(("quantity", "side"), [("rms_m", "min"), ("min_separation_m", "max")])
def test_a_number_that_may_still_change_ends_nothing(quantity, side):
    metrics = fly(f"expect.{quantity}.{side}={1e3 if side == 'min' else 0.1}", STOP)
    assert metrics["outcome"] == "completed"
    assert metrics["simulated_s"] == 22.0
    assert metrics["expect"]["violated"]


def test_run_ends_with_the_code_of_a_violation(tmp_path):
    settings = [*BROKEN, "log.mcap=false"]
    run = testbed.run("simulation-3", settings, duration_s=30.0, out=tmp_path / "run")
    assert (run.outcome, run.exit_code) == (BOUND_VIOLATED, 3)
    written = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert written["outcome"] == BOUND_VIOLATED
    assert written["simulated_s"] < 30.0


def test_a_simulation_ends_and_begins_again():
    with testbed.Simulation("simulation-3", BROKEN, duration_s=30.0) as simulation:
        for _ in range(2):
            simulation.reset()
            while simulation.outcome is None:
                simulation.step(until=simulation.time_s + 2.5)
            assert simulation.outcome == BOUND_VIOLATED
            assert 10.0 < simulation.time_s < 18.0


def test_a_limit_exceeded_before_is_the_outcome():
    settings = ("limits.min_separation_m=30", "expect.max_error_m.max=0.01", STOP)
    assert fly(*settings)["outcome"] == "separation_lost"


def test_a_batch_returns_to_its_start():
    settings = [*BROKEN, "network.loss=0.2"]
    batch = testbed.Batch("simulation-3", settings, duration_s=30.0, threads=1)
    (first,) = batch.run()
    for seed in (2, 1):
        batch.reset(seeds=[seed])
        (again,) = batch.run()
    assert timeless(again) == timeless(first)
    assert first["outcome"] == BOUND_VIOLATED
