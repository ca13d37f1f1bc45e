"""`testbed list --runs`, `list --json` and `testbed prune`: sizes, dates, and what is deleted."""

import json
import os
import shutil
from datetime import timedelta
from pathlib import Path

import pytest
from commands import call_command, refuse_all
from record_flight import record, run_info, run_samples
from written_runs import NOW, make_run, time_limit

from testbed.cli.report import default_report
from testbed.core.errors import InputError
from testbed.core.files import lock_file
from testbed.logs.file_record import RECORD_NAME, foreign_files, record_output
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.logs.run_list import CUT_SHORT, RUNNING, delete_runs, list_runs, select_runs
from testbed.metrics.document import to_json


@pytest.fixture
def logs(tmp_path):
    """Four runs of one scenario and one of another, beside things that are no runs."""
    logs = tmp_path / "logs"
    for days in (1, 2, 40, 50):
        make_run(logs, "near", days)
    make_run(logs, "far", 100)
    study = logs / "studies" / "mine" / "20260101T000000Z-0001"
    study.mkdir(parents=True)
    (study / "study.parquet").write_bytes(b"PAR1")
    (logs / "notes").mkdir()
    (logs / "notes" / SCENARIO_NAME).write_text("a copy\n")  # without a log: no run
    return logs


def ages(runs):
    return [(NOW - each.begun).days for each in runs]


def files(folder):
    return {each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file()}


def test_runs_are_listed_with_size_and_date(logs):
    runs = list_runs(logs)
    assert ages(runs) == [100, 50, 40, 2, 1]
    assert {each.scenario for each in runs} == {"near", "far"}
    first = runs[0]
    assert first.size == sum(path.stat().st_size for path in first.directory.iterdir())
    assert (first.outcome, first.simulated_s, first.others) == ("completed", 60.0, ())


@pytest.mark.parametrize(
    ("criteria", "chosen"),
    [
        ({"older_than": timedelta(days=30)}, [100, 50, 40]),
        ({"older_than": timedelta(days=30), "keep": 1}, [50, 40]),
        ({"keep": 1}, [50, 40, 2]),
        ({"keep": 9}, []),
        ({"max_bytes": 5_200}, [100, 50]),
        ({"max_bytes": 0}, [100, 50, 40, 2, 1]),
        ({"max_bytes": 0, "keep": 2}, [50, 40]),
    ],
    ids=str,
)
def test_old_runs_are_chosen(logs, criteria, chosen):
    assert ages(select_runs(list_runs(logs), now=NOW, **criteria)) == chosen


def test_run_in_flight_is_not_deleted(logs):
    flying = make_run(logs, "near", 200, finished=False)
    cut = make_run(logs, "near", 201, finished=False)
    with (flying / LOG_NAME).open("rb") as log:
        assert lock_file(log)
        runs = list_runs(logs)
        assert [each.outcome for each in runs[:2]] == [CUT_SHORT, RUNNING]
        assert flying not in [each.directory for each in select_runs(runs, max_bytes=0)]
        assert [each.directory for each in delete_runs(runs[:2])] == [cut]
    assert flying.is_dir() and not cut.exists()


def test_only_run_directories_are_deleted(logs, tmp_path):
    """Files of the user, links and other folders stay; what the testbed added is deleted."""
    noted = make_run(logs, "near", 300)
    (noted / "notes.txt").write_text("mine")
    (noted / "analysis.py").write_text("mine")
    for name in ("run.csv", "run.ros2/metadata.yaml", "run.ros2/run.db3", "report.html"):
        path = logs / "far" / next((logs / "far").iterdir()).name / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("of the testbed")
        record_output(path.parent if "/" in name else path, default=True)
    outside = make_run(tmp_path / "elsewhere", "near", 400)
    (logs / "linked").symlink_to(outside, target_is_directory=True)
    before = files(logs)
    done = call_command("prune", "--size", "0kB", "--yes", cwd=tmp_path, code=0, columns=120)
    line = f"kept: logs/near/{noted.name} has analysis.py and 1 more, not as the testbed wrote it"
    assert line in done.stdout
    assert "5 runs" in done.stdout and "deleted; 1 left" in done.stdout
    deleted = before - files(logs)
    assert len(deleted) == 24 and not [each for each in deleted if noted.name in each]
    assert (outside / LOG_NAME).is_file()
    assert sorted(os.listdir(logs)) == ["linked", "near", "notes", "studies"]


def replaced(path, text):
    path.unlink(missing_ok=True)
    path.write_text(text)


CHANGES = {
    "a script": (lambda run: (run / "analysis.py").write_text("mine"), "analysis.py"),
    "notes": (lambda run: (run / "run.notes.md").write_text("mine"), "run.notes.md"),
    "a report": (lambda run: (run / "report.html").write_text("mine"), "report.html"),
    "a folder": (lambda run: (run / "figures").mkdir(), "figures/"),
    "a file below": (
        lambda run: ((run / "run.ros2").mkdir(), (run / "run.ros2" / "x").touch()),
        "run.ros2/x",
    ),
    "a link": (lambda run: (run / "run.csv").symlink_to(SCENARIO_NAME), "run.csv"),
    "a changed byte": (
        lambda run: (run / SCENARIO_NAME).write_text("scenario: []\n"),
        SCENARIO_NAME,
    ),
    "a linked log": (
        lambda run: (
            (run / LOG_NAME).rename(run.parent / "x"),
            (run / LOG_NAME).symlink_to("../x"),
        ),
        LOG_NAME,
    ),
    "a pipe": (lambda run: ((run / LOG_NAME).unlink(), os.mkfifo(run / LOG_NAME)), LOG_NAME),
    "a record of pipes": (
        lambda run: ((run / RECORD_NAME).unlink(), os.mkfifo(run / RECORD_NAME)),
        RECORD_NAME,
    ),
    "no UTF-8": (lambda run: Path(os.fsdecode(bytes(run) + b"/run.\xff")).touch(), "run.\udcff"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_run_with_a_foreign_file_stays_whole(tmp_path, change):
    """Neither lost nor waited for, however its name looks."""
    run = make_run(tmp_path / "logs", "near", 9)
    make, name = CHANGES[change]
    make(run)
    before = sorted(os.listdir(run))
    with time_limit():
        (entry,) = list_runs(tmp_path / "logs")
        assert name in entry.others
        assert select_runs([entry], max_bytes=0) == []
        assert list(delete_runs([entry])) == []
        for words in (("list", "--runs"), ("list", "--runs", "--json", "-"), ("prune", "--keep=1")):
            call_command(*words, cwd=tmp_path, code=0, columns=120)
    assert sorted(os.listdir(run)) == before


def test_copy_of_a_run_is_deleted(tmp_path):
    """Its files have other times and the same digests."""
    run = make_run(tmp_path / "logs", "near", 9)
    shutil.copytree(run, run.with_name("copy"), copy_function=shutil.copyfile)
    assert foreign_files(run.with_name("copy")) == ()


def unrecorded(folder, *, metrics=True):
    """Write a run as versions without a record did, with the code of its law."""
    folder.mkdir(parents=True)
    code = {"law.py": b"class Law: ...\n"}
    document = {"scenario": "near", "outcome": "completed", "wall_s": 1.5}
    record(folder / LOG_NAME, run_samples(3), run_info(code=code), summary=document)
    (folder / "law.py").write_bytes(code["law.py"])
    (folder / SCENARIO_NAME).write_text(run_info().scenario_yaml)
    if metrics:
        (folder / METRICS_NAME).write_text(to_json(document))
    return folder


@pytest.mark.parametrize("metrics", [True, False])
def test_unrecorded_run_is_known_by_its_content(tmp_path, metrics):
    run = unrecorded(tmp_path / "logs" / "old", metrics=metrics)
    (entry,) = list_runs(tmp_path)
    assert entry.others == ()
    for name in set(os.listdir(run)):
        data = (run / name).read_bytes()
        (run / name).write_bytes(b"#" + data[1:])
        assert name in list_runs(tmp_path)[0].others
        assert not list(delete_runs([entry]))
        (run / name).write_bytes(data)
    if metrics:
        text = (run / METRICS_NAME).read_text()
        (run / METRICS_NAME).write_text(text.replace("completed", "perfect"))
        assert list_runs(tmp_path)[0].others == (METRICS_NAME,)
        (run / METRICS_NAME).write_text(text)
    (run / "run.csv").write_text("of an unknown writer")
    assert foreign_files(run) == ("run.csv",)
    (run / "run.csv").unlink()
    assert list(delete_runs([entry])) == [entry] and not run.exists()


@pytest.mark.parametrize("stuck", [LOG_NAME, METRICS_NAME])
def test_run_stays_a_run_if_a_file_cannot_be_deleted(tmp_path, monkeypatch, stuck):
    run = make_run(tmp_path / "logs", "near", 9)
    unlink = Path.unlink

    def refuse(path, **options):
        if path.name == stuck:
            raise PermissionError(1, "Operation not permitted", str(path))
        unlink(path, **options)

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(InputError, match=rf"{run}/{stuck}: cannot be deleted: Operation not"):
        list(delete_runs(list_runs(tmp_path)))
    assert (run / METRICS_NAME).is_file()
    monkeypatch.undo()
    assert len(list(delete_runs(list_runs(tmp_path)))) == 1 and not run.exists()


@pytest.mark.parametrize(
    "value", ["1" + "0" * 400, "1e400", "NaN", "-1", "true", '"x"', "[]", "1" + "0" * 5000]
)
def test_absurd_duration_in_metrics_is_none(tmp_path, value):
    run = make_run(tmp_path / "logs", "near", 9)
    text = f'{{"simulated_s": {value}, "scenario": "a\\ud800", "outcome": "completed"}}'
    (run / METRICS_NAME).write_text(text)
    assert list_runs(tmp_path)[0].simulated_s is None
    text = call_command("list", "--runs", "--json=-", cwd=tmp_path, code=0, columns=120).stdout
    assert json.loads(text)["runs"][0]["simulated_s"] is None


def test_names_without_utf_8_survive_json(tmp_path):
    run = make_run(tmp_path / "logs" / os.fsdecode(b"\xff"), "near", 9)
    text = call_command("list", "--runs", "--json=-", cwd=tmp_path, code=0, columns=120).stdout
    assert json.loads(text)["runs"][0]["directory"] == str(run.relative_to(tmp_path))
    call_command("prune", "--keep=1", cwd=tmp_path, code=0, columns=120)


def test_prune_without_yes_deletes_nothing(logs, tmp_path):
    before = files(logs)
    done = call_command("prune", "--keep", "1", cwd=tmp_path, code=0, columns=120)
    assert "3 runs" in done.stdout and "write --yes" in done.stdout
    assert files(logs) == before


@pytest.mark.usefixtures("logs")
def test_prune_with_wrong_options_is_an_error(tmp_path):
    refuse_all("prune", tmp_path)


def test_list_runs_as_table_and_json(logs, tmp_path):
    text = call_command("list", "--runs", cwd=tmp_path, code=0, columns=120).stdout
    assert "2026-06-29 00:00 UTC  60 s  completed  1.5 kB" in text and "\n5 runs, " in text
    text = call_command("list", "--runs", "--json", "-", cwd=tmp_path, code=0, columns=120).stdout
    runs = json.loads(text)["runs"]
    assert [each["scenario"] for each in runs] == ["far", *["near"] * 4]
    assert runs[0]["size_bytes"] == list_runs(logs)[0].size


def test_list_json_without_a_file_is_standard_output(tmp_path):
    words = ("list", "--runs", ".", "--json")
    printed = [
        call_command(*words, *more, cwd=tmp_path, code=0, columns=120).stdout
        for more in ((), ("-",))
    ]
    assert printed[0] == printed[1] and json.loads(printed[0])["runs"] == []


def test_default_output_replaces_only_the_testbeds(tmp_path):
    """Its own one again and again; one that was changed, or never its own, is refused."""
    run = unrecorded(tmp_path / "run")
    words = ("export", "run", "--format", "csv")
    for _ in range(2):
        call_command(*words, cwd=tmp_path, code=0, columns=200)
    whole = (run / "run.csv").read_text()
    assert foreign_files(run) == ()
    (run / "run.csv").write_text("mine")
    done = call_command(*words, cwd=tmp_path, code=2, columns=200)
    assert "run/run.csv: exists, and is not as the testbed wrote it; write --out" in done.stderr
    assert (run / "run.csv").read_text() == "mine"
    (run / "report.html").write_text("mine")
    with pytest.raises(InputError, match=r"report\.html: exists, and is not as"):
        default_report(run / LOG_NAME)
    call_command(*words, "--out", "run/run.csv", cwd=tmp_path, code=0, columns=200)  # as told
    assert (run / "run.csv").read_text() == whole
    assert foreign_files(run) == ("report.html",)
