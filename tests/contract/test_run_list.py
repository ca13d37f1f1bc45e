"""`testbed list --runs`, `list --json` and `testbed prune`: sizes, dates, and what is deleted."""

import json
import os
from datetime import UTC, datetime, timedelta

import pytest
from commands import call_command

from testbed.core.files import lock_file
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.logs.run_list import CUT_SHORT, RUNNING, delete_runs, list_runs, select_runs
from testbed.scenario import list_scenarios, list_studies

NOW = datetime(2026, 6, 30, tzinfo=UTC)


def make_run(logs, scenario, days_ago, *, size=1000, finished=True):
    """Write the files of a run that began some days before `NOW`."""
    name = f"{NOW - timedelta(days=days_ago):%Y%m%dT%H%M%SZ}-{days_ago:04x}"
    folder = logs / scenario / name
    folder.mkdir(parents=True)
    (folder / SCENARIO_NAME).write_text("scenario: {}\n")
    (folder / LOG_NAME).write_bytes(bytes(size))
    if finished:
        document = {"scenario": scenario, "outcome": "completed", "simulated_s": 60.0}
        (folder / METRICS_NAME).write_text(json.dumps(document))
    return folder


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
        ({"max_bytes": 3_500}, [100, 50]),
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
    """Files of the user, links and other folders stay."""
    noted = make_run(logs, "near", 300)
    (noted / "notes.txt").write_text("mine")
    (noted / "report.html").write_text("ours")
    outside = make_run(tmp_path / "elsewhere", "near", 400)
    (logs / "linked").symlink_to(outside, target_is_directory=True)
    before = files(logs)
    done = call_command("prune", "--size", "0kB", "--yes", cwd=tmp_path, code=0, columns=120)
    assert f"kept: logs/near/{noted.name} has notes.txt" in done.stdout
    assert "5 runs" in done.stdout and "deleted; 1 left" in done.stdout
    deleted = before - files(logs)
    assert len(deleted) == 15 and not [each for each in deleted if noted.name in each]
    assert (outside / LOG_NAME).is_file()
    assert sorted(os.listdir(logs)) == ["linked", "near", "notes", "studies"]


def test_prune_without_yes_deletes_nothing(logs, tmp_path):
    before = files(logs)
    done = call_command("prune", "--keep", "1", cwd=tmp_path, code=0, columns=120)
    assert "3 runs" in done.stdout and "write --yes" in done.stdout
    assert files(logs) == before


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "write --older 30d, --size 5GB or --keep 3"),
        (("--older", "30x"), "--older 30x: write a time in hours, days or weeks"),
        (("--size", "many"), "--size many: write a size"),
        (("--keep", "0"), "--keep 0: write a whole number above 0"),
        (("nowhere", "--keep", "1"), "nowhere: there is no such folder"),
    ],
)
def test_prune_with_wrong_options_is_an_error(logs, tmp_path, words, reason):
    done = call_command("prune", *words, cwd=tmp_path, code=2, columns=120)
    assert reason in done.stderr
    assert len(list_runs(logs)) == 5


def test_list_runs_as_table_and_json(logs, tmp_path):
    text = call_command("list", "--runs", cwd=tmp_path, code=0, columns=120).stdout
    assert "2026-06-29 00:00 UTC  60 s  completed  1.1 kB" in text and "\n5 runs, " in text
    text = call_command("list", "--runs", "--json", "-", cwd=tmp_path, code=0, columns=120).stdout
    runs = json.loads(text)["runs"]
    assert [each["scenario"] for each in runs] == ["far", *["near"] * 4]
    assert runs[0]["size_bytes"] == list_runs(logs)[0].size
    done = call_command("list", "--runs", "nowhere", cwd=tmp_path, code=2, columns=120)
    assert "nowhere: there is no such folder" in done.stderr


def test_list_json_has_all_names(tmp_path):
    text = call_command("list", "--json", "-", cwd=tmp_path, code=0, columns=120).stdout
    document = json.loads(text)
    without = call_command("list", "--json", cwd=tmp_path, code=0, columns=120).stdout
    assert without == text, "standard output is meant"
    for key, names in (("scenarios", list_scenarios()), ("studies", list_studies())):
        assert [each["name"] for each in document[key]] == list(names)
    assert {"name": "rascal110"} in document["aircraft"]
