"""Damping and margins by kicks in steady flight, and `testbed margins`."""

import json
import math

import numpy as np
import pytest
from commands import call_command, refuse_all

from testbed.scenario import load_scenario
from testbed.studies.flight_task import FlightTask, run_task
from testbed.studies.tune_constraints import measurements
from testbed.studies.tune_schema import Constraint
from testbed.trials import margins
from testbed.trials.margins import FollowerMargins, Margins, independent_groups, worse_of
from testbed.trials.steady_flight import Change, SteadyFlight


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("simulation-3")


@pytest.fixture(scope="module")
def flight(scenario):
    """A clockwise circle, steady at about 32 degrees of bank."""
    return SteadyFlight(scenario, 30.0)


def test_steady_flight_banks_as_its_circle_needs(flight):
    """Slots farther out fly faster and bank more; the Rascal banks more than coordinated."""
    assert not flight.problem and not flight.note
    uav1, uav2, uav3 = flight.bank_deg
    assert uav1 < uav2 - 2.0 and uav2 == pytest.approx(uav3, abs=0.1)
    assert 30.0 < uav2 < 33.0


def test_steady_flight_copies_differ_by_the_change(flight):
    """Half a kick is half the response; that of the last follower moves no other."""
    still = flight.respond(Change())
    assert (flight.respond(Change()) == still).all()
    last = np.array([0.0, 0.0, 1.0])
    full, half = (flight.respond(Change(kick_deg=k * last)) - still for k in (1.0, 0.5))
    assert not full[..., :2].any() and np.degrees(np.abs(full[:, 0, 2]).max()) > 0.3
    assert half[:, :2] == pytest.approx(0.5 * full[:, :2], abs=0.05 * np.abs(full[:, :2]).max())


def test_steady_flight_gain_and_latency_act_on_roll(flight):
    """Neither moves anything without a kick; a latency of whole periods delays the response."""
    still = flight.respond(Change())
    for change in (Change(roll_gain=1.5), Change(roll_latency_s=0.05)):
        assert np.degrees(np.abs((flight.respond(change) - still)[:, :2]).max()) < 0.02
    kicked = [
        flight.respond(Change(kick_deg=1.0, roll_latency_s=late)) - still for late in (0.0, 0.2)
    ]
    begin = round(0.1 / flight.dt)  # until feedback moves the bank, the kick alone acts
    assert kicked[0][:begin] == pytest.approx(kicked[1][:begin], abs=5e-4)
    assert np.abs(kicked[0] - kicked[1])[:, 0].max() > math.radians(0.2)


def test_margins_are_where_the_damping_is_zero(scenario, flight):
    """At the margin the damping crosses zero: before it is positive, 10 % beyond it negative."""
    kicks = margins._Kicks(flight, scenario)
    only = np.array([True, False, False])
    found = margins._largest(3, (1.0, 6.0), 0.05, lambda x, of: kicks.dampings(x, 0.0, of & only))
    gain = found[0]
    assert 1.8 < gain < 6.0
    before, near, beyond = (
        kicks.dampings(factor * gain, 0.0, only)[0] for factor in (0.8, 1.0, 1.1)
    )
    assert before > 0.02 and before > near > 0.0 > beyond


def test_damping_of_a_limit_cycle_is_not_positive():
    """The fit alone says that it decays; a fast decay to rest is no limit cycle."""
    times = np.arange(0.0, 12.0, 0.04)
    cycle = np.clip(0.05 * np.exp(times), 0.0, 1.0) * np.sin(6.1 * times)
    decay = np.exp(-0.8 * times) * np.sin(5.0 * times)
    assert margins._damping(np.stack((cycle, cycle), axis=1), 0.04) <= 0.0
    assert margins._damping(np.stack((decay, decay), axis=1), 0.04) == pytest.approx(
        0.158, abs=1e-3
    )
    assert margins._damping(np.full((100, 2), np.nan), 0.04) == -1.0


def test_settling_is_that_of_the_displaced_formation(flight):
    """Five per cent of a displacement of √2 m are left; sooner it is more."""
    times = margins._settling(flight)
    long = Change(record_s=margins.LONG_RECORD_S)
    moved = Change(displacement_m=1.0, record_s=margins.LONG_RECORD_S)
    error = np.linalg.norm((flight.respond(moved) - flight.respond(long))[:, 2:], axis=1)
    assert error[0] == pytest.approx(math.sqrt(2.0), rel=0.02)
    for i, settled in enumerate((times / flight.dt).round().astype(int)):
        assert error[settled - 1, i] > 0.05 * math.sqrt(2.0) >= error[settled:, i].max()


def test_independent_groups_follow_the_graph():
    chain = load_scenario("simulation-3")
    assert [each.tolist() for each in independent_groups(chain)] == [[0], [1], [2]]
    gains = {"neighbour_gains": {"uav3": {"uav1": 1.0}}}
    fork = chain.model_copy(update={"formation": chain.formation.model_copy(update=gains)})
    assert [each.tolist() for each in independent_groups(fork)] == [[0, 1], [2]]
    own = load_scenario("own-law-repulsion")
    assert [each.tolist() for each in independent_groups(own)] == [[0], [1], [2]]


def test_margins_worse_of_both_directions():
    left = FollowerMargins("uav1", -29.0, margins.Oscillation(0.9, 0.2), 8.0, 2.0, None)
    right = FollowerMargins("uav1", 30.0, margins.Oscillation(1.4, 0.3), None, None, 0.1)
    turns = [Margins(30.0, (right,), "", ""), Margins(-30.0, (left,), "", "")]
    [worse] = worse_of(turns).followers
    assert (worse.bank_deg, worse.least_damped.damping) == (30.0, 0.2)
    assert (worse.settling_s, worse.roll_gain, worse.roll_latency_s) == (None, 2.0, 0.1)
    rings = worse_of([Margins(30.0, (), "not steady", ""), turns[1]])
    assert rings.followers == () and rings.problem == "clockwise: not steady"


def test_margins_required_are_measured_by_a_worker(scenario):
    """The same numbers as by hand, in one direction; what is not required is left out."""
    of = Constraint(bank_deg=30.0, damping=0.2, roll_gain=3.0)
    clockwise, _ = measurements([of])
    result = run_task(FlightTask(0, scenario, measure=clockwise))
    assert result.outcome == "completed", result.error
    assert set(result.metrics) == {"problem", "damping", "damping_at_roll_gain"}
    assert result.metrics["damping"] > result.metrics["damping_at_roll_gain"]


def test_margins_command_refuses(tmp_path):
    refuse_all("margins", tmp_path)


def test_margins_command_predicts(tmp_path):
    """A table, a figure of the poles, and all poles as JSON; a chain bears every message delay."""
    words = ("margins", "simulation-2", "--bank", "0", "--jobs", "1")
    done = call_command(
        *words, "--json", "m.json", "--plot", "p.svg", cwd=tmp_path, code=0, columns=80
    )
    assert "stable at every message delay" in done.stdout
    assert (tmp_path / "p.svg").stat().st_size > 1000
    [straight] = json.loads((tmp_path / "m.json").read_text())["predicted"]
    assert straight["message_delays"] == []
    for follower in straight["followers"]:
        oscillations = [mode for mode in follower["modes"] if mode["frequency_hz"] > 0.0]
        assert oscillations[0] == follower["least_damped"] and len(oscillations) > 3
        assert follower["commands"]["pitch"]["gain"] > 2.0  # 6 dB
