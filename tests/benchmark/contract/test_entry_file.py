"""Files of entries: what they may set, and how laws are named."""

import pytest

from testbed.benchmark.entry import KEYS, open_entries, open_law, shipped_names
from testbed.benchmark.gain_search import BUDGET, cell_cost, tune_entry, tuning_cells
from testbed.benchmark.task import load_benchmark
from testbed.core.errors import InputError

TWO_GAINS = """tune:
  formation.k: {{from: 0, to: 4, start: {start}}}
  formation.a: {{from: 0, to: 1, start: 1}}
"""


@pytest.fixture
def law(tmp_path):
    (tmp_path / "mine.py").write_text("raise RuntimeError('imported')\n")
    return f"{tmp_path}/mine.py:law"


def entry_file(folder, text):
    path = folder / "entry.yaml"
    path.write_text(f"entry: {{schema: 1, name: mine}}\n{text}")
    return path


@pytest.mark.parametrize(
    "key",
    [
        *("controller.options.gain", "controller.safety.margin_m", "formation.k"),
        *("controller.estimators.leader_acceleration", "controller.extrapolate_from"),
    ],
)
def test_keys_of_a_law_may_be_set(key):
    assert KEYS.fullmatch(key)


@pytest.mark.parametrize(
    "key",
    [
        *("network.loss", "air.wind.speed_mps", "fleet.uav1.start_m", "scenario.seed"),
        *("controller.law", "controller.gains.limits.roll_deg", "controller.companion.rate_hz"),
        *(
            "formation.offsets_m",
            "formation.kappa_mps",
            "formation.speed_mps",
            "limits.collision_m",
        ),
        *("controller.bounded_speed", "controller.options"),
        *("controller.options.a=1", "formation.k\n", "rates.control_hz"),
    ],
)
def test_keys_of_the_task_may_not(key, law, tmp_path):
    assert not KEYS.fullmatch(key)
    text = f"set: {{{key.strip()!r}: 1}}\n"
    if key == key.strip():
        with pytest.raises(InputError, match=r"entry\.yaml:2:.*is not of the law"):
            open_entries([law], [entry_file(tmp_path, text)])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("tune: {controller.options.a: {from: 0, to: 1, start: 2}}", "between its bounds"),
        ("tune: {controller.options.a: {from: 0, to: 1}}", "write where a search begins"),
        ("tune: {controller.options.a: {from: 0, to: 1, start: 0.5}}", "has one gain"),
        ("law: other.py:law", "law"),
        ("set: {controller.options.a: {b: 1}}", "controller.options.a"),
        ("set: {controller.options.a: .nan}", "controller.options.a"),
    ],
)
def test_a_wrong_entry_is_refused(text, reason, law, tmp_path):
    with pytest.raises(InputError, match=reason):
        open_entries([law], [entry_file(tmp_path, f"{text}\n")])


def test_nothing_is_imported_to_read_an_entry(law, tmp_path):
    (found,) = open_entries([law], [entry_file(tmp_path, "set: {controller.options.a: 1}\n")])
    assert (found.name, dict(found.set)) == ("mine", {"controller.options.a": 1.0})
    assert len(found.law.sha256) == 64
    assert found.law.sha256 in found.law.describe()


@pytest.mark.parametrize("word", ["nothing", "os:system", "mine.py", "gone.py:law", "a.py:b-c"])
def test_a_word_that_is_no_law_is_refused(word):
    with pytest.raises(InputError, match="is no law|cannot be read"):
        open_entries([word])


def test_two_entries_have_two_names(law, tmp_path):
    with pytest.raises(InputError, match="law: is the name of two entries"):
        open_entries([law, law])
    with pytest.raises(InputError, match=r"there is no LAW\.py:function for it"):
        open_entries(["hbh23"], [entry_file(tmp_path, "")])


def test_a_digest_holds_law_settings_and_bounds(law, tmp_path):
    bounds = (
        "tune: {formation.k: {from: 1, to: 3, start: 2}, formation.a: {from: 1, to: 3, start: 2}}"
    )
    files = ["", "set: {formation.k: 2}\n", bounds + "\n", bounds.replace("to: 3", "to: 4") + "\n"]
    found = [open_entries([law], [entry_file(tmp_path, each)])[0].digest for each in files]
    assert len(set(found)) == len(files)
    assert open_entries([law], [entry_file(tmp_path, files[0])])[0].digest == found[0]
    (tmp_path / "mine.py").write_text("# another file\n")
    assert open_entries([law], [entry_file(tmp_path, files[0])])[0].digest != found[0]


def test_entries_of_the_testbed_can_be_opened():
    found = {each.name: each for each in open_entries(shipped_names())}
    assert set(found) == set(shipped_names())
    assert (found["hbh23"].tune, found["hbh23"].law.reference) == ({}, "hbh23")
    assert found["hbh23-tuned"].law == found["hbh23"].law
    assert found["hbh23-tuned"].tune


def test_a_link_to_a_law_has_the_digest_of_its_file(law, tmp_path):
    (tmp_path / "link.py").symlink_to(tmp_path / "mine.py")
    assert open_law(f"{tmp_path}/link.py:law").sha256 == open_law(law).sha256


def bowl(work):
    """Flights whose number is the distance of two gains from 2 and 0.5."""
    for number, (_, gains) in enumerate(work):
        away = (gains["formation.k"] - 2.0) ** 2 + (gains["formation.a"] - 0.5) ** 2
        yield number, {"outcome": "flown", "failure": "", "number_m": 1.0 + away}


def test_tuning_keeps_its_budget_and_finds_the_least(law, tmp_path):
    text = TWO_GAINS.format(start=3.5)
    (entry,) = open_entries([law], [entry_file(tmp_path, text)])
    found = tune_entry(entry, load_benchmark(), bowl)
    assert BUDGET - 12 <= found.flights <= BUDGET
    assert found.cost_before_m == 3.5
    assert found.cost_after_m < 1.01
    assert found.gains["formation.k"].tuned == pytest.approx(2.0, abs=0.1)
    assert found == tune_entry(entry, load_benchmark(), bowl)


def test_tuning_ends_where_nothing_flies(law, tmp_path):
    text = (
        "tune: {formation.k: {from: 0, to: 4, start: 3}, formation.a: {from: 0, to: 1, start: 1}}\n"
    )
    (entry,) = open_entries([law], [entry_file(tmp_path, text)])
    flights = []

    def fail(work):
        for number, each in enumerate(work):
            flights.append(each)
            yield number, {"outcome": "failed", "failure": "exception", "number_m": 50.0}

    found = tune_entry(entry, load_benchmark(), fail)
    assert len(flights) == found.flights == len(tuning_cells(load_benchmark()))
    assert found.gains["formation.k"].tuned == 3.0


def test_tuning_tasks_are_outside_of_the_set():
    """They have wind, losses and sensor errors, and no cell of the benchmark."""
    benchmark = load_benchmark()
    found = tuning_cells(benchmark)
    assert found
    assert not {each.task for each in found} & set(benchmark.tasks)
    keys = {key for task in benchmark.tuning.values() for key in task.settings[0]}
    assert {"network.loss", "fleet.*.sensors", "air.turbulence"} <= keys
    assert max(task.draws[0].wind_mps[1] for task in benchmark.tuning.values()) >= 6.0


def test_a_later_loss_costs_less():
    costs = [
        cell_cost({"outcome": "lost", "lost_at_s": at_s, "number_m": 50.0}, 200.0)
        for at_s in (10.0, 100.0, None)
    ]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == 50.0
    assert cell_cost({"outcome": "flown", "number_m": 49.0}, 200.0) == 49.0
    assert cell_cost({"outcome": "failed", "number_m": 50.0}, 200.0) > costs[0]
