"""Laws of users: import, contract, errors with their line, and flights."""

import hashlib
import json
import os
import shutil
import sys
import textwrap

import numpy as np
import pytest
from cases import some
from commands import call_command
from snapshot import check_snapshot

import testbed
from testbed.core.errors import InputError
from testbed.core.records import Inbox, OwnState, VehicleState
from testbed.formation.barrier import SpeedBarrier, barrier_curve, logged_barriers, logged_curve
from testbed.formation.control_step import Hbh23Law
from testbed.golden.compare_runs import compare_runs
from testbed.logs.read import read_log
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.plan.user_code import check_law
from testbed.plan.world import build
from testbed.pool.flight_task import FlightTask, run_task
from testbed.reports import figures, read_run, run_page
from testbed.reports.html import render_page
from testbed.scenario import (
    ScenarioError,
    list_scenarios,
    load_scenario,
    set_duration,
)
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan

GOOD = """
    import numpy as np
    from testbed.law import FbwaCommand, UnicycleCommand

    STATE = {}

    class Straight:
        def __init__(self, config, *, roll=0.0, memory=0.0):
            self.config, self.roll, self.count = config, roll, 0

        def start(self, own):
            return np.zeros(len(own.airspeed))

        def step(self, now, own, inbox, memory):
            n, roll = len(own.airspeed), self.roll
            ones, zeros, ahead = np.ones(n), np.zeros((n, 3)), np.tile([1.0, 0, 0], (n, 1))
            BODY
            return FbwaCommand(np.zeros(n), np.full(n, roll), np.full(n, 0.3)), memory
"""


SHORT = ("scenario.duration_s=0.4", "scenario.windows={}", "scenario.published=null")


def write(folder, body="pass", *, text=GOOD, law="mine:Straight", more=""):
    """Write a scenario and a law whose step has this body; return the scenario's path."""
    (folder / "mine.py").write_text(textwrap.dedent(text).replace("BODY", body))
    path = folder / "mine.yaml"
    path.write_text(f"extends: simulation-3\ncontroller: {{law: '{law}'{more}}}\n")
    return path


def build_error(path, *overrides):
    with pytest.raises(InputError) as caught:
        build(load_scenario(path, overrides))
    return str(caught.value)


def test_law_file_beside_scenario_flies_with_a_note(tmp_path):
    path = write(tmp_path, more=", options: {roll: 0.1}")
    flown = testbed.run(set_duration(load_scenario(path), 4.0), write=False)
    assert flown.outcome == "completed"
    (note,) = (event for event in flown.metrics["events"] if event["level"] == "info")
    digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()[:12]
    assert note["text"] == f"the law Straight runs mine.py (SHA-256 {digest})"
    # independent of the current folder
    assert flown.scenario.controller.law == f"{tmp_path / 'mine.py'}:Straight"


def test_run_stores_its_law_and_is_repeated_to_the_bit(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "MAKERS", ())  # drawing takes seconds
    mine = tmp_path / "mine"
    mine.mkdir()
    path = write(mine, "roll = 0.01 * float(np.round(now))")
    source = (mine / "mine.py").read_bytes()
    changes = ("fleet.*.vehicle=jsbsim", "scenario.question=What is it?", *SHORT)
    testbed.run(path, changes, out=tmp_path / "first")
    shutil.rmtree(mine)  # only the run remains
    first = tmp_path / "first"
    assert (first / "mine.py").read_bytes() == source
    stored = (first / "scenario.resolved.yaml").read_text()
    assert "law: mine.py:Straight" in stored and str(tmp_path) not in stored
    testbed.run(first / "scenario.resolved.yaml", out=tmp_path / "again")
    logs = [read_log(tmp_path / run / "run.mcap") for run in ("first", "again")]
    found = compare_runs(*logs)
    assert found.same and not found.scenario
    assert logs[1].info.code == {"mine.py": source}
    # from elsewhere, the report still knows its page, and holds its law
    shutil.copy(first / "run.mcap", tmp_path / "alone.mcap")
    shutil.rmtree(first)
    data = read_run(tmp_path / "alone.mcap")
    assert data.scenario.scenario.question == "What is it?"
    text = render_page(run_page(data))
    assert "Save mine.py" in text and "class Straight:" in text


def test_compare_different_code_of_one_name_is_listed(tmp_path):
    logs = []
    for roll in ("0.0", "0.1"):
        (tmp_path / roll).mkdir()
        path = write(tmp_path / roll, f"roll = {roll}")
        testbed.run(path, SHORT, out=tmp_path / roll / "run")
        logs.append(read_log(tmp_path / roll / "run" / "run.mcap"))
    assert compare_runs(*logs).scenario == ("code mine.py differs",)


def test_law_import_writes_no_files(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = write(tmp_path)
    before = sorted(tmp_path.iterdir())
    build(load_scenario(path))
    assert sorted(tmp_path.iterdir()) == before
    assert sys.dont_write_bytecode is False


def install_editable(folder):
    """Make a folder on the path an editable installation, as pip does."""
    about = folder / "a_package_of_laws-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: a-package-of-laws\nVersion: 1.0\n"
    )
    url = {"url": folder.as_uri(), "dir_info": {"editable": True}}
    (about / "direct_url.json").write_text(json.dumps(url))


def test_law_only_scenario_folder_and_packages_run(tmp_path, monkeypatch):
    (tmp_path / "in_the_way.py").write_text("raise AssertionError('ran')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    (home := tmp_path / "scenarios").mkdir()
    for law in ("in_the_way:Law", "antigravity:Law", "in_the_way.deeper:Law", "os:system"):
        assert "no module" in build_error(write(home, law=law)), law
    monkeypatch.chdir(home)
    for law in ("../in_the_way.py:Law", f"{tmp_path}/in_the_way.py:Law"):
        text = build_error(write(home, law=law))
        assert "is not in the folder of the file that names it" in text and "mine.yaml:2" in text
    (home / "linked.py").symlink_to(tmp_path / "in_the_way.py")
    assert "is not in the folder of the file" in build_error(write(home, law="linked:Law"))
    (tmp_path / "mine.py").write_text((home / "mine.py").read_text())
    asked = load_scenario(write(home), [f"controller.law={tmp_path}/mine.py:Straight"])
    assert asked.controller.law == f"{tmp_path}/mine.py:Straight"
    assert "in_the_way" not in sys.modules and "antigravity" not in sys.modules


def test_law_is_not_confined(tmp_path):
    """It writes anywhere, starts programs and reads the environment: also in `validate`."""
    (home := tmp_path / "scenarios").mkdir()
    acts = (
        "import os, pathlib, subprocess\n"
        f"pathlib.Path('{tmp_path}/written').write_text(os.environ['HOME'])\n"
        f"subprocess.run(['touch', '{tmp_path}/touched'], check=True)\n"
    )
    path = write(home, text=acts + textwrap.dedent(GOOD))
    done = call_command("validate", path, cwd=tmp_path, code=0, columns=200)
    assert "the law Straight runs mine.py (SHA-256 " in done.stdout + done.stderr
    assert (tmp_path / "written").read_text() == os.environ["HOME"]
    assert (tmp_path / "touched").exists()


STUDY = """
study: {{schema: 1, name: s, scenario: simulation-3, seeds: 1, set: {{controller.law: "{law}"}}}}
"""


def test_study_runs_code_in_its_folder_only(tmp_path, monkeypatch):
    """Its settings are of a file, not of the caller: not even the current directory is allowed."""
    (home := tmp_path / "studies").mkdir()
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    for law in ("mine:Straight", f"{tmp_path}/mine.py:Straight"):
        (home / "s.yaml").write_text(STUDY.format(law=law))
        with pytest.raises(ScenarioError, match="is not in the folder of the file that names it"):
            check_plan(Plan(load_study(home / "s.yaml")))
    write(home)
    for law in ("mine:Straight", "mine.py:Straight", "studies/mine.py:Straight"):
        (home / "s.yaml").write_text(STUDY.format(law=law))
        plan = Plan(load_study(home / "s.yaml"))
        assert plan.scenario(plan[0]).controller.law == f"{home}/mine.py:Straight"


def test_law_of_an_installed_package(tmp_path, monkeypatch):
    write(tmp_path)
    (tmp_path / "mine.py").rename(tmp_path / "a_package_of_laws.py")
    monkeypatch.syspath_prepend(tmp_path)
    install_editable(tmp_path)
    world = build(load_scenario("simulation-3", ["controller.law=a_package_of_laws:Straight"]))
    assert type(world.formation.control.groups[0].law).__name__ == "Straight"
    assert not world.formation.built_control.builtin
    del sys.modules["a_package_of_laws"]


def test_law_files_of_one_name_in_two_folders(tmp_path):
    for name, roll in (("one", 0.1), ("two", 0.2)):
        (tmp_path / name).mkdir()
        write(tmp_path / name, f"roll = {roll}")
    rolls = [
        testbed.run(set_duration(load_scenario(tmp_path / name / "mine.yaml"), 1.0), write=False)
        for name in ("one", "two")
    ]
    assert all(flown.outcome == "completed" for flown in rolls)
    assert rolls[0].metrics["leader_bank_deg"] == rolls[1].metrics["leader_bank_deg"]
    names = (tmp_path / name / "mine.yaml" for name in ("one", "two"))
    one, two = (build(load_scenario(path)).formation.control.groups[0].law for path in names)
    assert type(one) is not type(two)


def test_law_missing_module_or_class_has_a_remedy(tmp_path):
    assert "no module 'nowhere' (write a nowhere.py beside the scenario" in build_error(
        write(tmp_path, law="nowhere:Straight")
    )
    error = build_error(write(tmp_path, law="mine:Curved"))
    assert "has no class 'Curved', and no function of this name under @testbed.kernel" in error
    assert error.endswith("(it has Straight)")
    with pytest.raises(InputError, match=r"there is no file .*gone\.py"):
        load_scenario(write(tmp_path, law="gone.py:Straight"))
    with pytest.raises(
        InputError, match=r"no law 'mine' \(write one of: hbh23, .*; or module:Class"
    ):
        load_scenario(write(tmp_path, law="mine"))


def test_law_syntax_error_names_the_file(tmp_path):
    assert "mine.py cannot be imported: " in build_error(write(tmp_path, text="class Straight\n"))


def test_law_unknown_option_is_refused(tmp_path):
    assert "unexpected keyword argument 'rolll'" in build_error(
        write(tmp_path, more=", options: {rolll: 1}")
    )


def test_law_missing_method_is_named(tmp_path):
    text = "class Straight:\n    def __init__(self, config): ...\n"
    assert "Straight has no method start" in build_error(write(tmp_path, text=text))


VIOLATIONS = (
    "return None, memory",
    "return memory",
    "return FbwaCommand(np.zeros(n + 1), np.zeros(n), np.zeros(n)), memory",
    "return FbwaCommand(np.zeros(n), np.array([0.0, np.nan, 0.0]), np.zeros(n)), memory",
    "own.position_ned[0] = 0.0",
    "inbox.stamp_s[0] = 0.0",
    "self.count += 1; roll = 0.001 * self.count",
    "memory += 1.0",
    "roll = float(own.position_ned[:, 0].mean()) * 1e-3",
    "roll = float(np.nan_to_num(inbox.velocity_ned[2, 0, 1])) * 1e-3",
    "return FbwaCommand(0.0, 0.0, 0.3), memory",
    "return FbwaCommand(np.zeros(n), roll * ones, np.array('fast')), memory",
    "return UnicycleCommand(20.0 * ones, zeros, 20.0 * ones, 0.5 + zeros, 0), memory",
    "return UnicycleCommand(22.0 * ones, zeros + [0.1, 0.0, 0.2], 22.0 * ones, ahead, 0), memory",
    "return UnicycleCommand(3.6 * own.airspeed, zeros, 22.0 * ones, ahead, 0), memory",
    "return UnicycleCommand(22.0 * ones, zeros, own.airspeed / 3.6, ahead, 0), memory",
    "roll = np.where(np.isnan(inbox.stamp_s[:, 0]), np.nan, 0.0)",
    "assert not np.isnan(inbox.stamp_s[:, 1:]).any()",
    "return FbwaCommand(np.zeros(n), np.full(n, 12.0), np.full(n, 0.3)), memory",
    # state on self that two calls at one time do not show
    "self.last = own.velocity_ned.copy()",
    "if now > STATE.get('now', -1) or now == 0: STATE['x'] = own.airspeed * 1e-3\n"
    "        STATE['now'] = now\n"
    "        return FbwaCommand(np.zeros(n), STATE['x'], np.full(n, 0.3)), memory",
    "return FbwaCommand(np.zeros(n), np.r_[0.0, own.euler[:-1, 0]], np.zeros(n)), memory",
    "roll = np.nan if (now - np.nan_to_num(inbox.stamp_s, nan=now) > 1).any() else 0.0",
    "1 / 0",
)


def test_contract_violations_are_refused(tmp_path):
    rows = []
    for body in VIOLATIONS:
        rows += [body, build_error(write(tmp_path, body)).replace(str(tmp_path), "."), ""]
    check_snapshot("law_violations", "\n".join(rows))


def test_law_exception_has_its_line(tmp_path):
    path = write(tmp_path, "raise RuntimeError('no idea')")
    line = (tmp_path / "mine.py").read_text().split("raise")[0].count("\n") + 1
    assert f"mine.py:{line}: the law raised RuntimeError: no idea" in build_error(path)


ENDINGS = ("SystemExit(0)", "GeneratorExit", "KeyboardInterrupt", "BaseException")
PLACES = {
    "import": "raise ENDING\n",
    "construction": GOOD.replace(
        "self.config, self.roll, self.count = config, roll, 0", "raise ENDING"
    ),
    "start": GOOD.replace("return np.zeros(len(own.airspeed))", "raise ENDING"),
    "step": GOOD.replace("BODY", "raise ENDING"),
    "flight": GOOD.replace("BODY", "if now > 0.3: raise ENDING"),
}


@pytest.mark.parametrize("place", PLACES)
def test_law_that_ends_the_program_is_an_error(place, tmp_path):
    """Only a real Ctrl-C ends a command; `sys.exit(0)` of a law is no success."""
    for ending in ENDINGS[: None if place in ("import", "flight") else 1]:
        path = write(tmp_path, text=textwrap.dedent(PLACES[place]).replace("ENDING", ending))
        command = ("run", path, "--duration", "1", "--quiet", "--out", ending)
        error = call_command(*command, cwd=tmp_path, code=2, columns=500).stderr
        assert f"the law raised {ending.partition('(')[0]}" in error, error
        assert "mine.py:" in error and error.startswith("error: ")


def test_sweep_law_error_is_failed_in_flight_only(tmp_path):
    for body, outcome in (("if now > 0.3: 1 / 0", "failed"), ("1 / 0", "invalid")):
        scenario = set_duration(load_scenario(write(tmp_path, body)), 1.0)
        result = run_task(FlightTask(0, scenario))
        assert result.outcome == outcome
        assert result.error.startswith(f"{outcome}: ") and "ZeroDivisionError" in result.error


def test_law_nan_in_flight_ends_the_run_with_its_time(tmp_path):
    path = write(tmp_path, "roll = np.nan if now > 2.0 else 0.0")
    with pytest.raises(InputError, match=r"roll for uav1 is not a finite number at 2\.04 s"):
        testbed.run(set_duration(load_scenario(path), 4.0), write=False)


def test_law_fbwa_command_with_unicycle_is_refused(tmp_path):
    error = build_error(write(tmp_path), "fleet.uav2.vehicle=unicycle")
    assert "Straight commands fly-by-wire A, which a unicycle cannot fly" in error
    assert "vehicle: jsbsim for uav2" in error


@pytest.mark.parametrize(
    "name", ["own-law-leader-follower", "own-law-integral", "own-law-repulsion"]
)
def test_example_laws_hold_the_formation(name):
    flown = testbed.run(set_duration(load_scenario(name), 25.0), write=False)
    assert flown.outcome == "completed"
    assert all(flown.metrics["joined_at_s"].values())


# Without ideal-own-speed-model: with f and g of its own the law's u is no speed, which the contract
# asks of commands. Other scenarios than these differ from them in no parameter of the law.
UNDER_CONTRACT = (
    [name for name in list_scenarios() if name != "ideal-own-speed-model"]
    if os.environ.get("TESTBED_LAWS")
    else some(
        [
            *("simulation-1", "simulation-2", "simulation-3", "simulation-3-improved", "vee-30"),
            *("experiment-1", "experiment-2", "experiment-3", "mixed-fleet", "ideal-figure-eight"),
            *(name for name in list_scenarios() if name.startswith("own-")),
        ],
        6,
    )
)


@pytest.mark.parametrize("name", UNDER_CONTRACT)
def test_contract_holds_for_every_scenario(name):
    page = load_scenario(name)
    built = build_control(resolve(page), page.controller, build_clock(page))
    for group in built.groups:
        # the built-in law has no object of its own in a run
        rows = group.rows
        law = group.law or Hbh23Law(built.controllers["law"][rows], built.neighbours[rows])
        check_law(law, group.config)


def test_law_with_unsynchronised_aircraft():
    page = load_scenario("own-law-integral", ["rates.synchronous=false"])
    world = build(page)
    assert len(world.formation.control.groups) > 1
    assert testbed.run(set_duration(page, 2.0), write=False).outcome == "completed"


def test_law_leader_timeout_is_a_warning_and_a_flag(tmp_path):
    path = write(tmp_path, "assert self.config.leader_timeout_s == 1.5")
    changes = ["network.transmitter_off_s.leader=[[1, 4]]", "controller.leader_timeout_s=1.5"]
    flown = testbed.run(set_duration(load_scenario(path, changes), 5.0), write=False)
    said = [(e["time_s"], e["source"]) for e in flown.metrics["events"] if e["level"] == "warning"]
    assert said == [(pytest.approx(2.48), name) for name in ("uav1", "uav2", "uav3")]
    assert flown.metrics["limiter_flags"]["uav1"]["by_kind"]["leader_timeout"] > 0


def test_law_exception_in_import_or_constructor(tmp_path):
    text = "import nothing_of_this_name\n"
    assert "mine.py:1: the law raised ModuleNotFoundError" in build_error(
        write(tmp_path, text=text)
    )
    text = "class Straight:\n    def __init__(self, config):\n        {}['gain']\n"
    text += "    def start(self, own): ...\n    def step(self, now, own, inbox, memory): ...\n"
    assert "mine.py:3: the law raised KeyError: 'gain'" in build_error(write(tmp_path, text=text))


def encounter(positions, now=10.0):
    """Return time, estimates and messages of four aircraft (4, 3) flying north at 22 m/s."""
    velocity = np.tile([22.0, 0.0, 0.0], (4, 1))
    zeros, speed = np.zeros((4, 3)), np.full(4, 22.0)
    truth = VehicleState(
        np.array(positions, dtype=float), velocity, zeros, zeros, zeros, speed, speed
    )
    # messages are 0.1 s old, in which the aircraft fly 2.2 m
    stamp = np.full((3, 4), now - 0.1)
    content = [np.tile(each, (3, 1, 1)) for each in (velocity, zeros, zeros, zeros)]
    position = np.tile(truth.position_ned - 0.1 * velocity, (3, 1, 1))
    more = np.zeros((3, 4)), np.zeros((3, 4), dtype=bool), np.zeros((3, 4, 0))
    inbox = Inbox(stamp, stamp.copy(), position, *content, *more)
    return now, OwnState(*(each[1:] for each in truth), np.zeros((3, 3))), inbox


def repulsion():
    (group,) = build(load_scenario("own-law-repulsion")).formation.control.groups
    return group.law


def step(law, inputs):
    now, own, inbox = inputs
    return law.step(now, own, inbox, law.start(own))


def same(ours, theirs):
    return all(one.tobytes() == two.tobytes() for one, two in zip(ours, theirs, strict=True))


FAR = [[0, 0, -100], [-11, 20, -100], [-11, -9, -100], [-30, 0, -100]]  # 14 m apart and more


def test_repulsion_beyond_radius_is_hbh23_to_the_bit():
    law = repulsion()
    ours, memory = step(law, encounter(FAR))
    theirs, remembered = step(law.hbh23, encounter(FAR))
    assert same(ours, theirs)
    assert same(memory, remembered)


def test_repulsion_within_radius_shifts_the_position():
    law = repulsion()
    places = [*FAR[:2], [-7, 17, -100], FAR[3]]  # uav1 and uav2: 4 m and 3 m, 5 m apart
    now, own, inbox = encounter(places)
    ours, _ = law.step(now, own, inbox, law.start(own))
    towards = np.array([0.8, -0.6, 0.0])  # from uav1 to uav2; 7 m inside the radius of 12 m
    shifted = own.position_ned.copy()
    shifted[0] += 5.0 * 7.0 * towards
    shifted[1] -= 5.0 * 7.0 * towards
    theirs, _ = step(law.hbh23, (now, own._replace(position_ned=shifted), inbox))
    for one, two in zip(ours, theirs, strict=True):
        assert one == pytest.approx(two, rel=1e-9, abs=1e-9)  # up to rounding
    plain, _ = step(law.hbh23, encounter(places))
    assert (ours.omega[:2] != plain.omega[:2]).any(axis=1).all()
    for one, two in zip(ours, plain, strict=True):
        assert np.array_equal(one[2], two[2])  # uav3 is beyond the radius


def test_repulsion_ignores_missing_and_old_messages():
    law = repulsion()
    now, own, inbox = encounter([*FAR[:2], [-7, 17, -100], FAR[3]])
    old = inbox.received_s.copy()
    old[0, 2], old[1, 1] = np.nan, now - 1.01 * law.config.neighbour_timeout_s
    missing = inbox.stamp_s.copy()
    missing[0, 2] = np.nan
    changed = now, own, inbox._replace(received_s=old, stamp_s=missing)
    assert same(step(law, changed)[0], step(law.hbh23, changed)[0])


def test_repulsion_prevents_a_collision_of_hbh23():
    page = load_scenario("own-law-repulsion")
    ours = testbed.run(set_duration(page, 12.0), write=False)
    assert ours.outcome == "completed"
    assert ours.metrics["min_separation_m"] > 6.0
    papers = ["controller.law=hbh23", "controller.options={}"]
    assert (
        testbed.run(set_duration(load_scenario(page.name, papers), 12.0), write=False).outcome
        == "lost"
    )
    through = load_scenario(page.name, [*papers, "limits.collision_m=null"])  # each other
    theirs = testbed.run(set_duration(through, 12.0), write=False)
    assert theirs.metrics["min_separation_between"] == ["uav1", "uav2"]
    assert theirs.metrics["min_separation_m"] < page.limits.collision_m


# functions μ and h

FUNCTIONS = """
    import numpy as np

    def mu(z):
        return (50.0 + z) ** -0.5

    def h(s, s_min, s_max):
        return np.tanh(0.05 * (s_max - s) * (s - s_min))

    def growing(z):
        return (1.0 + z) ** -0.3

    def flat(s, s_min, s_max):
        return np.tanh(0.5 * (s_max - s) * (s - s_min))

    def single(z):
        return 1.0

    def nan(z):
        return z / 0.0

    def failing(z):
        return z.shape[7]
"""
MU = "formation.control_function={{example: own, function: {}:{}}}"
H = "formation.barrier={{example: own, function: {}:{}}}"


def with_functions(folder, *overrides):
    """Load Simulation 3 with functions of a file; return the scenario."""
    folder.mkdir(exist_ok=True)
    (folder / "mine.py").write_text(textwrap.dedent(FUNCTIONS))
    path = folder / "mine.yaml"
    path.write_text("extends: simulation-3\n")
    return load_scenario(
        path, [*SHORT, *(each.replace("FILE", f"{folder}/mine.py") for each in overrides)]
    )


def test_own_functions_fly_as_the_examples(tmp_path):
    """Examples 1 and 5 written as own functions: the run is the same to 1 mm, and repeats."""
    own = (MU.format("FILE", "mu"), H.format("FILE", "h"), "scenario.duration_s=8")
    moves = []
    for changes in ((), own):
        scenario = with_functions(tmp_path / "mine", *changes, "scenario.duration_s=8")
        testbed.run(scenario, out=tmp_path / f"run{len(moves)}")
        log = read_log(tmp_path / f"run{len(moves)}" / "run.mcap")
        moves.append(log.truth.position_ned)
    np.testing.assert_allclose(moves[1], moves[0], atol=1e-3)
    assert not np.array_equal(*moves), "tables are not exact"
    notes = [event.text for event in log.events if event.source == "run"]
    assert [note[: note.index("(")] for note in notes] == [
        "the control function runs mine.py ",
        "the barrier runs mine.py ",
    ]
    assert list(log.info.code) == ["mine.py"] and log.info.barriers == ((0, 0.0),) * 3
    speeds = np.linspace(16.0, 30.0, 29)
    for own in logged_barriers(log.info):
        example = barrier_curve(SpeedBarrier(5, 0.05), speeds, 16.0, 30.0)[0]
        np.testing.assert_allclose(logged_curve(own, speeds, 16.0, 30.0), example, atol=2e-3)
    shutil.rmtree(tmp_path / "mine")  # only the run remains
    testbed.run(tmp_path / "run1" / "scenario.resolved.yaml", out=tmp_path / "again")
    assert compare_runs(read_log(tmp_path / "again" / "run.mcap"), log).same


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (MU.format("FILE", "growing"), r"formation.control_function: \(C2\) fails: for large"),
        (H.format("FILE", "flat"), r"formation.barrier: of uav1, \(B3\) fails: h' is"),
        (MU.format("FILE", "single"), r"single of an array of shape \(\d+,\) has shape \(\)"),
        (MU.format("FILE", "nan"), r"nan\(0\) is nan \(write a function that is finite"),
        (MU.format("FILE", "failing"), r"mine.py:\d+: the function raised IndexError"),
        (MU.format("FILE", "nu"), r"control_function: .*mine.py has no function 'nu' \(it"),
        (MU.format("nowhere", "mu"), r"formation.control_function: no module 'nowhere'"),
    ],
)  # fmt: skip
def test_own_function_error_has_key_and_remedy(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        build(with_functions(tmp_path, change))
