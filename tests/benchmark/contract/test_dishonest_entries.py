"""Entries that try to gain a rank: by crashing, hanging, choosing flights, or another digest."""

import json

import pytest
from tiny_benchmark import FLIGHTS, SEEDS, fly, fly_here, write_law, write_tasks

from testbed.benchmark import campaign
from testbed.benchmark.campaign import STOPPED
from testbed.benchmark.cell import LOST_M, CellKey
from testbed.benchmark.entry import open_law
from testbed.benchmark.limited_flight import FlightLimits
from testbed.benchmark.ranking import rank, ranking
from testbed.benchmark.result import parse_result, to_document
from testbed.benchmark.task import load_benchmark
from testbed.benchmark.verify import check_law
from testbed.core.errors import InputError

SHORT = FlightLimits(cpu_s=20, wall_s=1)


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    return write_tasks(tmp_path_factory.mktemp("benchmark") / "tiny")


@pytest.fixture(scope="module")
def results(tasks, tmp_path_factory):
    """Results of an honest law, and of the same law with something added; all their flights."""
    folder = tmp_path_factory.mktemp("laws")
    words = [
        write_law(folder / "honest.py"),
        write_law(
            folder / "crash.py",
            doc="Raise where the error is large.",
            step="if now > 5.0 and abs(own.position_ned[0, 1]) > 100.0: raise ValueError('no')",
        ),
    ]
    settings = []
    for word in words:
        name = word.rpartition("/")[2].partition(".")[0]
        settings.append(folder / f"{name}.yaml")
        settings[-1].write_text(f"entry: {{schema: 1, name: {name}}}\n")
    with pytest.MonkeyPatch.context() as patch:
        here = fly_alone(patch)
        return fly(words, folder / "out", tasks, settings=settings), folder, here.results


def fly_alone(patch):
    """Fly here without the flights by which messages are judged: test_probes has them."""
    patch.setattr(campaign, "probe_entry", lambda *_, **__: {"messages": None, "margins": []})
    return fly_here(patch)


@pytest.fixture(autouse=True)
def pool(monkeypatch):
    return fly_alone(monkeypatch)


def changed(result, change):
    """Return a result after a change of its document."""
    document = to_document(result)
    change(document)
    return parse_result(json.dumps(document).encode(), "changed.json")


def named(name):
    """A change that enters a result under another name."""

    def change(document):
        document["entry"]["name"] = name

    return change


def means(found):
    return {
        (table["name"], row["entry"]): row["mean_m"]
        for table in found["tables"]
        for row in table["standings"]
    }


def test_a_crash_never_betters_a_number(results, tasks):
    """Flights that fail count with the largest error, and apart from bad flying."""
    found, benchmark = results[0], load_benchmark(tasks)
    honest = {each.key: each for each in found["honest"].cells}
    failed = [each for each in found["crash"].cells if each.outcome == "failed"]
    assert 0 < len(failed) < len(honest)
    assert {each.failure for each in failed} == {"exception"}
    assert {each.number_m for each in failed} == {LOST_M}
    assert "ValueError: no" in failed[0].why
    for each in found["crash"].cells:
        assert each.number_m >= honest[each.key].number_m
    page = ranking(list(found.values()), benchmark)
    by_name = {each["name"]: each for each in page["entries"]}
    assert by_name["crash"]["failed"] == len(failed)
    assert by_name["crash"]["lost"] == 0
    for name, task in by_name["honest"]["tasks"].items():
        distances = [each.separation_window_m for each in honest.values() if each.task == name]
        assert task["separation_window_m"] == min(distances) < max(distances)
    numbers = means(page)
    for table in ("all", "gentle", "steep"):
        assert numbers[table, "crash"] >= numbers[table, "honest"]
    claims = [(each.better, each.worse) for each in rank(list(found.values()), benchmark)]
    assert ("crash", "honest") not in claims


def test_an_opened_file_changes_no_number(results, tasks, tmp_path):
    """It can open one; the page has the same numbers to the bit."""
    opened = tmp_path / "opened"
    word = write_law(tmp_path / "opens.py", step=f"open({str(opened)!r}, 'a').write('x')")
    found = fly([word], tmp_path / "out", tasks, only=("gentle",))["Law"]
    numbers = {each.key: each.number_m for each in results[0]["honest"].cells}
    assert [each.number_m for each in found.cells] == [numbers[each.key] for each in found.cells]
    assert len(found.cells) == len(SEEDS) and opened.stat().st_size > 0


def test_the_order_of_entry_changes_nothing(results, tasks):
    found, benchmark = list(results[0].values()), load_benchmark(tasks)
    one, two = (ranking(each, benchmark) for each in (found, found[::-1]))
    assert one["tables"] == two["tables"]
    assert one["comparisons"] == two["comparisons"]


def test_easy_seeds_alone_have_no_rank(results, tasks):
    """A result without its worst flights, or with other seeds, is refused."""
    found, benchmark = results[0], load_benchmark(tasks)
    worst = sorted(found["honest"].cells, key=lambda each: each.number_m)[-2:]
    hard = {(each.task, each.level, each.seed) for each in worst}

    def leave_out(document):
        named("easy")(document)
        document["cells"] = [
            each
            for each in document["cells"]
            if (each["task"], each["level"], each["seed"]) not in hard
        ]

    easy = changed(found["honest"], leave_out)
    with pytest.raises(InputError, match="easy: has 2 flights too few"):
        rank([easy, found["honest"]], benchmark)
    page = ranking([easy, found["honest"]], benchmark)
    assert (page["tables"], page["comparisons"]) == ([], [])
    assert page["missing"] == {"easy": 2, "honest": 0}

    def choose(document):
        named("chosen")(document)
        document["conditions"]["seeds"]["values"] = [7, 8, 9]

    with pytest.raises(InputError, match="chosen: has other seeds than those of its practice"):
        rank([changed(found["honest"], choose)], benchmark)

    def add(document):
        named("more")(document)
        document["cells"].append({**document["cells"][0], "seed": 99, "number_m": 0.0})

    with pytest.raises(InputError, match="more: has flights that are not of the benchmark"):
        rank([changed(found["honest"], add)], benchmark)


def test_a_table_mixes_no_versions(results, tasks):
    found, benchmark = results[0], load_benchmark(tasks)

    def other_code(document):
        named("other")(document)
        document["conditions"]["code"]["flight"] = "0" * 12

    other = changed(found["honest"], other_code)
    with pytest.raises(InputError, match=r"do not stand in one table: code\.flight is "):
        rank([found["honest"], other], benchmark)

    def other_tasks(document):
        document["conditions"]["benchmark_digest"] = "0" * 64

    with pytest.raises(InputError, match="was flown on tiny 1.0 000000000000"):
        rank([changed(found["honest"], other_tasks)], benchmark)
    with pytest.raises(InputError, match="two results have this name"):
        rank([found["honest"], found["honest"]], benchmark)


def test_a_law_that_never_returns_ends(pool, tasks, tmp_path):
    """Three flights take their time; the others are not flown, and all have failed."""
    word = write_law(tmp_path / "loop.py", top="import time; time.sleep(100)")
    found = fly([word], tmp_path / "out", tasks, limits=SHORT)["Law"]
    assert len(pool.flown) == 3
    assert [each.failure for each in found.cells] == ["time"] * FLIGHTS
    assert {each.number_m for each in found.cells} == {LOST_M}
    assert found.cells[0].why == "time: did not end within 1 s by the clock"
    assert found.cells[3].why == STOPPED.format(3)
    assert (found.messages, found.margins) == (None, ())
    page = ranking([found], load_benchmark(tasks))
    assert page["entries"][0]["failed"] == FLIGHTS


def test_a_digest_that_lies_runs_nothing(results, tmp_path):
    """Another file than the one that was entered is refused before its import."""
    marker = tmp_path / "imported"
    honest = results[0]["honest"]
    word = write_law(tmp_path / "honest.py", top=f"open({str(marker)!r}, 'w')")
    with pytest.raises(InputError, match=r"is not the law of honest, honest\.py:Law SHA-256"):
        check_law(honest, open_law(word))
    own = open_law(f"{results[1]}/honest.py:Law")
    check_law(honest, own)

    def lie(document):
        document["entry"]["law_sha256"] = open_law(word).sha256

    # the digest of the entry holds the one of the file
    with pytest.raises(InputError, match="settings and bounds are not those of its digest"):
        check_law(changed(honest, lie), open_law(word))

    def other_gains(document):
        document["entry"]["set"] = document["gains"] = {"controller.options.roll": 0.3}

    with pytest.raises(InputError, match="settings and bounds are not those of its digest"):
        check_law(changed(honest, other_gains), own)
    assert not marker.exists()


def test_the_first_failure_is_told_at_once(pool, tasks, tmp_path):
    """Of each law once, with its reason: a wrong option is seen before all flights have failed."""
    words = [write_law(tmp_path / "bad.py", step="if now > 1.0: raise ValueError('no')")]
    lines = []
    found = fly(words, tmp_path / "out", tasks, only=("gentle",), report=lines.append)["Law"]
    assert {each.failure for each in found.cells} == {"exception"}
    (told,) = [line for line in lines if "the first flight that fails" in line]
    assert "gentle/1/1: exception: " in told
    assert "bad.py:14: the law raised ValueError: no" in told
    assert not [each.why for each in found.cells if str(tmp_path) in each.why]


@pytest.mark.parametrize(
    ("law", "function", "entry", "reason"),
    [
        ({"top": "raise ValueError('no')"}, "Law", "", r"bad\.py:4: the law raised ValueError: no"),
        ({}, "Lay", "", r"has no class 'Lay'.*it has Law"),
        ({}, "Law", "set: {controller.options.rol: 1}", "unexpected keyword argument 'rol'"),
        (
            {},
            "Law",
            "tune: {controller.options.rol: {from: 0, to: 1, start: 0}, "
            "controller.options.roll: {from: 0, to: 1, start: 0}}",
            "unexpected keyword argument 'rol'",
        ),
    ],
)
def test_mistakes_are_told_before_any_flight(pool, tasks, tmp_path, law, function, entry, reason):
    word = write_law(tmp_path / "bad.py", **law).rpartition(":")[0]
    (tmp_path / "bad.yaml").write_text(f"entry: {{schema: 1, name: bad}}\n{entry}\n")
    with pytest.raises(InputError, match=f"bad: .*{reason}"):
        fly([f"{word}:{function}"], tmp_path / "out", tasks, settings=[tmp_path / "bad.yaml"])
    assert not pool.flown


def test_a_file_that_changes_meanwhile_fails(results, tasks, tmp_path):
    from testbed.benchmark.cell import fly_cell

    word = write_law(tmp_path / "law.py")
    law = open_law(word)
    write_law(tmp_path / "law.py", top="HACK = 1")
    found = fly_cell(CellKey("gentle", 1, 1), law, {}, folder=tasks)
    assert (found["outcome"], found["failure"]) == ("failed", "exception")
    assert "has changed since it was read" in found["why"]


def test_interrupted_flights_go_on(pool, results, tasks):
    """What is kept is not flown again, and the result is that of one go."""
    whole, folder, pool.known = results
    word, out = f"{folder}/honest.py:Law", folder / "interrupted"
    pool.most = len(SEEDS) + 1
    with pytest.raises(KeyboardInterrupt):
        fly([word], out, tasks)
    pool.most = 1000
    again = fly([word], out, tasks)["Law"]
    # a whole task was kept; and the probe
    assert len(pool.flown) == len(SEEDS) + 1 + len(SEEDS) + 1
    assert again.cells == whole["honest"].cells
    flown = len(pool.flown)
    fly([word], out, tasks)
    assert len(pool.flown) == flown
    write_law(folder / "honest2.py", doc="Another one.")
    fly([f"{folder}/honest2.py:Law"], out, tasks, only=("gentle",))
    assert len(pool.flown) == flown + len(SEEDS) + 1
