"""Laws of the library are files like a user's; what a law requires is checked before a flight."""

import re
from dataclasses import replace

import pytest
from cases import some
from commands import call_command

import testbed
from testbed.core.code_digest import code_digest
from testbed.core.errors import InputError
from testbed.plan.user_code import import_code
from testbed.plan.world import build
from testbed.scenario import LAWS, list_laws, load_scenario, set_duration

HEADER = "extends: simulation-3\nscenario: {name: mine, published: null}\n"
COMPILED = some(list_laws(), 1)
RULED = """
import testbed
from testbed.law import FbwaCommand


def requires(config, roll, turns):
    if roll > 0.5:
        raise ValueError(f"roll is {roll} for {', '.join(config.names)} (write 0.5 or less)")
    if roll < 0.0:
        raise KeyError("roll")


@testbed.kernel(requires=requires)
def ruled(now, own, inbox, memory, config, roll=0.1, turns=3):
    return FbwaCommand(0.0, roll, 0.4)
"""


def scenario(folder, controller, name="mine"):
    path = folder / f"{name}.yaml"
    path.write_text(f"{HEADER}controller: {controller}\n", encoding="utf-8")
    return path


def errors(*changes):
    with pytest.raises(InputError) as caught:
        build(load_scenario("simulation-3", changes))
    return str(caught.value)


@pytest.mark.parametrize("name", COMPILED)
def test_a_law_of_the_library_flies_like_its_copy(name, tmp_path):
    """A copy of the file beside the scenario is the same law, to the bit, by the same code."""
    function = name.replace("-", "_")
    file = LAWS / f"{function}.py"
    (tmp_path / "mine.py").write_bytes(file.read_bytes())
    ours = set_duration(load_scenario(scenario(tmp_path, f"{{law: {name}}}", "ours")), 8.0)
    copy = set_duration(load_scenario(scenario(tmp_path, f"{{law: 'mine:{function}'}}")), 8.0)
    flown = testbed.run(ours, out=tmp_path / "run")
    assert flown.outcome == "completed"
    assert flown.metrics["windows"] == testbed.run(copy, write=False).metrics["windows"]
    assert (tmp_path / "run" / file.name).read_bytes() == file.read_bytes()
    resolved = (tmp_path / "run" / "scenario.resolved.yaml").read_text("utf-8")
    assert f"law: {file.name}:{function}" in resolved
    again = testbed.run(load_scenario(tmp_path / "run" / "scenario.resolved.yaml"), write=False)
    assert again.metrics["windows"] == flown.metrics["windows"]


def test_a_wrong_name_names_the_nearest():
    known = ", ".join(("hbh23", *list_laws()))
    assert list_laws() == (
        "leader-follower",
        "mpc",
        "plane-follow",
        "track-pid",
        "virtual-structure",
    )
    error = errors("controller.law=trak-pid")
    assert f"no law 'trak-pid': did you mean 'track-pid'? (write one of: {known}; or" in error
    assert "did you mean 'track-pid'" in errors("controller.law=track_pid")
    assert "there is no law 'simulation-3' (write" in errors("controller.law=simulation-3")
    assert "there is no law '../laws/mpc' (write" in errors("controller.law=../laws/mpc")


@pytest.mark.parametrize(
    ("law", "options", "text"),
    [
        ("leader-follower", "{closing_per_s: 0.0}", "closing_per_s is 0 (write above 0"),
        ("leader-follower", "{closing_per_s: 25.0}", "closing_per_s is 25 (write above 0"),
        ("leader-follower", "{closing_limit_mps: -1}", "closing_limit_mps is -1 (write a speed"),
        ("virtual-structure", "{consensus_per_s: 12.5}", "below 12.5: 1/dt over the largest sum"),
        ("track-pid", "{cross_p: -0.1}", "cross_p is -0.1 (write 0 or more)"),
        ("track-pid", "{cross_i: 1}", "(write less than g cross_p cross_d, "),
        ("plane-follow", "{heading_p: 0}", "heading_p is 0 (write more)"),
        ("mpc", "{step_s: 0.02}", "step_s is 0.02 (write dt, 0.04, to 1 s)"),
        ("mpc", "{iterations: 0}", "iterations is 0 (write 1 to 200)"),
        ("mpc", "{limits_mps2: [1, 2]}", "limits_mps2 is (1.0, 2.0) (write three above 0)"),
        ("mpc", "{input_weight: 0}", "input_weight is 0 (write more than 0)"),
        ("mpc", "{slot_share: 2.0}", "slot_share is 2 (write 0 to 1)"),
    ],
)
def test_hypotheses_on_options_are_checked(law, options, text):
    error = errors(f"controller.law={law}", f"controller.options={options}")
    file = LAWS / f"{law.replace('-', '_')}.py"
    assert re.match(rf"{re.escape(str(file))}:\d+: {file.stem} requires: ", error)
    assert text in error


@pytest.mark.parametrize("law", ["leader-follower", "track-pid", "plane-follow", "mpc"])
def test_followers_have_a_gain_for_the_leader(law):
    """Simulation 1 has a follower that receives from others alone."""
    if law in COMPILED:
        scenario = load_scenario("simulation-3", [f"controller.law={law}"])
        assert not build(scenario).unused
    gains = "formation.leader_gains={uav1: 1, uav2: 1}"
    assert "uav3 has no gain for the leader (write one" in errors(f"controller.law={law}", gains)


def test_virtual_structure_needs_a_path_of_gains():
    check = import_code(str(LAWS / "virtual_structure.py"), "controller.law")[0].requires
    options = {"consensus_per_s": 1.0, "closing_per_s": 0.4, "closing_limit_mps": 3.0}
    first = "formation.leader_gains={uav1: 1}"  # uav3 from uav2, uav2 from uav1
    for changes in ([], [first]):
        built = build(load_scenario("simulation-3", changes)).formation.control
        check(built.groups[0].config, **options)
    gains = built.groups[0].config.gains.copy()
    gains[1, 1] = 0.0  # uav3 from uav2, and uav2 from nothing
    with pytest.raises(ValueError, match="no path from the leader to uav2 "):
        check(replace(built.groups[0].config, gains=gains), **options)


def test_a_law_of_ones_own_requires_the_same_way(tmp_path):
    """File, line and sentence; other exceptions of the check are errors of the code."""
    (tmp_path / "mine.py").write_text(RULED, encoding="utf-8")
    path = scenario(tmp_path, "{law: 'mine:ruled', options: {roll: 0.6}}")
    done = call_command("validate", path, cwd=tmp_path, code=2, columns=200)
    assert "mine.py:8: ruled requires: roll is 0.6 for uav1, uav2, uav3 (write" in done.stderr
    with pytest.raises(
        InputError, match=r"mine\.py:10: the hypotheses of the law ruled raised KeyE"
    ):
        build(load_scenario(path, ["controller.options={roll: -1}"]))


def test_a_case_of_a_study_is_refused_before_it_flies(tmp_path):
    scenario(tmp_path, "{law: leader-follower}")
    study = tmp_path / "laws.yaml"
    study.write_text(
        "study: {schema: 1, name: laws, scenario: mine.yaml, duration_s: 1,"
        " metrics: [min_separation_m]}\n"
        "cases:\n  one: {}\n  two: {controller.options: {closing_per_s: 25}}\n",
        encoding="utf-8",
    )
    done = call_command("sweep", study, "--out", "out", cwd=tmp_path, code=2, columns=200)
    assert "leader_follower requires: closing_per_s is 25" in done.stderr
    assert not list(tmp_path.glob("out/**/run.mcap"))


def test_hypotheses_are_of_all_followers_at_once(tmp_path):
    """Also where followers step at different times, each in a group of its own."""
    apart = ["rates.synchronous=false"]
    groups = build(load_scenario("simulation-3", apart)).formation.control.groups
    assert [len(group.rows) for group in groups] == [1, 1, 1]
    (tmp_path / "mine.py").write_text(RULED, encoding="utf-8")
    path = scenario(tmp_path, "{law: 'mine:ruled', options: {roll: 0.6}}")
    with pytest.raises(InputError, match=r"roll is 0\.6 for uav1, uav2, uav3 "):
        build(load_scenario(path, apart))


def test_checked_options_are_those_of_the_kernel(tmp_path):
    """A float where 1 is written, an integer where it is one, and options at their defaults."""
    types = "    assert (type(roll), type(turns)) == (float, int)\n"
    text = RULED.replace("    if roll > 0.5:", f"{types}    if roll > 0.5:")
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"roll is 1\.0 for"):
        build(load_scenario(scenario(tmp_path, "{law: 'mine:ruled', options: {roll: 1}}")))


def test_code_that_imports_a_law_has_its_digest():
    """Other code of the testbed counts by its name; the folder of machine code is of its text."""

    def digest(module, number):
        names = {"__name__": module}
        exec(f"def gain():\n    return {number}\n", names)
        return code_digest(names["gain"])

    assert digest("testbed.laws.mine", 1.0) != digest("testbed.laws.mine", 2.0)
    assert digest("testbed.core.mine", 1.0) == digest("testbed.core.mine", 2.0)
