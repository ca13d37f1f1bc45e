"""The command line: its help, what it prints, the files it writes, and its exit codes."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from unittest.mock import Mock

import golden_scenarios
import pytest
import typer
from cases import in_full, some
from commands import call_command, environment, refuse_all, run_command
from forked import Forked
from fresh import run_fresh
from places import ROOT
from snapshot import check_snapshot
from typer.testing import CliRunner
from waiting import TIMEOUT_S

import testbed
from testbed.cli import entry
from testbed.cli.exit_codes import ExitCode
from testbed.cli.main import app
from testbed.cli.scenario import FIRST, FIRST_STUDIES, GROUPS, STUDIES, TUNES
from testbed.logs.file_record import RECORD_NAME
from testbed.scenario import (
    list_laws,
    list_scenarios,
    list_studies,
    list_tunings,
    load_scenario,
)

ENV = environment(120)
COMMANDS = tuple(typer.main.get_command(app).commands)
FLY = ("run", "simulation-3", "--duration", "2")
NO_LOG = ("--set", "log.mcap=false")


def cli(*arguments, cwd, code=0, columns=120):
    return call_command(*arguments, cwd=cwd, code=code, columns=columns)


def cli_process(*arguments, cwd, code=0):
    return run_command(*arguments, cwd=cwd, code=code, columns=120)


def help_text(*command, columns):
    environment = {"COLUMNS": str(columns), "NO_COLOR": "1"}
    done = CliRunner().invoke(app, [*command, "--help"], env=environment)
    assert done.exit_code == 0
    return done.stdout


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_version_is_printed(tmp_path):
    assert cli_process("--version", cwd=tmp_path).stdout == f"testbed {testbed.__version__}\n"


def test_help_lists_commands_and_exit_codes():
    text = help_text(columns=120)
    assert {"run", "view", "air", "validate", "list", "import", "sweep"} < set(COMMANDS)
    assert all(f"│ {command} " in text for command in COMMANDS)
    assert all(f"{code.value} " in text for code in ExitCode)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_fits_80_columns(command):
    text = help_text(command, columns=80)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text and "\\" not in text


def test_command_reference_is_as_reviewed():
    """Every option with its default and its help, as the documentation prints them."""
    spec = spec_from_file_location("reference", ROOT / "website" / "commands.py")
    reference = module_from_spec(spec)
    spec.loader.exec_module(reference)
    check_snapshot("command_reference", reference.markdown())


ALONE = (
    *("list", "schema", "validate simulation-3", "trim rascal110 --airspeed 22"),
    *("linearize rascal110 --airspeed 22", "step rascal110"),
)


@pytest.mark.parametrize("words", some(ALONE, 3))
def test_command_alone_in_a_process_prints_the_same(tmp_path, words):
    """A command imports all it needs, whatever was imported before."""
    arguments = words.split()
    ours = cli(*arguments, cwd=tmp_path)
    code = f"import runpy, sys; sys.argv[1:] = {arguments!r}; {RUN}"
    alone = run_fresh(code, folder=tmp_path, paths=[ROOT], env=ENV)
    assert alone == [0, ours.stdout, ours.stderr]
    assert ours.stdout


RUN = "runpy.run_module('testbed', run_name='__main__')"
LAWS = ("hbh23", *list_laws())


def listed_names(lines):
    return [line.split()[0] for line in lines if line[:1].islower() and "  " in line]


def test_list_has_a_dozen_scenarios(tmp_path):
    """Each name in one line of 80 columns, the first to fly at the top; how many more there are."""
    lines = cli("list", cwd=tmp_path, columns=80).stdout.splitlines()
    assert lines[lines.index("scenarios (testbed run)") + 1].startswith("simulation-3 ")
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if line.startswith(" ")]  # each in one line
    assert listed_names(lines) == [*FIRST, *FIRST_STUDIES, *list_tunings(), *LAWS]
    assert len(FIRST) == 12
    assert "rascal110" in lines
    scenarios, studies = len(list_scenarios()) - 12, len(list_studies()) - 2
    said = f"testbed list --all has {scenarios} more scenarios and {studies} more studies."
    assert said in lines


def test_list_all_has_every_name(tmp_path, monkeypatch):
    """As does its document. Some files are read: that all can be is claimed elsewhere."""
    first, *others = (load_scenario(each) for each in some(list_scenarios(), 8))
    read = {each.scenario.name: each for each in others}
    studies = some(list_studies(), 8)
    monkeypatch.setattr("testbed.scenario.load_scenario", lambda name: read.get(name, first))
    monkeypatch.setattr("testbed.scenario.list_studies", lambda: studies)
    words = "list", "--all", "--json", "names.json"
    lines = cli(*words, cwd=tmp_path, columns=80).stdout.splitlines()
    document = json.loads((tmp_path / "names.json").read_text())
    for key, names in (("scenarios", list_scenarios()), ("studies", studies)):
        assert [each["name"] for each in document[key]] == list(names)
    numbers = {each["name"]: each["aircraft"] for each in document["scenarios"]}
    assert all(numbers[name] == len(each.aircraft_names) for name, each in read.items())
    assert {"name": "rascal110"} in document["aircraft"]
    first = lines.index("start here")
    assert lines[first + 1].startswith("simulation-3 ")
    assert all(line[:1].islower() for line in lines[first + 1 : lines.index("", first)])
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines if line.startswith(" ")]  # each in one line
    names = [*list_scenarios(), *studies, *list_tunings(), *LAWS]
    assert sorted(listed_names(lines)) == sorted(names)
    assert "rascal110" in lines
    for words in (("packet-loss-30",), ("--runs",)):
        error = call_command("list", "--all", *words, cwd=tmp_path, code=2, columns=80).stderr
        assert error == "error: --all: lists every name; leave out NAME and --runs\n"


def test_each_scenario_is_in_one_group_of_list():
    grouped = [name for group in GROUPS.values() for name in group]
    assert sorted(grouped) == sorted(list_scenarios())
    assert set(STUDIES) == set(list_studies()) and set(TUNES) == set(list_tunings())


def test_list_of_a_name_prints_question_and_file(tmp_path):
    text = cli("list", "packet-loss-30", cwd=tmp_path).stdout
    assert "How much error" in text and "packet-loss-30.yaml" in text
    rows = [line for line in text.splitlines() if line.startswith(("question ", "run ", "file "))]
    assert len({len(row) - len(row.partition(" ")[2].lstrip()) for row in rows}) == 1, rows
    assert "testbed sweep radio-and-wind" in cli("list", "radio-and-wind", cwd=tmp_path).stdout


def test_help_is_in_groups():
    """Commands by purpose, options of run by what they change; flags without a type."""
    text = help_text(columns=80)
    titles = re.findall(r"╭─ ([\w ]+) ─", text)
    assert titles == ["Options", "Fly", "Look", "Study", "Aircraft", "CI"]
    run_text = help_text("run", columns=80)
    titles = re.findall(r"╭─ ([\w ]+) ─", run_text)
    assert titles == ["Arguments", "Options", "Scenario", "Output", "View", "External programs"]
    assert "<bool>" not in text + run_text


def test_schema_is_json(tmp_path):
    document = json.loads(cli("schema", cwd=tmp_path).stdout)
    assert {"scenario", "leader", "fleet", "formation"} <= set(document["properties"])


def test_validate_prints_the_resolved_scenario(tmp_path):
    assert cli("validate", "simulation-3", cwd=tmp_path).stdout == "simulation-3: valid\n"
    changed = ("--set", "network.delay_s=0.25", "--resolved")
    resolved = cli("validate", "simulation-3", *changed, cwd=tmp_path).stdout
    (tmp_path / "resolved.yaml").write_text(resolved)
    assert "delay_s: 0.25" in resolved
    again = cli("validate", "resolved.yaml", "--resolved", cwd=tmp_path).stdout
    assert again == resolved
    assert files(tmp_path) == {"resolved.yaml"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"duration_s: 1080": "duration: 1080"}, "scenarios/mine.yaml:{line}:"),
        ({"profile: tuned": "profile: tunde"}, "tunde"),
        ({"leader_gains: {uav1: 1, uav2: 1, uav3: 1}": "leader_gains: {}"}, "A + B is singular"),
    ],
    ids=["scenario", "aircraft's file", "control law"],
)
def test_validate_and_run_name_the_error(tmp_path, changes, message):
    text = (ROOT / "scenarios" / "simulation-3.yaml").read_text()
    for old, new in changes.items():
        assert old in text
        line = text[: text.index(old)].count("\n") + 1
        text = text.replace(old, new)
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "mine.yaml").write_text(text)
    for command in ("validate", "run"):
        done = cli(command, "scenarios/mine.yaml", cwd=tmp_path, code=ExitCode.BAD_INPUT)
        assert done.stdout == ""
        assert done.stderr.startswith("error: ")
        assert message.format(line=line) in done.stderr
    assert files(tmp_path) == {"scenarios/mine.yaml"}


def test_bad_input_exits_2_and_writes_nothing(tmp_path):
    (tmp_path / "occupied").mkdir()
    (tmp_path / "occupied" / "mine.txt").write_text("mine")
    refuse_all("cli", tmp_path)


def test_run_writes_one_directory(tmp_path):
    done = cli(*FLY, cwd=tmp_path)
    found = files(tmp_path)
    assert {Path(name).name for name in found} == {
        "run.mcap",
        "scenario.resolved.yaml",
        "metrics.json",
        RECORD_NAME,
    }
    assert len(found) == 4
    (directory,) = {Path(name).parent for name in found}
    assert directory.parent.as_posix() == "logs/simulation-3"
    # the table, and where the log is; no escape codes in a pipe
    assert "smallest separation" in done.stdout
    size = sum((tmp_path / name).stat().st_size for name in found)
    assert f" {directory.as_posix()} ({size / 1e3:.0f} kB)" in done.stdout
    assert "\x1b" not in done.stdout + done.stderr
    assert said(done.stderr) == []


def said(text):
    """Lines that are not about kernels, for which a run may wait while another one compiles."""
    return [line for line in text.splitlines() if not line.startswith("compiling")]


def test_run_quiet_writes_json_and_prints_nothing(tmp_path):
    done = cli(*FLY, "-q", "--seed", "7", "--json", "m.json", "--out", "here", cwd=tmp_path)
    assert done.stdout == done.stderr == ""
    ours = (tmp_path / "m.json").read_text()
    assert ours == (tmp_path / "here" / "metrics.json").read_text()
    metrics = json.loads(ours)
    assert metrics["seed"] == 7
    assert metrics["simulated_s"] == 2.0
    assert metrics["outcome"] == "completed"
    assert files(tmp_path) == {
        "m.json",
        *(f"here/{name}" for name in ("run.mcap", "scenario.resolved.yaml", "metrics.json")),
        f"here/{RECORD_NAME}",
    }


def test_run_json_on_stdout_is_only_json(tmp_path):
    (tmp_path / "empty").mkdir()
    done = cli(*FLY, *NO_LOG, "--json", "-", "--out", "empty", cwd=tmp_path)
    metrics = json.loads(done.stdout)
    assert metrics == json.loads((tmp_path / "empty" / "metrics.json").read_text())
    assert "smallest separation" in done.stderr
    assert files(tmp_path) == {
        *(f"empty/{name}" for name in ("metrics.json", "scenario.resolved.yaml", RECORD_NAME))
    }


@pytest.mark.parametrize(
    "arguments", [("run", "simulation-3", "--duration=1", "--out=run"), ("list",)], ids=" ".join
)
def test_closed_pipe_exits_0(tmp_path, arguments):
    """Such as that of `head`; rich would exit with 1, the code of a lost aircraft."""
    read, write = os.pipe()
    os.close(read)
    with open(write, "wb") as pipe, open(tmp_path / "errors", "wb") as errors:
        streams = {"stdout": pipe, "stderr": errors}
        process = Forked("testbed.cli.entry:main", *arguments, cwd=tmp_path, env=ENV, **streams)
        code = process.wait(TIMEOUT_S)
    assert (code, said((tmp_path / "errors").read_text())) == (0, [])
    if "run" in arguments:
        metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
        assert metrics["outcome"] == "completed"


@pytest.mark.parametrize(
    ("words", "work"),
    [
        (("check", "exact.yaml", "--update", "--reason", "why"), "golden.golden.fly_all"),
        (("network", "bursty-wifi", "--out", "old.csv"), "probes.channel_probe.probe_channel"),
        (("air", "simulation-3", "--out", "old.csv"), "probes.air_probe.fly_probes"),
    ],
    ids=["check", "network", "air"],
)
def test_ctrl_c_exits_130_and_keeps_files(tmp_path, monkeypatch, words, work):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    golden_scenarios.write(tmp_path, "exact")
    (tmp_path / "old.csv").write_text("old")
    before = golden_scenarios.files(tmp_path)
    monkeypatch.setattr(f"testbed.{work}", interrupt)
    call_command(*words, cwd=tmp_path, code=ExitCode.INTERRUPTED, columns=80)
    assert golden_scenarios.files(tmp_path) == before


LOADING = """
import sys, testbed.cli.entry

class Interrupted:
    def find_spec(self, name, *more):
        if name == "typer":
            raise {error}

sys.meta_path.insert(0, Interrupted())
testbed.cli.entry.main()
"""


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        ("KeyboardInterrupt", 130, ""),
        ("MemoryError", 2, "error: not enough memory: an allocation failed"),
        ("ImportError('x.so: failed to map segment from shared object')", 2, "x.so: failed to map"),
    ],
)
def test_ending_while_libraries_load_has_its_code(error, code, words):
    program = [sys.executable, "-c", LOADING.format(error=error)]
    done = subprocess.run(program, env=environment(200), capture_output=True, text=True)
    assert done.returncode == code and words in done.stderr
    assert "Traceback" not in done.stderr and (words or not done.stderr)


def test_lack_of_memory_in_a_command_is_one_error_line(monkeypatch, tmp_path):
    for error in (
        MemoryError(),
        OSError(errno.ENOMEM, "x"),
        RuntimeError("can't start new thread"),
    ):
        monkeypatch.setattr("testbed.cli.main.app", Mock(side_effect=error))
        printed = call_command("list", cwd=tmp_path, code=2, columns=200).stderr
        assert printed.startswith("error: not enough memory: ") and printed.count("\n") == 1


def test_interrupt_made_an_error_by_a_library_is_one(monkeypatch, tmp_path):
    """As numba and NumPy do while they are loaded."""

    def load():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr("testbed.cli.main.app", load)
    assert call_command("list", cwd=tmp_path, code=130, columns=200).stderr == ""


def test_wrong_number_of_threads_is_not_used(monkeypatch):
    """As a job makes it of a variable that is not set; numba cannot be imported with it."""
    used = []

    def command_line():
        used.append(os.environ.get("NUMBA_NUM_THREADS"))

    monkeypatch.setattr("testbed.cli.main.main", command_line)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    for threads in ("0", "", "-1", "many", "3"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        entry.main()
    assert used == [None, None, None, None, "3"]


@in_full  # of which the setting is dropped before the command line is loaded, as above
def test_job_without_threads_validates(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "0")
    run_command("validate", "simulation-1", cwd=tmp_path, code=0, columns=80)
