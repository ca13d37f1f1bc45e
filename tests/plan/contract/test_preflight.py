"""Warnings before a flight: aircraft in one place, wind, windows, limits, published numbers."""

import json
import math
import re
import shutil

import pytest
import small_study
from places import TESTS
from run_flight import MINUTE, first_minute
from typer.testing import CliRunner

import testbed
from testbed.autopilot.parameters import read_params
from testbed.cli.main import app
from testbed.commissioning import replay_commands
from testbed.commissioning import speed_step as step_module
from testbed.commissioning.replay_commands import respond
from testbed.commissioning.speed_step import speed_step
from testbed.core.errors import InputError
from testbed.plan.world import build
from testbed.scenario import (
    ScenarioError,
    dump,
    find_aircraft,
    load_middle_loop,
    load_scenario,
    loads,
    set_duration,
)
from testbed.studies.sweep import sweep

MINIMAL = (TESTS / "data" / "scenarios" / "minimal.yaml").read_text()


# aircraft in one place


def test_two_slots_in_one_place_are_refused():
    with pytest.raises(ScenarioError) as caught:
        load_scenario("simulation-3", ["formation.offsets_m.uav3=[-5, 5.001, 0]"])
    (problem,) = caught.value.problems
    assert problem.path == ("formation", "offsets_m", "uav3")
    assert "puts the slot of uav3 in the same place as that of uav1" in problem.text


def test_virtual_leader_is_not_an_aircraft():
    path = "leader.path={kind: virtual, speed_mps: 22, curve: {kind: straight}}"
    changes = [path, "fleet.0.start_m=[0, 0, 0]", "formation.offsets_m.uav1=[0, 0, 0]"]
    assert loads(MINIMAL, changes).formation.offsets_m["uav1"] == (0.0, 0.0, 0.0)


def test_held_altitudes_separate_slots():
    same = ("formation.offsets_m.uav2=[-5, 5, 0]", "formation.offsets_m.uav3=[-5, -5, 4]")
    held = "formation.altitudes_m={uav1: 100, uav2: 110}"
    assert load_scenario("simulation-3", [*same, held]).formation.altitudes_m["uav2"] == 110.0
    with pytest.raises(ScenarioError, match="slot of uav2 in the same place as that of uav1"):
        load_scenario("simulation-3", [*same, "formation.altitudes_m={uav1: 100, uav2: 100}"])


# aircraft closer than a wingspan

CLOSE = ("fleet.1.start_m=[-25, 16.2, 0]", "formation.offsets_m.uav2=[-5, 7.5, 0]")


def warnings(name, *changes):
    return [(e.source, e.text) for e in build(load_scenario(name, changes)).initial_events]


def test_starts_below_a_wingspan_have_warnings():
    assert warnings("simulation-3-30deg", *CLOSE) == [
        (
            "run",
            "uav1 and uav2 start 1.20 m apart, closer than 2.8 m, a wingspan (write "
            "fleet.0.start_m and fleet.1.start_m farther apart, or limits.min_separation_m: 1.19 "
            "if that is intended)",
        ),
        (
            "run",
            "uav1 and uav2 have slots 2.50 m apart, closer than 2.8 m, a wingspan (write "
            "formation.offsets_m.uav1 and formation.offsets_m.uav2 farther apart, or "
            "limits.min_separation_m: 2.5 if that is intended)",
        ),
    ]
    assert warnings("simulation-3-30deg", *CLOSE, "limits.min_separation_m=1.19") == []
    (start, slot) = warnings("simulation-3", "limits.min_separation_m=9")[-2:]
    assert "limits.min_separation_m (write" in start[1] + slot[1]


def test_larger_wingspan_of_a_pair_counts():
    changes = ("fleet.1.start_m=[-25, 17.5, 0]",)  # 2.5 m: less than a Rascal's, not than an X8's
    assert "start 2.50 m apart, closer than 2.8 m" in str(warnings("simulation-3", *changes))
    smaller = (*changes, "fleet.0.aircraft=skywalker_x8", "fleet.1.aircraft=skywalker_x8")
    assert "start 2.50 m" not in str(warnings("simulation-3", *smaller))
    mixed = (*changes, "fleet.0.aircraft=skywalker_x8")
    assert "start 2.50 m apart, closer than 2.8 m" in str(warnings("simulation-3", *mixed))


def test_many_close_starts_have_one_warning():
    (start, slot) = warnings("vee-30", "limits.min_separation_m=20", "fleet.count=12")[-2:]
    assert "have slots 14.14 m apart" in slot[1] or "have slots 10.00 m apart" in slot[1]
    assert "other pairs are closer than that, too" in slot[1]
    assert "start" in start[1]


def run_command(tmp_path, *changes):
    """Exit code, output and metrics of five seconds of Simulation 3."""
    words = [
        "run",
        "simulation-3",
        "--duration",
        "5",
        "--json",
        "-",
        "--out",
        str(tmp_path / "out"),
    ]
    for change in ("log.mcap=false", "scenario.windows=null", "scenario.published=null", *changes):
        words += ["--set", change]
    done = CliRunner().invoke(app, words)
    return done.exit_code, done.stderr, json.loads(done.stdout)


def test_lost_separation_is_red_and_exit_code_1(tmp_path):
    code, text, metrics = run_command(tmp_path / "a", *CLOSE)
    assert (code, metrics["outcome"], metrics["simulated_s"]) == (1, "separation_lost", 5.0)
    assert "simulation-3 · separation lost ·" in text
    assert "limit exceeded uav1 and uav2 loss of separation at 0.0 s" in " ".join(text.split())
    errors = [e for e in metrics["events"] if e["level"] == "error"]
    assert [(e["time_s"], e["source"]) for e in errors] == [(0.0, "uav1")]
    assert errors[0]["text"] == "loss of separation: 1.2 m from uav2 (limit 2.8 m, a wingspan)"
    code, _, metrics = run_command(tmp_path / "b", *CLOSE, "limits.min_separation_m=0.5")
    assert (code, metrics["outcome"]) == (0, "completed")
    code, _, metrics = run_command(tmp_path / "c", *CLOSE, "limits.on_limit_exceeded=stop")
    assert (code, metrics["simulated_s"]) == (1, 0.0)


# wind and the speed bounds


def test_wind_bounds_the_airspeed_by_default():
    wind = "air.wind.speed_mps=8"
    assert load_scenario("simulation-3").controller.bounded_speed == "ground_speed"
    assert load_scenario("simulation-3", [wind]).controller.bounded_speed == "airspeed"
    assert load_scenario(
        "simulation-3", ["air.wind.file=gusty-wind.csv"]
    ).controller.bounded_speed == ("airspeed")
    paper = "controller.bounded_speed=ground_speed"
    assert load_scenario("simulation-3", [wind, paper]).controller.bounded_speed == "ground_speed"
    for name in ("experiment-1", "experiment-2", "experiment-3"):  # as the paper has it
        assert load_scenario(name).air.wind.speed_mps > 0.0
        assert load_scenario(name).controller.bounded_speed == "ground_speed"
    assert warnings("simulation-3", wind) == []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return warnings of a flight behind the first minute of a recorded leader, with changes."""
    minute = first_minute(tmp_path_factory.mktemp("recorded"))
    return lambda *changes: warnings("simulation-3-recorded-leader", *minute, *changes)


def test_recorded_leader_in_wind_has_a_warning(recorded):
    text = "a recorded flight repeats its ground track"
    for from_deg in (0, 90):
        wind = f"air.wind={{speed_mps: 5, from_deg: {from_deg}}}"
        assert any(text in found for _, found in recorded(wind))
    assert not any(text in found for _, found in recorded("air.wind.speed_mps=0"))


def test_wind_beyond_the_bounds_names_the_key():
    paper = "controller.bounded_speed=ground_speed"
    (strong,) = warnings("simulation-3", "air.wind.speed_mps=8", paper, "fleet.0.name=uav1")[:1]
    assert strong[1] == (
        "the slot may move at 11.07 to 33.68 m/s over the ground in this wind, beyond the speed "
        "bounds of 16 to 30 m/s, where no follower can hold it (write controller.bounded_speed: "
        "airspeed)"
    )
    (slight,) = warnings("simulation-3", "air.wind.speed_mps=1.5", paper)[:1]
    assert "but Assumption 1 with kappa = 3.6 requires 19.6 to 26.4" in slight[1]
    assert "(write controller.bounded_speed: airspeed, formation.kappa_mps: " in slight[1]


def test_strongest_wind_of_the_run_counts():
    paper = "controller.bounded_speed=ground_speed"
    wind = warnings("simulation-3", "air.wind.file=gusty-wind.csv", paper, *MINUTE)
    assert "in this wind" in wind[0][1]
    # a gust that lasts is a wind, and without a mean wind the paper's bounds apply
    front = [text for _, text in warnings("gust-front")]
    assert front and all(" m/s over the ground in this wind" in text for text in front)
    assert warnings("gust-front", "controller.bounded_speed=airspeed") == []


def test_airspeed_beyond_the_bounds_is_through_the_air():
    straight = "leader.path={kind: virtual, speed_mps: 25, curve: {kind: straight}}"
    found = warnings("simulation-3", straight, "air.wind={speed_mps: 8, from_deg: 90}")
    assert "the slot moves at 33.00 to 33.00 m/s through the air, but" in found[0][1]


# windows and studies


def test_windows_after_the_duration_are_named(tmp_path):
    words = ["run", "simulation-3", "--duration", "1", "--set", "log.mcap=false"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0
    assert " windows not reached rectangles (95 to 550 s), circles (650 to 1080 s)" in done.stdout
    second_half = "errors are those of the second half of the flight"
    assert second_half in " ".join(done.stdout.split())
    windows = "scenario.windows={rectangles: [0.5, 3], circles: [2, 3]}"
    done = CliRunner().invoke(app, [*words, "--set", windows, "--out", str(tmp_path / "cut")])
    text = " ".join(done.stdout.split())
    assert "windows cut short rectangles (0.5 to 3 s), not compared with published numbers" in text
    assert "windows not reached circles (2 to 3 s)" in text and second_half not in text
    with pytest.raises(ScenarioError, match=r"rectangles: ends at 550 s, after the run, which"):
        load_scenario("simulation-3", ["scenario.duration_s=60"])


STUDY = """
study:
  schema: 1
  name: calm-and-wind
  scenario: simulation-3
  duration_s: 1
  set: {scenario.published: null, controller.bounded_speed: ground_speed}
  design: factorial
  seeds: [1]
vary: {air.wind.speed_mps: [0, 6, 8]}
"""


def swept(tmp_path, monkeypatch, text):
    path = tmp_path / "study.yaml"
    path.write_text(text)
    workers, output = small_study.InThisProcess(), []
    monkeypatch.setattr("testbed.pool.flight_pool._open_workers", lambda *_: workers)
    result = sweep(path, tmp_path / "out.parquet", report=output.append)
    assert any(" 1 seed; " in line for line in output)
    return result, [line for line in output if line.startswith("warning")]


def test_study_reports_each_kind_of_warning_once(tmp_path, monkeypatch):
    _, output = swept(tmp_path, monkeypatch, STUDY)
    assert output[0].startswith("warning: the run ends at 1 s, before these windows begin")
    assert [line.partition(" m/s over")[0] for line in output[1:]] == [
        "warning: run 1: uav1: the slot may move at 13.29 to 31.22",
        "warning: run 1: run: uav2, uav3: the slot may move at 13.26 to 31.23",
    ]
    metrics = STUDY.replace("seeds: [1]", "seeds: [1]\n  metrics: [min_separation_m]")
    (tmp_path / "b").mkdir()
    _, output = swept(tmp_path / "b", monkeypatch, metrics.replace("[0, 6, 8]", "[0]"))
    assert output == []


# published numbers


def differs(*changes):
    return load_scenario("simulation-3", changes).scenario.published.differs


def test_settings_make_another_set_up():
    assert differs() == ()
    assert differs("network.delay_s=0.1", "fleet.*.sensors=gps-ins", "scenario.seed=7") == (
        "network.delay_s",
        "fleet.*.sensors",
    )
    assert differs("scenario.windows.circles=[650, 900]") == ("scenario.windows.circles",)
    # no other set-up: values that it has, and what decides no number of the paper
    assert differs("network.delay_s=0", "formation.k=3") == ()
    assert differs("scenario.seed=7", "log.mcap=false", "limits.min_separation_m=0") == ()
    assert differs("formation.k=2", "scenario.published.differs=[]") == ()
    again = loads(
        dump(load_scenario("simulation-3", ["formation.k=2"])), ["fleet.*.sensors=pixhawk"]
    )
    assert again.scenario.published.differs == ("formation.k", "fleet.*.sensors")
    assert set_duration(again, 600.0).scenario.published.differs == again.scenario.published.differs


def test_another_set_up_is_not_compared(tmp_path):
    words = ["run", "simulation-3", "--set", "rates.broadcast_hz=50", "--set", "log.mcap=false"]
    windows = "scenario.windows={rectangles: [0, 1], circles: [1, 2]}"
    words += ["--set", windows, "--duration", "2", "--out"]
    done = CliRunner().invoke(app, [*words, str(tmp_path / "a")])
    text = "another set-up, rates.broadcast_hz, scenario.windows"
    line = f"not compared with [HBH23] Table 1, Simulation 3: {text}"
    assert line in " ".join(done.stdout.split())
    assert "  ratio" not in done.stdout and "paper" not in done.stdout
    assert all(line.startswith((" ", "─")) for line in done.stdout.splitlines() if line)
    same = [*words, str(tmp_path / "b"), "--set", "scenario.published.differs=[]"]
    assert "  ratio" in CliRunner().invoke(app, same).stdout


OWN = """extends: simulation-3
scenario: {name: first, duration_s: 1, windows: {rectangles: [0, 1], circles: null}}
log: {mcap: false}
"""


def test_missing_column_of_published_is_explained(tmp_path):
    """Of a scenario of the user's, through several files; not where it removes them itself."""
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(OWN)
    second.write_text("extends: first.yaml\nscenario: {name: second}\n")

    def printed(path, *options):
        done = CliRunner().invoke(app, ["run", str(path), "--out", str(tmp_path / "run"), *options])
        shutil.rmtree(tmp_path / "run")
        return " ".join(done.stdout.split())

    why = "paper not compared with [HBH23] Table 1, Simulation 3: another name does not inherit"
    assert why in printed(second)
    assert "paper" not in printed(second, "--set", "scenario.published=null")
    first.write_text(first.read_text().replace("{name:", "{published: null, name:"))
    assert "paper" not in printed(second)


# limits of the autopilot and of its commands


def test_limits_that_undercut_each_other_have_warnings(tmp_path):
    tune = (find_aircraft("rascal110") / "autopilot.param").read_text()
    narrow = tmp_path / "narrow.param"
    narrow.write_text(tune.replace("ROLL_LIMIT_DEG 50", "ROLL_LIMIT_DEG 25"))
    assert warnings("simulation-3") == []
    found = warnings("simulation-3", f"fleet.*.tune={narrow}", f"leader.tune={narrow}")
    cut = "and the autopilot stops at 25°, ROLL_LIMIT_DEG of its tune: what is cut off is not"
    assert [(source, text.partition(" counted")[0]) for source, text in found[:2]] == [
        ("run", f"uav1, uav2, uav3: the middle loop commands up to 50° of roll, {cut}"),
        ("leader", f"its guidance commands up to 45° of roll, {cut}"),
    ]
    # the leader's bank is limited to 25°, too; a slot farther out needs more
    assert len(found) == 3
    assert "the slot of uav2 may need up to 26.1° of bank, beyond 25°" in found[2][1]
    assert "(write controller.gains.limits.roll_deg: 25, or a ROLL_LIMIT_DEG of 50)" in found[0][1]
    lower = ("controller.gains.limits={roll_deg: 25}", "leader.path.bank_limit_deg=23")
    both = (f"fleet.*.tune={narrow}", f"leader.tune={narrow}", *lower)
    assert not [text for _, text in warnings("simulation-3", *both) if "ROLL_LIMIT_DEG" in text]


def test_unusual_parameter_has_a_warning(tmp_path):
    tune = (find_aircraft("rascal110") / "autopilot.param").read_text()
    odd = tmp_path / "odd.param"
    odd.write_text(re.sub("PTCH_RATE_FF .*", "PTCH_RATE_FF 5", tune))
    found = warnings("simulation-3", f"fleet.uav2.tune={odd}")
    assert found == [("uav2", f"{odd}: PTCH_RATE_FF is 5; usual are 0 to 3")]


def test_tune_limit_out_of_reach_has_a_warning(tmp_path):
    tune = (find_aircraft("rascal110") / "autopilot.param").read_text()
    wide = tmp_path / "wide.param"
    wide.write_text(tune.replace("ROLL_LIMIT_DEG 50", "ROLL_LIMIT_DEG 60").replace("-20", "-30"))
    (found,) = warnings("simulation-3", f"fleet.uav2.tune={wide}")
    assert found == (
        "uav2",
        "the middle loop commands at most 50° of roll, and ROLL_LIMIT_DEG of its tune, 60°, is "
        "never reached (write controller.gains.limits.roll_deg: 60 to fly it, or a ROLL_LIMIT_DEG "
        "of 50)",
    )
    real = f"fleet.uav2.tune={wide}", "fleet.uav2.autopilot=ardupilot"
    limit, gyro = warnings("simulation-3", *real)
    assert limit == found
    assert gyro[1].startswith("uav2: SITL at rates.physics_hz 100 has a gyro filter of 2 Hz")
    ideal = load_scenario("simulation-3", [real[0], "fleet.uav2.vehicle=unicycle"])
    assert build(ideal, unused="list").initial_events == ()
    with pytest.raises(ScenarioError, match=r"fleet\.1\.tune: has no effect: uav2 is an ideal"):
        build(ideal)


CIRCLE = (
    "leader.path={{kind: virtual, speed_mps: {speed}, curve: {{kind: circle, radius_m: {radius}, "
    "climb_mps: {climb}}}}}"
)


def demands(*changes):
    """Warnings of slots that need more bank or climb than the followers' limits allow."""
    found = warnings("simulation-3", *MINUTE, *changes)
    return [(source, text) for source, text in found if "the limit by" in text]


def test_formula_beyond_the_limits_has_a_warning():
    # level at 22 m/s on 45 m: the slots υ = (−5, ∓5) are on √(50² + 5²) and √(40² + 5²) m
    outer = math.degrees(math.atan((22.0 / 45.0) ** 2 * math.hypot(50.0, 5.0) / 9.80665))
    path = CIRCLE.format(speed=22, radius=45, climb=0)
    ((source, text),) = demands(path)
    assert source == "run" and text == (
        f"uav2, uav3: the slot of uav2 needs up to {outer:.1f}° of bank, 60.0 s of it beyond "
        "50°, the limit by controller.gains.limits.roll_deg and ROLL_LIMIT_DEG: it cannot be held "
        "there (write a leader that turns wider, or higher limits)"
    )
    assert demands(path, "fleet.*.vehicle=unicycle") == []
    assert demands(CIRCLE.format(speed=22, radius=60, climb=0)) == []
    # asin(8 / 22) is 21.3°, and the slots on the wider circle climb less steeply
    steep = CIRCLE.format(speed=22, radius=120, climb=8)
    ((source, text),) = demands(steep)
    inner = math.degrees(math.atan(8.0 / math.sqrt(22.0**2 - 8.0**2) / (math.hypot(115, 5) / 120)))
    assert source == "run" and f"uav1, uav2, uav3: the slot of uav1 needs up to {inner:.1f}" in text
    assert "° of climb, 60.0 s of it beyond 20°, the limit by" in text
    assert "PTCH_LIM_MAX_DEG: it cannot be held there (write a leader with less climb" in text


def test_recording_beyond_the_limits_has_a_warning(recorded, tmp_path):
    (text,) = [text for _, text in recorded() if "the limit by" in text]
    assert "needs up to 55.9° of bank, 2.8 s of it beyond 50°" in text
    higher = tmp_path / "higher.param"
    tune = (find_aircraft("rascal110") / "autopilot.param").read_text()
    higher.write_text(tune.replace("ROLL_LIMIT_DEG 50", "ROLL_LIMIT_DEG 57"))
    raised = (f"fleet.*.tune={higher}", "controller.gains.limits={roll_deg: 57}")
    assert not [text for _, text in recorded(*raised) if "the limit by" in text]


def test_mission_beyond_the_limits_has_a_warning():
    # 22 m/s at 0.495 rad/s: the outer slot moves at 24.6 m/s
    ((source, text),) = demands("leader.path.bank_limit_deg=48")
    assert source == "run" and "the slot of uav2 may need up to 51.2° of bank, beyond 50°" in text
    assert "(write a lower leader.path.bank_limit_deg, or higher limits)" in text


# sensors and faults


def test_latency_that_is_rounded_has_a_warning():
    gps = "fleet.*.sensors={gps: {latency_s: 0.129}, estimator: {gps_delay_s: 0.12}}"
    (found,) = warnings("simulation-3", gps)
    assert found == (
        "run",
        "uav1, uav2, uav3: sensors.gps.latency_s: 0.129 s flies as 0.12 s, a whole number of "
        "periods of rates.autopilot_hz, 50 Hz (write 0.12 or 0.14, or another rate)",
    )
    assert warnings("simulation-3", gps, "fleet.*.sensors.gps.latency_s=0.14") == []
    (other,) = warnings(
        "simulation-3-pixhawk", "rates={physics_hz: 200, autopilot_hz: 40, control_hz: 20}"
    )[:1]
    assert "sensors.gps.latency_s: 0.12 s flies as 0.125 s" in other[1]


def test_fault_without_effect_explains_nothing(tmp_path):
    fault = "fleet.uav1.faults=[{kind: gps-lost, at_s: 0}]"
    code, _, metrics = run_command(tmp_path / "a", *CLOSE, fault)
    assert (code, metrics["outcome"]) == (1, "separation_lost")
    code, _, metrics = run_command(tmp_path / "b", *CLOSE, fault, "fleet.uav1.sensors=pixhawk")
    assert (code, metrics["outcome"]) == (0, "completed")


# rates too low for an aircraft


def test_rate_too_low_for_an_aircraft_is_warned_of():
    """The X8's propeller has -29.6 1/s, its roll -26.2 1/s; of the Rascal -9.3 1/s are fastest."""
    world = build(load_scenario("mixed-fleet", ["rates.physics_hz=50"]))
    (warning,) = (each for each in world.initial_events if "eigenvalue" in each.text)
    assert warning.level == "warning"
    assert warning.text == (
        "uav1, uav2: the propeller mode of skywalker_x8 at 22 m/s has the eigenvalue -29.6 1/s; "
        "its magnitude times the step of 1/50 s is 0.592, and above 0.5 flights are inaccurate "
        "(write rates.physics_hz: 100)"
    )


def test_rate_that_suits_all_aircraft_has_no_warning():
    world = build(load_scenario("mixed-fleet"))
    assert not [each for each in world.initial_events if "eigenvalue" in each.text]


def test_rate_at_which_an_aircraft_diverges_is_refused():
    with pytest.raises(InputError) as caught:
        build(load_scenario("mixed-fleet", ["rates.physics_hz=25", "rates.autopilot_hz=25"]))
    assert str(caught.value) == (
        "rates.physics_hz: uav1, uav2: the roll mode of skywalker_x8 at 22 m/s has the eigenvalue "
        "-26.2 1/s; its magnitude times the step of 1/25 s is 1.05, and from 1 on its integration "
        "diverges (write rates.physics_hz: 75)"
    )


def test_fixed_rates_of_commands_are_checked(tmp_path, monkeypatch):
    """`respond` and `step` choose their rate themselves; `testbed.Aircraft` has an argument."""
    x8 = find_aircraft("skywalker_x8")
    commands = tmp_path / "commands.csv"
    commands.write_text("t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd\n0,0.05,0,0.5\n0.1,0,0,0.5\n")
    monkeypatch.setattr(replay_commands, "BASE_RATE_HZ", 50)
    lines, param = [], x8 / "autopilot.param"
    respond(x8, commands, tmp_path / "out.csv", param=param, airspeed=22.0, warn=lines.append)
    (line,) = lines
    assert line.startswith("the propeller mode of skywalker_x8 at 22 m/s has the eigenvalue -29.6")
    assert line.endswith("(fly it in a scenario with rates.physics_hz: 100, or slower)")
    monkeypatch.setattr(step_module, "BASE_RATE_HZ", 25)
    gains, params = load_middle_loop(x8, "tuned"), read_params(param)
    with pytest.raises(InputError, match=r"roll mode .* from 1 on its integration diverges \(fly"):
        speed_step(x8, gains, params, airspeed=22.0, step=2.0)
    slow = testbed.Aircraft("skywalker_x8", airspeed_mps=22, physics_hz=50)
    slow.step(0.05, 0.0, 0.5)
    assert any("times the step of 1/50 s is 0.592" in each.text for each in slow.events)
    with pytest.raises(InputError, match="^physics_hz: is 75 .write a multiple of 50"):
        testbed.Aircraft("skywalker_x8", airspeed_mps=22, physics_hz=75)


# gains


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("formation.a=100", "formation.a has a gain of 100 1/s; .*it is 4, and above 0.5"),
        ("formation.c={per_speed_squared: 1}", "formation.c has a gain of 900 1/s"),
        ("formation.c=1000", "formation.c has a gain of 1000 1/s"),
        ("formation.speed_pole_per_s=60", "formation.speed_pole_per_s has a gain of 60 1/s"),
        ("formation.a=1e-5", "formation.a has a gain of 1e-05 1/s: too small to act"),
        ("formation.k=1e-5", "formation.k has a gain of 1e-05 m/s: too small to act"),
        ("formation.leader_gains.*=1e-9", "_gains has a gain of 1e-09: too small to act"),
        ("controller.gain_scale=50", "controller.gain_scale: 50 multiplies every gain"),
    ],
)
def test_gains_far_from_usable_are_warned_of(setting, text):
    found = [each for _, each in warnings("simulation-3", setting)]
    assert [each for each in found if re.search(text, each)]
