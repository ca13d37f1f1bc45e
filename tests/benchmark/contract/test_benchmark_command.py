"""The command benchmark: what it prints before code runs, its files, verify and table."""

import json
import re
import shutil

import pytest
from commands import call_command
from tiny_benchmark import SEEDS, fly_here, write_law, write_tasks

import testbed
import testbed.benchmark.task as task_module
from testbed.benchmark.entry import open_law


def command(*words, cwd, code=0):
    return call_command(*words, cwd=cwd, code=code, columns=200)


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    return write_tasks(tmp_path_factory.mktemp("benchmark") / "tiny")


@pytest.fixture(autouse=True)
def _tiny(monkeypatch, tasks):
    fly_here(monkeypatch)
    monkeypatch.setattr(task_module, "default_folder", lambda: tasks)
    task_module.load_benchmark.cache_clear()
    yield
    task_module.load_benchmark.cache_clear()


@pytest.fixture(scope="module")
def flown(tmp_path_factory, tasks):
    """A law and the testbed's own, flown by the command; its folder, and what it printed."""
    folder = tmp_path_factory.mktemp("flown")
    word = write_law(folder / "mine.py")
    with pytest.MonkeyPatch.context() as patch:
        fly_here(patch)
        patch.setattr(task_module, "default_folder", lambda: tasks)
        task_module.load_benchmark.cache_clear()
        done = command(
            *("benchmark", word, "hbh23", "--out", folder / "out", "--json", folder / "all.json"),
            cwd=folder,
        )
    return folder, done


def test_file_and_digest_are_printed_first(flown):
    folder, done = flown
    digest = open_law(f"{folder}/mine.py:Law").sha256
    lines = done.stderr.splitlines()
    (said,) = [k for k, line in enumerate(lines) if digest in line]
    assert f"Law: {folder}/mine.py:Law SHA-256 {digest}" in lines[said]
    assert said < min(k for k, line in enumerate(lines) if "lost or failed" in line)


def test_files_of_a_benchmark(flown):
    folder, done = flown
    out = folder / "out"
    assert {each.name for each in out.iterdir()} >= {"benchmark.html", "benchmark.json", "results"}
    document = json.loads((out / "benchmark.json").read_text())
    assert document == json.loads((folder / "all.json").read_text())
    assert {each.name for each in (out / "results").iterdir()} == {"Law.json", "hbh23.json"}
    result = json.loads((out / "results" / "Law.json").read_text())
    assert result["command"] == "testbed benchmark verify Law.json mine.py:Law --cell CELL"
    assert result["messages"] == {"neighbours": False, "per_s": 25.0}
    assert [each["name"] for each in document["tables"]] == ["all", "gentle", "steep"]
    assert document["tables"][0]["standings"][0]["entry"] == "hbh23"
    assert re.search(r"1 +hbh23 +\d+\.\d\d m", done.stdout)
    page = (out / "benchmark.html").read_text()
    assert open_law(f"{folder}/mine.py:Law").sha256 in page
    assert "<script" not in page
    assert page.count("http") == 0


def test_verify_repeats_flights_to_the_bit(flown):
    folder, _ = flown
    result = folder / "out" / "results" / "Law.json"
    words = ("benchmark", "verify", result, f"{folder}/mine.py:Law")
    done = command(*words, "--cells", "2", "--sample", "7", cwd=folder)
    assert done.stdout.count("equal to the bit") == 2
    assert open_law(f"{folder}/mine.py:Law").sha256 in done.stderr
    one = command(*words, "--cell", "gentle/1/2", "--log", "logs", "--json", cwd=folder)
    assert json.loads(one.stdout)["cells"] == [{"cell": "gentle/1/2", "different": []}]
    logged = testbed.load_run(folder / "logs" / "gentle-1-2")
    assert logged.time_s[-1] == pytest.approx(8.0) and "uav1" in logged.names
    own = ("benchmark", "verify", folder / "out" / "results" / "hbh23.json", "--cells", "1")
    assert "equal to the bit" in command(*own, cwd=folder).stdout


def test_verify_finds_a_better_number(flown, tmp_path):
    folder, _ = flown
    document = json.loads((folder / "out" / "results" / "Law.json").read_text())
    document["cells"][0]["number_m"] = 0.01
    (tmp_path / "better.json").write_text(json.dumps(document))
    cell = "{task}/{level}/{seed}".format(**document["cells"][0])
    done = command(
        *("benchmark", "verify", tmp_path / "better.json", f"{folder}/mine.py:Law"),
        *("--cell", cell),
        cwd=tmp_path,
        code=3,
    )
    assert "differs in number_m" in done.stdout


def test_verify_runs_no_other_law(flown, tmp_path):
    """Also where the result has been changed to name it."""
    folder, _ = flown
    marker = tmp_path / "imported"
    word = write_law(tmp_path / "mine.py", top=f"open({str(marker)!r}, 'w')")
    result = folder / "out" / "results" / "Law.json"
    done = command("benchmark", "verify", result, word, cwd=tmp_path, code=2)
    assert "is not the law of Law" in done.stderr
    document = json.loads(result.read_text())
    document["entry"]["law_sha256"] = open_law(word).sha256
    (tmp_path / "forged.json").write_text(json.dumps(document))
    done = command(
        *("benchmark", "verify", tmp_path / "forged.json", word),
        cwd=tmp_path,
        code=2,
    )
    assert "are not those of its digest" in done.stderr
    done = command("benchmark", "verify", result, cwd=tmp_path, code=2)
    assert "does not come with the testbed" in done.stderr
    assert not marker.exists()


def test_table_ranks_without_a_flight(flown, tmp_path):
    folder, _ = flown
    files = sorted((folder / "out" / "results").glob("*.json"))
    words = ("benchmark", "table", *files, "--out", tmp_path / "page.html", "--json")
    done = command(*words, cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document == json.loads((folder / "out" / "benchmark.json").read_text())
    assert (tmp_path / "page.html").read_bytes() == (folder / "out" / "benchmark.html").read_bytes()
    wrong = json.loads(files[0].read_text())
    wrong["conditions"]["pins"]["numpy"] = "1.0"
    (tmp_path / "wrong.json").write_text(json.dumps(wrong))
    words = ("benchmark", "table", files[1], tmp_path / "wrong.json")
    done = command(*words, cwd=tmp_path, code=2)
    assert "do not stand in one table: pins.numpy" in done.stderr


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "there is no entry"),
        (("hbh23", "--task", "nope"), "--task nope: write one of gentle, steep"),
        (("hbh23", "--pulse", "nope"), "--pulse nope: write 16 to 1024 hexadecimal digits"),
        (("os:system",), r"os:system: is no law \(write LAW\.py:function"),
        (("hbh23", "--resume", "--out", "gone"), "--out gone: there is no such folder"),
    ],
)
def test_a_wrong_word_is_refused(words, reason, tmp_path):
    words = ("benchmark", "fly", *words)
    done = command(*words, cwd=tmp_path, code=2)
    assert re.search(reason, done.stderr)


def test_one_task_has_no_rank(flown, tmp_path):
    """Its flights are kept."""
    shutil.copytree(flown[0] / "out", tmp_path / "out")
    words = ("benchmark", "hbh23", "--task", "gentle", "--out", "out", "--resume")
    done = command(*words, cwd=tmp_path)
    assert f"no rank: {len(SEEDS)} flights are missing" in done.stdout
    page = (tmp_path / "out" / "benchmark.html").read_text()
    assert f"No ranks: flights are missing (hbh23: {len(SEEDS)})" in page
