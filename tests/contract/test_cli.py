"""The command line: what it prints, what it leaves, and its exit codes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import call_command, environment, run_command
from patience import PATIENCE_S, until
from run_flight import DIVE
from typer.testing import CliRunner

import testbed
from testbed.cli import app
from testbed.record.read import read_log

ROOT = Path(__file__).parents[2]
ENV = environment(120)
BAD_INPUT, LOST, INTERRUPTED = 2, 1, 130
FLY = ("run", "simulation-3", "--duration", "2")
NO_LOG = ("--set", "log.mcap=false")


def cli(*arguments, cwd, code=0):
    return call_command(*arguments, cwd=cwd, code=code, columns=120)


def cli_process(*arguments, cwd, code=0):
    return run_command(*arguments, cwd=cwd, code=code, columns=120)


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_version(tmp_path):
    assert cli_process("--version", cwd=tmp_path).stdout == f"testbed {testbed.__version__}\n"


def test_help_names_every_command_and_the_exit_codes(tmp_path):
    text = cli("--help", cwd=tmp_path).stdout
    named = (
        "run view air validate check list schema respond import trim linearize step export compare "
        "sweep study-report tune"
    )
    for command in named.split():
        assert f"{command} " in text
        assert "--help" in cli(command, "--help", cwd=tmp_path).stdout
    assert "130 interrupted" in text


@pytest.mark.parametrize(
    ("command", "default"),
    [
        ("run", "[default: logs/SCENARIO/UTC-ID]"),
        ("check", "[default: 4 of the table's; 16 for a new table]"),
        ("check", "[default: one per processor]"),
        ("check", "[default: all that have a golden table]"),
        ("respond", "[default: the first row's, or 100]"),
        ("step", "[default: the profile's trim]"),
        ("import", "[default: the only one]"),
        ("export", "[default: run.FORMAT beside the log]"),
    ],
)
def test_help_tells_defaults_that_are_found_out_later(command, default):
    wide = {"TERMINAL_WIDTH": "200", "COLUMNS": "200", "NO_COLOR": "1"}
    done = CliRunner().invoke(app, [command, "--help"], env=wide)
    assert default in done.stdout
    assert "\\" not in done.stdout


def test_help_loads_nothing_heavy(tmp_path):
    code = (
        "import json, sys; from testbed.cli import app; app(['--help'], standalone_mode=False);"
        "print(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=ENV, capture_output=True, text=True
    )
    loaded = set(json.loads(done.stderr.splitlines()[-1]))
    assert "testbed.cli" in loaded
    assert not loaded & {"jsbsim", "numba", "rerun", "numpy", "scipy", "yaml", "mcap", "pydantic"}
    assert not any(name.startswith("pymavlink") for name in loaded)
    # what typer imports for those who write Markdown or want pretty tracebacks
    assert not loaded & {"rich.markdown", "markdown_it", "rich.traceback", "pygments", "attr"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("list",),
        ("schema",),
        ("validate", "simulation-3"),
        ("trim", "rascal110", "--airspeed", "22"),
        ("linearize", "rascal110", "--airspeed", "22"),
        ("step", "rascal110"),
    ],
    ids=" ".join,
)
def test_a_command_alone_in_its_process_says_the_same(tmp_path, arguments):
    """Whatever the others have imported before it."""
    ours, its = (each(*arguments, cwd=tmp_path) for each in (cli, cli_process))
    assert (ours.stdout, ours.stderr) == (its.stdout, its.stderr)
    assert its.stdout


def test_list_names_scenarios_and_aircraft(tmp_path):
    text = cli("list", cwd=tmp_path).stdout
    assert "simulation-3" in text
    assert "simulation-3-hard" in text
    assert "rascal110" in text


def test_schema_is_json(tmp_path):
    document = json.loads(cli("schema", cwd=tmp_path).stdout)
    assert {"scenario", "leader", "fleet", "formation"} <= set(document["properties"])


def test_validate_accepts_and_prints_the_resolved_page(tmp_path):
    assert cli("validate", "simulation-3", cwd=tmp_path).stdout == "simulation-3: good\n"
    changed = ("--set", "network.delay_s=0.25", "--resolved")
    page = cli("validate", "simulation-3", *changed, cwd=tmp_path).stdout
    (tmp_path / "resolved.yaml").write_text(page)
    assert "delay_s: 0.25" in page
    again = cli("validate", "resolved.yaml", "--resolved", cwd=tmp_path).stdout
    assert again == page
    assert files(tmp_path) == {"resolved.yaml"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration_s: 1080": "duration: 1080"}, "scenarios/mine.yaml:{line}:"),
        ({"profile: paper": "profile: papre"}, "papre"),
        ({"leader_gains: {uav1: 1, uav2: 1, uav3: 1}": "leader_gains: {}"}, "A + B is singular"),
    ],
    ids=["page", "aircraft's file", "world"],
)
def test_validate_says_where_and_what(tmp_path, changes, message):
    text = (ROOT / "scenarios" / "simulation-3.yaml").read_text()
    for old, new in changes.items():
        assert old in text
        line = text[: text.index(old)].count("\n") + 1
        text = text.replace(old, new)
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "mine.yaml").write_text(text)
    for command in ("validate", "run"):
        done = cli(command, "scenarios/mine.yaml", cwd=tmp_path, code=BAD_INPUT)
        assert done.stdout == ""
        assert done.stderr.startswith("error: ")
        assert message.format(line=line) in done.stderr
    assert files(tmp_path) == {"scenarios/mine.yaml"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("run",),
        ("run", "no-such-scenario"),
        ("run", "simulation-3", "--no-such-option"),
        ("run", "simulation-3", "--set", "formation.kk=3"),
        ("run", "simulation-3", "--set", "formation.k"),
        ("run", "simulation-3", "--duration", "0"),
        ("run", "simulation-3", "--duration", "nan"),
        ("run", "simulation-3", "--seed", "x"),
        ("run", "simulation-3", "--json", "missing/m.json"),
        ("run", "simulation-3", "--out", "occupied"),
        ("view", "no-such-run"),
        ("respond", "no-such-aircraft", "a.csv", "b.csv"),
        ("respond", "rascal110", "missing.csv", "b.csv"),
        ("no-such-command",),
    ],
    ids=" ".join,
)
def test_bad_input_is_2_and_leaves_nothing(tmp_path, arguments):
    (tmp_path / "occupied").mkdir()
    (tmp_path / "occupied" / "mine.txt").write_text("mine")
    done = cli(*arguments, cwd=tmp_path, code=BAD_INPUT)
    assert done.stderr
    assert files(tmp_path) == {"occupied/mine.txt"}


def test_a_run_leaves_one_directory_and_nothing_else(tmp_path):
    done = cli_process(*FLY, cwd=tmp_path)
    found = files(tmp_path)
    assert {Path(name).name for name in found} == {
        "run.mcap",
        "scenario.resolved.yaml",
        "metrics.json",
    }
    assert len(found) == 3
    (directory,) = {Path(name).parent for name in found}
    assert directory.parent.as_posix() == "logs/simulation-3"
    # the table, and where the log is; no escape codes in a pipe
    assert "smallest separation" in done.stdout
    assert directory.as_posix() in done.stdout
    assert "\x1b" not in done.stdout + done.stderr
    assert done.stderr == ""


def test_quiet_prints_nothing_and_json_is_the_same_document(tmp_path):
    done = cli(*FLY, "-q", "--seed", "7", "--json", "m.json", "--out", "here", cwd=tmp_path)
    assert done.stdout == done.stderr == ""
    ours = (tmp_path / "m.json").read_text()
    assert ours == (tmp_path / "here" / "metrics.json").read_text()
    metrics = json.loads(ours)
    assert metrics["seed"] == 7
    assert metrics["simulated_s"] == 2.0
    assert metrics["outcome"] == "flown"
    assert files(tmp_path) == {
        "m.json",
        *(f"here/{name}" for name in ("run.mcap", "scenario.resolved.yaml", "metrics.json")),
    }


def test_json_to_stdout_is_json_alone(tmp_path):
    (tmp_path / "empty").mkdir()
    done = cli(*FLY, *NO_LOG, "--json", "-", "--out", "empty", cwd=tmp_path)
    metrics = json.loads(done.stdout)
    assert metrics == json.loads((tmp_path / "empty" / "metrics.json").read_text())
    assert "smallest separation" in done.stderr
    assert files(tmp_path) == {"empty/metrics.json", "empty/scenario.resolved.yaml"}


def test_a_reader_of_the_table_who_leaves_is_not_an_aircraft_that_was_lost(tmp_path):
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "testbed", "run", "simulation-3", "--duration=1", "--out=run"],
            cwd=tmp_path,
            env=ENV,
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
        )
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["outcome"] == "flown"


def test_settings_reach_the_flight(tmp_path):
    settings = ("--set", "formation.k=2", "--set", "fleet.*.sensors=gps-ins")
    cli(*FLY, *NO_LOG, *settings, "-q", "--out", "run", cwd=tmp_path)
    page = (tmp_path / "run" / "scenario.resolved.yaml").read_text()
    assert "k: 2" in page
    assert page.count("sigma_m: 0.3") == 3


def test_a_lost_aircraft_is_1(tmp_path):
    (tmp_path / "dive.yaml").write_text(DIVE)
    done = cli("run", "dive.yaml", "--out", "run", cwd=tmp_path, code=LOST)
    assert "uav1: lost" in done.stdout
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["outcome"] == "lost"
    log = read_log(tmp_path / "run" / "run.mcap")
    assert log.finished
    assert [event.source for event in log.events] == ["uav1"]


def test_ctrl_c_is_130_with_a_readable_log_and_the_metrics_so_far(tmp_path):
    out = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", "simulation-3", "--out", str(out)],
        cwd=tmp_path,
        env=ENV,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        log = out / "run.mcap"
        # the header is some kilobytes; more than that is frames
        until(lambda: process.poll() is not None or log.is_file() and log.stat().st_size > 100_000)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == INTERRUPTED
    assert "Traceback" not in errors
    assert "interrupted" in printed
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["outcome"] == "interrupted"
    assert 0.0 < metrics["simulated_s"] < 1080.0
    contents = read_log(log)
    assert contents.finished
    assert contents.lost_bytes == 0
    assert contents.time_s[-1] == metrics["simulated_s"]
