"""What a companion computer runs needs neither JSBSim nor SciPy, and is what a run does."""

import json
import subprocess
import sys

import numpy as np
import pytest
import user_laws
from places import ROOT
from waiting import TIMEOUT_S

import testbed
from testbed.airframes.metrics import read_wingspan
from testbed.airframes.powerplant import AircraftError
from testbed.core.call_list import run_steps
from testbed.core.compile import prepare
from testbed.core.errors import InputError
from testbed.plan.world import build
from testbed.scenario import find_aircraft
from testbed.vehicle.jsbsim_adapter import airframe

PROGRAM = ROOT / "tests" / "shared" / "without_jsbsim.py"
NAMES = ("uav1", "uav2", "uav3")
# Writes the same state and messages as `given` does, and prints the commands of some steps; then
# it runs a command that flies.
STEPS = """
import json, sys
import testbed
from testbed.companion.follower_control import FollowerControl
given = json.loads(sys.argv[2])
of_laws = []
for law in sys.argv[3:]:
    scenario = testbed.load_scenario(sys.argv[1], [f"controller.law={law}"])
    control = FollowerControl(scenario, "uav2")
    for name, value in given["own"].items():
        control.own["estimate"][name] = value
    commands = []
    for now in given["times"]:
        for message in control.inbox:
            for name, value in given["message"].items():
                message[name] = value
            message["stamp_s"] = message["received_s"] = message["measured_s"] = now
            message["number"] += 1
        control.step(now)
        commands.append([float(each).hex() for each in control.own["control"]])
    of_laws.append(commands)
loaded = [name for name in ("jsbsim", "scipy") if name in sys.modules]
print(json.dumps([of_laws, loaded]), flush=True)
from testbed.cli.entry import main
sys.argv[1:] = ["trim", "rascal110", "--airspeed", "15"]
main()
"""
GIVEN = {
    "times": [0.0, 0.04, 0.08],
    "own": {
        "position_ned": [-40.0, 21.0, -103.0],
        "velocity_ned": [15.5, 1.0, -0.2],
        "acceleration_ned": [0.1, 0.2, 0.0],
        "euler": [0.05, 0.03, 0.06],
        "rates_body": [0.01, 0.0, 0.02],
        "airspeed": 15.6,
        "equivalent_airspeed": 15.2,
    },
    "message": {
        "position_ned": [0.0, 0.0, -100.0],
        "velocity_ned": [16.0, 0.0, 0.0],
        "acceleration_ned": [0.0, 0.5, 0.0],
        "euler": [0.1, 0.02, 0.0],
        "euler_rates": [0.0, 0.0, 0.03],
    },
}


def run_without(code, *arguments):
    return subprocess.run(
        (sys.executable, str(PROGRAM), code, *arguments),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        cwd=ROOT,
    )


def commands_of_run(law):
    """Steps of the control of a run, with the same states and messages."""
    scenario = testbed.load_scenario("simulation-3", [f"controller.law={law}"])
    world = build(scenario)
    prepare(world.entries)
    own, links = world.aircraft[2], world.links
    for name, value in GIVEN["own"].items():
        world.aircraft["estimate"][name][:] = value  # the others fly the same
    commands = []
    for now in GIVEN["times"]:
        for name, value in GIVEN["message"].items():
            links[name][:] = value
        links["stamp_s"] = links["received_s"] = links["measured_s"] = now
        links["number"] += 1
        run_steps(world.parts.control.steps(0), now)
        commands.append([float(each).hex() for each in own["control"]])
    return commands


@pytest.fixture(scope="module")
def aboard(tmp_path_factory):
    """A process without JSBSim, and the laws whose commands it prints."""
    # of the name by which other tests have it compiled
    own = tmp_path_factory.mktemp("aboard") / "law_filtered.py"
    own.write_text(user_laws.FILTERED, "utf-8")
    laws = "hbh23", f"{own}:filtered"
    return run_without(STEPS, "simulation-3", json.dumps(GIVEN), *laws), laws


def test_commands_are_those_of_a_run(aboard):
    """To the bit: of the paper's law, and of one in a file of a user's."""
    done, laws = aboard
    of_laws, loaded = json.loads(done.stdout)
    assert not loaded
    for law, commands in zip(laws, of_laws, strict=True):
        assert len({tuple(each) for each in commands}) == len(commands), law
        assert commands == commands_of_run(law), law


def test_a_command_that_flies_says_what_is_missing(aboard):
    done, _ = aboard
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "JSBSim is not installed" in line and "Linux on ARM" in line


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8"])
def test_wingspan_is_that_of_jsbsim(name):
    folder = find_aircraft(name)
    # JSBSim has a foot of 0.3048 m to nine digits
    assert read_wingspan(folder) == pytest.approx(airframe(folder).span, rel=1e-8)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<fdm_config><metrics></metrics></fdm_config>", "no wingspan"),
        ('<fdm_config><metrics><wingspan unit="M">-2</wingspan></metrics></fdm_config>', "no wing"),
        ("<fdm_config><metrics>", "is not XML"),
    ],
)
def test_a_file_without_wingspan_is_refused(text, reason, tmp_path):
    (tmp_path / f"{tmp_path.name}.xml").write_text(text, "utf-8")
    with pytest.raises(AircraftError, match=reason):
        read_wingspan(tmp_path)


def test_unknown_aircraft_is_refused():
    from testbed.companion.follower_control import FollowerControl

    with pytest.raises(InputError, match="--as uav9: no aircraft.*leader"):
        FollowerControl(testbed.load_scenario("simulation-3"), "uav9")


def test_inputs_differ_enough():
    """Each of the numbers that are given matters to the comparison."""
    assert all(np.any(np.asarray(each) != 0) for each in GIVEN["own"].values())
