"""Files of schema 1: one error with the new name of every key."""

from pathlib import Path

import pytest

from testbed.scenario import ScenarioError, load_middle_loop, load_scenario, loads
from testbed.scenario.schema_1 import SCENARIO

FULL = Path(__file__).parents[1] / "data" / "scenarios" / "everything.yaml"
BASE = """\
scenario: {schema: 1, name: old, duration_s: 20, portions: {all: [0, 20]}}
leader:
  aircraft: rascal110
  path: {kind: virtual, speed_mps: 22, curve: {kind: straight}}
fleet: {pattern: vee, count: 3, aircraft: rascal110, vehicle: ideal, among: ahead}
controller: {law: paper, profile: paper}
"""
TOP = """\
extends: base.yaml
fleet:
  agents:
    uav2: {faults: [{kind: thrust-loss, at_s: 1, lasts_s: 2, left: 0.5}]}
controller:
  silence: {after_s: 2, then: loiter}
  staleness: {then: hold}
limits: {when_lost: fly-on}
"""
LISTED = """\
top.yaml:4:50: fleet.agents.uav2.faults.0.lasts_s: has another name in schema 2 (write duration_s)
top.yaml:4:62: fleet.agents.uav2.faults.0.left: has another name in schema 2 (write remaining)
top.yaml:6:13: controller.silence.after_s: has another name in schema 2 (write \
controller.leader_timeout_s)
top.yaml:6:25: controller.silence.then: has another name in schema 2 (write \
controller.on_leader_timeout)
top.yaml:7:15: controller.staleness.then: has another name in schema 2 (write \
controller.on_neighbour_timeout: hold-relative-position)
top.yaml:8:10: limits.when_lost: has another name in schema 2 (write on_loss: continue)
base.yaml:1:20: scenario.schema: is 1, and schema 2 is read (write 2, and the new names of the \
keys listed here)
base.yaml:1:50: scenario.portions: has another name in schema 2 (write windows)
base.yaml:5:63: fleet.vehicle: is 'ideal', which is unicycle in schema 2 (write unicycle)
base.yaml:5:70: fleet.among: has another name in schema 2 (write neighbours_from)
base.yaml:6:19: controller.law: is 'paper', which is hbh23 in schema 2 (write hbh23)
base.yaml:6:35: controller.profile: is 'paper', which is tuned in schema 2 (write tuned)"""


def refusal(call, *arguments):
    with pytest.raises(ScenarioError) as caught:
        call(*arguments)
    return str(caught.value)


def test_schema_1_lists_every_key_of_every_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("base.yaml").write_text(BASE)
    Path("top.yaml").write_text(TOP)
    assert refusal(load_scenario, "top.yaml") == LISTED


@pytest.mark.parametrize("setting", ["network.hears=all", "fleet.*.faults.0.lasts_s=3"])
def test_setting_of_schema_1_names_new_key(setting):
    key = setting.partition("=")[0]
    text = refusal(load_scenario, "simulation-3", [setting])
    assert text.startswith(f"--set {setting}: {key}: has another name in schema 2 (write ")


def test_section_of_schema_1_without_keys_is_named():
    text = refusal(load_scenario, "simulation-3", ["controller.silence=null"])
    assert "(write controller.leader_timeout_s, on_leader_timeout and loiter_bank_deg)" in text


def test_profile_paper_of_ones_own_file_is_no_schema_1(tmp_path):
    own = tmp_path / "gains.yaml"
    own.write_text("paper: {course: {p: 1}}\n")
    settings = ["controller.profile=paper", f"controller.middle_loop={own}"]
    text = refusal(load_scenario, "simulation-3", settings)
    assert "schema" not in text and "paper.speed: is missing" in text


def test_middle_loop_of_schema_1_names_new_key(tmp_path):
    home = tmp_path / "glider"
    home.mkdir()
    (home / "glider.xml").write_text("<fdm_config/>")
    (home / "middle_loop.yaml").write_text("mine:\n  estimators: {turn_acceleration: none}\n")
    text = refusal(load_middle_loop, home, "mine")
    assert "middle_loop.yaml:2:16: mine.estimators.turn_acceleration: has another name" in text


def test_schema_2_has_no_key_of_schema_1():
    load_scenario(FULL, ["leader.battery=null"])
    names = {row.old.rpartition(".")[2] for row in SCENARIO if row.new}
    assert not names & {line.strip().partition(":")[0] for line in FULL.read_text().splitlines()}


def test_text_without_schema_is_read_as_schema_2():
    assert loads("extends: simulation-3\nrates: {log_hz: 10}\n").rates.log_hz == 10
