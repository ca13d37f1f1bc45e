"""Shell completion: commands, options, and names of what there is."""

import pytest
from commands import run_command
from typer.testing import CliRunner
from written_runs import make_run

from testbed.cli.main import app
from testbed.cli.options import scenario_keys


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("prun", {"prune"}),
        ("run simulation-3-p", {"simulation-3-pixhawk"}),
        ("check simulation-1", {"simulation-1"}),
        ("run simulation-3 --dur", {"--duration"}),
        ("run simulation-3 --set network.delay", {"network.delay_s"}),
        ("trim ras", {"rascal110"}),
        ("sweep radio", {"radio-and-wind"}),
        ("tune x8", {"x8-middle-loop"}),
        ("view nea", {"near"}),
        ("report near/2026", {"near/20260629T000000Z-0001"}),
        ("run no-such", set()),
        ("run simulation-3 --follow ua", {"uav1", "uav2", "uav3"}),
        ("run no-such --follow ua", set()),
    ],
)
def test_shell_completes_names(tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    make_run(tmp_path / "logs", "near", 1)
    environment = {
        "_TESTBED_COMPLETE": "complete_bash",
        "COMP_WORDS": f"testbed {words}",
        "COMP_CWORD": str(len(words.split())),
    }
    done = CliRunner().invoke(app, prog_name="testbed", env=environment)
    assert set(done.output.split()) == expected


def test_keys_of_lists_have_an_asterisk():
    keys = scenario_keys("")
    assert {"fleet.*.sensors", "scenario.seed", "air.wind.speed_mps", "network.loss"} <= set(keys)
    assert scenario_keys("fleet.*.sen")[0] == "fleet.*.sensors"


def test_completion_script_can_be_shown(tmp_path, monkeypatch):
    monkeypatch.setenv("_TESTBED_COMPLETE", "source_bash")
    done = CliRunner().invoke(app, prog_name="testbed")
    assert "complete -o default -F _testbed_completion testbed" in done.output
    monkeypatch.delenv("_TESTBED_COMPLETE")
    assert "--show-completion" in run_command("--help", cwd=tmp_path, code=0, columns=80).stdout
