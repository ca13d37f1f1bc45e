"""Option values far outside their range: one error line, exit code 2, no traceback."""

import subprocess
import sys

import pytest
from cases import some
from commands import call_command, environment, refuse_all
from waiting import TIMEOUT_S

from testbed.core.errors import InputError
from testbed.scenario import load_scenario, set_duration

RUN = ("run", "simulation-3", "--quiet")
# Arguments and a part of the error.
EXTREME = (
    (["check", f"--seeds={'9' * 400}"], ": write a number of at most 1,000,000"),
    ([*RUN, "--set=scenario.name=\udcff\udcfe"], "is not UTF-8 text"),
    ([*RUN, "--set=\udcff=1"], "is not UTF-8 text"),
    (["run", "\udcff"], "udcff"),
)


def test_extreme_option_is_one_error_line(tmp_path):
    refuse_all("extreme", tmp_path)
    for arguments, error in EXTREME:
        done = call_command(*arguments, cwd=tmp_path, code=2, columns=500)
        assert error in done.stderr
        assert done.stderr.count("\n") == 1 and done.stdout == ""
        assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("rate", [1, 2, 4, 5, 8])
def test_autopilot_rate_too_low_for_its_filter(rate, tmp_path):
    setting = f"--set=rates={{physics_hz: 200, autopilot_hz: {rate}}}"
    for command in ("validate", "run"):
        done = call_command(command, "simulation-3", setting, cwd=tmp_path, code=2, columns=500)
        assert f"rates.autopilot_hz: is {rate}, and fly-by-wire A" in done.stderr
        assert done.stderr.count("\n") == 1
    load_scenario("ideal-figure-eight", ["rates={autopilot_hz: 5, control_hz: 5, broadcast_hz: 5}"])


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 86401.0, float("nan"), float("inf")])
def test_set_duration_out_of_range_is_refused(duration_s):
    with pytest.raises(InputError, match="duration_s: is .* \\(write "):
        set_duration(load_scenario("simulation-3"), duration_s)


def in_removed_directory(arguments, folder):
    """Exit code and standard error of a command in a directory that has been removed."""
    folder.mkdir()
    script = ("sh", "-c", 'rmdir "$PWD" && exec "$@"', "sh")
    done = subprocess.run(
        [*script, sys.executable, "-m", "testbed", *arguments],
        cwd=folder, env=environment(80), capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    return done.returncode, done.stderr


def test_removed_directory_is_one_error_line(tmp_path):
    """Before any command begins."""
    for arguments in some((["run", "simulation-3"], ["list"], ["recover", "run"]), 1):
        assert in_removed_directory(arguments, tmp_path / "removed") == (
            2,
            "error: the current directory cannot be used: No such file or directory; change to "
            "another\n",
        ), arguments


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_removed_directory_still_prints_help(tmp_path, option):
    assert in_removed_directory([option], tmp_path / "removed") == (0, "")
