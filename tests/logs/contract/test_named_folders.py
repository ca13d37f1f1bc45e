"""Files that commands write into a folder that an option names: none of the user is replaced."""

import os

import pytest
from cases import ALL
from commands import call_command
from record_flight import record, run_info, run_samples
from study_samples import write_study
from written_runs import synthetic, time_limit

from testbed.logs.file_record import RECORD_NAME
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.logs.run_list import delete_runs, list_runs
from testbed.metrics.document import to_json
from testbed.reports import figures
from testbed.runs.recover import recover

COMMANDS = {
    "law": (("law", "--figures=out", "--format=svg"), "control-functions.svg"),
    "report": (("report", "run", "--figures=out", "--format=svg"), "altitude.svg"),
    "study figures": (
        ("study-report", "study.parquet", "--figures=out", "--format=svg"),
        "parameters-windows-laps-mean_rms_m.svg",
    ),
    "study tables": (
        ("study-report", "study.parquet", "--json=it.json", "--tables=out"),
        "overview.csv",
    ),
}
PLACES = {
    "a file": lambda path: path.write_text("mine"),
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a link": lambda path: (path.with_name("mine").write_text("mine"), path.symlink_to("mine")),
    "a pipe": os.mkfifo,
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A run and a study, whose reports have few figures."""
    makers = tuple(each for each in figures.MAKERS if each[0] == "altitude")
    monkeypatch.setattr(figures, "MAKERS", makers)
    (synthetic(tmp_path / "run") / SCENARIO_NAME).write_text(run_info().scenario_yaml)
    write_study(tmp_path / "study.parquet")
    return tmp_path


def names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("command", COMMANDS)
def test_files_in_a_named_folder_are_not_replaced(folder, command, place):
    """Refused before anything is written, also into other files."""
    words, name = COMMANDS[command]
    (folder / "out").mkdir()
    PLACES[place](folder / "out" / name)
    before = names(folder)
    with time_limit(60.0):
        done = call_command(*words, cwd=folder, code=2, columns=200)
    option = next(each for each in words if each.endswith("=out")).replace("=", " ")
    line = f"error: {option}: out/{name} exists, and is not as the testbed wrote it; move it, or"
    assert done.stderr.startswith(line)
    assert done.stdout == "" and names(folder) == before
    if place in ("a file", "a link"):
        assert (folder / "out" / name).read_text() == "mine"


# `law` and `report` write twice in test_figure_options.py and below
@pytest.mark.parametrize("command", COMMANDS if ALL else ("study figures", "study tables"))
def test_own_files_in_a_named_folder_are_replaced(folder, command):
    """Until they are changed; other files of the user are no obstacle."""
    words, name = COMMANDS[command]
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")
    for _ in range(2):
        call_command(*words, cwd=folder, code=0, columns=200)
    assert (folder / "out" / name).stat().st_size > 0
    assert (folder / "out" / "notes.txt").read_text() == "mine"
    (folder / "out" / name).write_text("mine")
    call_command(*words, cwd=folder, code=2, columns=200)
    assert (folder / "out" / name).read_text() == "mine"


def test_figures_in_a_run_are_deleted_with_it(folder):
    words = ("report", "run", "--figures=run/figures", "--format=svg")
    for _ in range(2):
        call_command(*words, cwd=folder, code=0, columns=200)
    (run,) = list_runs(folder)
    assert not run.others and RECORD_NAME not in os.listdir(folder / "run" / "figures")
    (folder / "run" / "figures" / "mine.svg").write_text("mine")
    (run,) = list_runs(folder)
    assert run.others == ("figures/mine.svg",)
    assert not list(delete_runs([run]))
    (folder / "run" / "figures" / "mine.svg").unlink()
    assert list(delete_runs(list_runs(folder)))


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("place", ["a link to nothing", "a pipe", "a file"])
def test_recover_writes_over_no_other_file(tmp_path, finished, place):
    """Neither in place of a run's metrics, nor where a link leads; the log stays as it is."""
    synthetic(tmp_path, ended=finished)
    metrics = tmp_path / METRICS_NAME
    PLACES[place](metrics)
    log, before = (tmp_path / LOG_NAME).read_bytes(), names(tmp_path)
    if finished and place != "a link to nothing":
        assert not recover(tmp_path).was_cut
    else:
        error = "exists, and is not as the testbed wrote it; move or rename it"
        with pytest.raises(Exception, match=error):
            recover(tmp_path)
    assert (tmp_path / LOG_NAME).read_bytes() == log and names(tmp_path) == before


@pytest.mark.parametrize("data", [b"mine\n", to_json({}).encode(), None])
def test_recover_deletes_no_file_named_as_a_tail(tmp_path, data):
    record(tmp_path / LOG_NAME, run_samples(30), run_info(), summary={})
    tail = tmp_path / f".{LOG_NAME}.tail"
    if data is None:
        (tmp_path / "mine").write_text("mine")
        tail.symlink_to("mine")
    else:
        tail.write_bytes(data)
    assert recover(tmp_path).was_cut
    assert tail.is_symlink() if data is None else tail.read_bytes() == data
