"""A law of one's own: found, held to its contract, blamed by line, and flown."""

import hashlib
import json
import os
import shutil
import sys
import textwrap

import numpy as np
import pytest

import testbed
from testbed.errors import InputError
from testbed.record.read import read_log
from testbed.report import figures, read_flight
from testbed.report.page import page_of
from testbed.scenario import list_scenarios, load, shorten
from testbed.sim.law_contract import check_law
from testbed.sim.world import build
from testbed.state import Inbox, VehicleState
from testbed.study.two_runs import compare_runs

GOOD = """
    import numpy as np
    from testbed.law import FbwaCommand, UnicycleCommand

    class Straight:
        def __init__(self, team, *, roll=0.0, memory=0.0):
            self.team, self.roll, self.count = team, roll, 0

        def start(self, own):
            return np.zeros(len(own.airspeed))

        def step(self, now, own, inbox, memory):
            n = len(own.airspeed)
            BODY
            return FbwaCommand(np.zeros(n), np.full(n, self.roll), np.full(n, 0.3)), memory
"""


SHORT = ("scenario.duration_s=0.4", "scenario.portions={}", "scenario.published=null")


def page(folder, body="pass", *, text=GOOD, law="mine:Straight", more=""):
    """The path of a page with a law beside it, whose step does this."""
    (folder / "mine.py").write_text(textwrap.dedent(text).replace("BODY", body))
    path = folder / "mine.yaml"
    path.write_text(f"extends: simulation-3\ncontroller: {{law: '{law}'{more}}}\n")
    return path


def refusal(path, *overrides):
    with pytest.raises(InputError) as caught:
        build(load(path, overrides))
    return str(caught.value)


def test_a_law_beside_its_page_flies_and_the_run_says_whose_code_it_is(tmp_path):
    path = page(tmp_path, more=", options: {roll: 0.1}")
    flown = testbed.run(shorten(load(path), 4.0), write=False)
    assert flown.outcome == "flown"
    (note,) = (event for event in flown.metrics["events"] if event["level"] == "info")
    digest = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()[:12]
    assert note["text"] == f"the law Straight runs mine.py (SHA-256 {digest})"
    # as flown it means the same from anywhere
    assert flown.scenario.controller.law == f"{tmp_path / 'mine.py'}:Straight"


def test_a_run_keeps_its_law_and_is_repeated_from_its_own_page_to_the_bit(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "MAKERS", ())  # to draw them takes seconds
    mine = tmp_path / "mine"
    mine.mkdir()
    path = page(mine, "self.roll = 0.01 * float(np.round(now))")
    source = (mine / "mine.py").read_bytes()
    changes = ("fleet.*.vehicle=jsbsim", "scenario.question=What is it?", *SHORT)
    testbed.run(path, changes, out=tmp_path / "first")
    shutil.rmtree(mine)  # nothing is left but the run
    first = tmp_path / "first"
    assert (first / "mine.py").read_bytes() == source
    kept = (first / "scenario.resolved.yaml").read_text()
    assert "law: mine.py:Straight" in kept and str(tmp_path) not in kept
    testbed.run(first / "scenario.resolved.yaml", out=tmp_path / "again")
    logs = [read_log(tmp_path / run / "run.mcap") for run in ("first", "again")]
    found = compare_runs(*logs)
    assert found.same and not found.page
    assert logs[1].info.code == {"mine.py": source}
    # from elsewhere, the report still knows its page, and holds its law
    shutil.copy(first / "run.mcap", tmp_path / "alone.mcap")
    shutil.rmtree(first)
    flight = read_flight(tmp_path / "alone.mcap")
    assert flight.page.scenario.question == "What is it?"
    text = page_of(flight)
    assert "Save mine.py" in text and "class Straight:" in text


def test_two_runs_of_unlike_code_under_one_name_say_so(tmp_path):
    logs = []
    for roll in ("0.0", "0.1"):
        (tmp_path / roll).mkdir()
        path = page(tmp_path / roll, f"self.roll = {roll}")
        testbed.run(path, SHORT, out=tmp_path / roll / "run")
        logs.append(read_log(tmp_path / roll / "run" / "run.mcap"))
    assert compare_runs(*logs).page == ("mine.py is other code",)


def test_a_law_leaves_nothing_beside_its_page(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = page(tmp_path)
    before = sorted(tmp_path.iterdir())
    build(load(path))
    assert sorted(tmp_path.iterdir()) == before
    assert sys.dont_write_bytecode is False


def installed(folder):
    """Make of a folder on the path a package that was installed to be edited, as pip does."""
    about = folder / "a_package_of_laws-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: a-package-of-laws\nVersion: 1.0\n"
    )
    url = {"url": folder.as_uri(), "dir_info": {"editable": True}}
    (about / "direct_url.json").write_text(json.dumps(url))


def test_code_that_is_only_in_the_way_is_not_run(tmp_path, monkeypatch):
    (tmp_path / "in_the_way.py").write_text("raise AssertionError('ran')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    (home := tmp_path / "pages").mkdir()
    for law in ("in_the_way:Law", "antigravity:Law", "in_the_way.deeper:Law", "os:system"):
        assert "no module" in refusal(page(home, law=law)), law
    monkeypatch.chdir(home)
    for law in ("../in_the_way.py:Law", f"{tmp_path}/in_the_way.py:Law"):
        text = refusal(page(home, law=law))
        assert "is not in the page's folder" in text and "mine.yaml:2" in text
    (home / "linked.py").symlink_to(tmp_path / "in_the_way.py")
    assert "is not in the page's folder" in refusal(page(home, law="linked:Law"))
    (tmp_path / "mine.py").write_text((home / "mine.py").read_text())
    asked = load(page(home), [f"controller.law={tmp_path}/mine.py:Straight"])
    assert asked.controller.law == f"{tmp_path}/mine.py:Straight"
    assert "in_the_way" not in sys.modules and "antigravity" not in sys.modules


def test_a_law_may_be_installed(tmp_path, monkeypatch):
    page(tmp_path)
    (tmp_path / "mine.py").rename(tmp_path / "a_package_of_laws.py")
    monkeypatch.syspath_prepend(tmp_path)
    installed(tmp_path)
    world = build(load("simulation-3", ["controller.law=a_package_of_laws:Straight"]))
    assert type(world.groups[0].law).__name__ == "Straight"
    assert not world.groups[0].trusted
    del sys.modules["a_package_of_laws"]


def test_the_page_decides_which_of_two_files_of_a_name_is_meant(tmp_path):
    for name, roll in (("one", 0.1), ("two", 0.2)):
        (tmp_path / name).mkdir()
        page(tmp_path / name, f"self.roll = {roll}")
    rolls = [
        testbed.run(shorten(load(tmp_path / name / "mine.yaml"), 1.0), write=False)
        for name in ("one", "two")
    ]
    assert all(flown.outcome == "flown" for flown in rolls)
    assert rolls[0].metrics["leader_bank_deg"] == rolls[1].metrics["leader_bank_deg"]
    one, two = (build(load(tmp_path / name / "mine.yaml")).groups[0].law for name in ("one", "two"))
    assert type(one) is not type(two)


def test_where_a_law_cannot_be_found_it_says_where_to_put_it(tmp_path):
    assert "no module 'nowhere' (write a nowhere.py beside the page" in refusal(
        page(tmp_path, law="nowhere:Straight")
    )
    assert "has no class 'Curved' (it has" in refusal(page(tmp_path, law="mine:Curved"))
    with pytest.raises(InputError, match=r"there is no file .*gone\.py"):
        load(page(tmp_path, law="gone.py:Straight"))
    with pytest.raises(InputError, match="must be paper, or module:Class"):
        load(page(tmp_path, law="mine"))


def test_a_file_that_python_cannot_read_is_named(tmp_path):
    assert "mine.py cannot be imported: " in refusal(page(tmp_path, text="class Straight\n"))


def test_options_are_the_keywords_of_the_class(tmp_path):
    assert "unexpected keyword argument 'rolll'" in refusal(
        page(tmp_path, more=", options: {rolll: 1}")
    )


def test_methods_that_are_missing_are_named(tmp_path):
    text = "class Straight:\n    def __init__(self, team): ...\n"
    assert "Straight has no method start" in refusal(page(tmp_path, text=text))


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("return None, memory", "answered with NoneType at 0 s"),
        ("return memory", "must return two things from step"),
        (
            "return FbwaCommand(np.zeros(n + 1), np.zeros(n), np.zeros(n)), memory",
            "pitch is not an array of shape",
        ),
        (
            "return FbwaCommand(np.zeros(n), np.array([0.0, np.nan, 0.0]), np.zeros(n)), memory",
            "roll for uav2 is not a finite number",
        ),
        ("own.position_ned[0] = 0.0", "writes into what it is given"),
        ("inbox.stamp_s[0] = 0.0", "writes into what it is given"),
        ("self.count += 1; self.roll = 0.001 * self.count", "does not carry its memory as a value"),
        ("memory += 1.0", "does not carry its memory as a value"),
        (
            "self.roll = float(own.position_ned[:, 0].mean()) * 1e-3",
            "only uav2, uav3 know something else",
        ),
        (
            "self.roll = float(np.nan_to_num(inbox.velocity_ned[2, 0, 1])) * 1e-3",
            "only uav2, uav3 know something else",
        ),
        ("return UnicycleCommand(20.0, 0.0, 20.0, 0.5, 0), memory", "gives a direction of length"),
        ("1 / 0", "the law raised ZeroDivisionError: division by zero"),
    ],
)
def test_what_breaks_the_contract_is_refused_before_the_flight(tmp_path, body, says):
    assert says in refusal(page(tmp_path, body))


def test_an_error_of_the_law_is_told_with_its_line(tmp_path):
    path = page(tmp_path, "raise RuntimeError('no idea')")
    line = (tmp_path / "mine.py").read_text().split("raise")[0].count("\n") + 1
    assert f"mine.py:{line}: the law raised RuntimeError: no idea" in refusal(path)


def test_a_law_that_goes_wrong_in_flight_ends_the_run_with_its_time(tmp_path):
    path = page(tmp_path, "self.roll = np.nan if now > 2.0 else 0.0")
    with pytest.raises(InputError, match=r"roll for uav1 is not a finite number at 2\.04 s"):
        testbed.run(shorten(load(path), 4.0), write=False)


def test_sticks_do_not_fly_an_ideal_vehicle(tmp_path):
    said = refusal(page(tmp_path), "fleet.uav2.vehicle=ideal")
    assert "Straight commands fly-by-wire A, which an ideal vehicle cannot fly" in said
    assert "vehicle: jsbsim for uav2" in said


@pytest.mark.parametrize(
    "name", ["own-law-leader-follower", "own-law-integral", "own-law-repulsion"]
)
def test_the_examples_keep_the_contract_and_hold_a_formation(name):
    flown = testbed.run(shorten(load(name), 25.0), write=False)
    assert flown.outcome == "flown"
    assert all(flown.metrics["engaged_at_s"].values())


# of a hundred aircraft; vee-30 has the same law for thirty
LARGE = () if os.environ.get("TESTBED_LAWS") else ("vee-100",)


@pytest.mark.parametrize("name", [name for name in list_scenarios() if name not in LARGE])
def test_the_law_of_every_scenario_keeps_the_contract(name):
    for group in build(load(name)).groups:
        check_law(group.law, group.team)


def test_laws_fly_unsynchronised_too():
    page = load("own-law-integral", ["rates.synchronous=false"])
    world = build(page)
    assert len(world.groups) > 1
    assert testbed.run(shorten(page, 5.0), write=False).outcome == "flown"


def test_looking_at_the_one_before_in_the_list_is_found_too(tmp_path):
    body = "return FbwaCommand(np.zeros(n), np.r_[0.0, own.euler[:-1, 0]], np.zeros(n)), memory"
    said = refusal(page(tmp_path, body))
    assert "gives uav2 another roll when only uav1, uav3 know something else" in said


def test_messages_that_are_old_are_tried_too(tmp_path):
    body = "self.roll = np.nan if (now - np.nan_to_num(inbox.stamp_s, nan=now) > 1).any() else 0.0"
    assert "is not a finite number" in refusal(page(tmp_path, body))


def test_a_law_of_ones_own_is_told_and_logged_when_its_leader_is_silent(tmp_path):
    path = page(tmp_path, "assert self.team.silent_after == 1.5")
    changes = ["network.mute_s.leader=[[1, 4]]", "controller.silence.after_s=1.5"]
    flown = testbed.run(shorten(load(path, changes), 5.0), write=False)
    said = [(e["time_s"], e["source"]) for e in flown.metrics["events"] if e["level"] == "warning"]
    assert said == [(pytest.approx(2.48), name) for name in ("uav1", "uav2", "uav3")]
    assert flown.metrics["guards"]["uav1"]["by_kind"]["leader_silent"] > 0


def test_errors_while_a_law_is_made_are_the_laws(tmp_path):
    text = "import nothing_of_this_name\n"
    assert "mine.py:1: the law raised ModuleNotFoundError" in refusal(page(tmp_path, text=text))
    text = "class Straight:\n    def __init__(self, team):\n        {}['gain']\n"
    text += "    def start(self, own): ...\n    def step(self, now, own, inbox, memory): ...\n"
    assert "mine.py:3: the law raised KeyError: 'gain'" in refusal(page(tmp_path, text=text))


def meeting(places, now=10.0):
    """Three followers and a leader at these places (4, 3), northbound at 22 m/s and heard."""
    velocity = np.tile([22.0, 0.0, 0.0], (4, 1))
    still, speed = np.zeros((4, 3)), np.full(4, 22.0)
    truth = VehicleState(np.array(places, dtype=float), velocity, still, still, still, speed, speed)
    # what was heard is as old as it may be here: 0.1 s, in which they flew 2.2 m
    said = np.full((3, 4), now - 0.1)
    content = [np.tile(each, (3, 1, 1)) for each in (velocity, still, still, still)]
    heard = np.tile(truth.position_ned - 0.1 * velocity, (3, 1, 1))
    inbox = Inbox(said, said.copy(), heard, *content)
    return now, VehicleState(*(each[1:] for each in truth)), inbox


def repulsion():
    (group,) = build(load("own-law-repulsion")).groups
    return group.law


def stepped(law, meeting):
    now, own, inbox = meeting
    return law.step(now, own, inbox, law.start(own))


def same(ours, theirs):
    return all(np.array_equal(*pair, equal_nan=True) for pair in zip(ours, theirs, strict=True))


FAR = [[0, 0, -100], [-11, 20, -100], [-11, -9, -100], [-30, 0, -100]]  # 14 m apart and more


def test_beyond_the_radius_repulsion_is_the_papers_law_to_the_bit():
    law = repulsion()
    ours, memory = stepped(law, meeting(FAR))
    theirs, remembered = stepped(law.paper, meeting(FAR))
    assert same(ours, theirs)
    assert same(memory, remembered)


def test_within_the_radius_the_law_flies_from_a_position_moved_by_the_gain():
    law = repulsion()
    places = [*FAR[:2], [-7, 17, -100], FAR[3]]  # uav1 and uav2: 4 m and 3 m, 5 m apart
    now, own, inbox = meeting(places)
    ours, _ = law.step(now, own, inbox, law.start(own))
    towards = np.array([0.8, -0.6, 0.0])  # of uav2, as uav1 sees it; 7 m within the radius of 12 m
    told = own.position_ned.copy()
    told[0] += 4.0 * 7.0 * towards
    told[1] -= 4.0 * 7.0 * towards
    theirs, _ = stepped(law.paper, (now, own._replace(position_ned=told), inbox))
    for one, two in zip(ours, theirs, strict=True):
        assert one == pytest.approx(two, rel=1e-9, abs=1e-9)  # other roundings, nothing else
    plain, _ = stepped(law.paper, meeting(places))
    assert (ours.turn[:2] != plain.turn[:2]).any(axis=1).all()
    for one, two in zip(ours, plain, strict=True):
        assert np.array_equal(one[2], two[2])  # nobody is near uav3


def test_nobody_gives_way_to_news_that_is_missing_or_stale():
    law = repulsion()
    now, own, inbox = meeting([*FAR[:2], [-7, 17, -100], FAR[3]])
    old = inbox.received_s.copy()
    old[0, 2], old[1, 1] = np.nan, now - 1.01 * law.team.stale_after
    unheard = inbox.stamp_s.copy()
    unheard[0, 2] = np.nan
    changed = now, own, inbox._replace(received_s=old, stamp_s=unheard)
    assert same(stepped(law, changed)[0], stepped(law.paper, changed)[0])


def test_repulsion_keeps_two_apart_that_the_papers_law_leads_into_each_other():
    page = load("own-law-repulsion")
    ours = testbed.run(shorten(page, 12.0), write=False)
    assert ours.outcome == "flown"
    assert ours.metrics["min_separation_m"] > 6.0
    papers = ["controller.law=paper", "controller.options={}"]
    assert testbed.run(shorten(load(page.name, papers), 12.0), write=False).outcome == "lost"
    through = load(page.name, [*papers, "limits.collision_m=null"])  # each other
    theirs = testbed.run(shorten(through, 12.0), write=False)
    assert theirs.metrics["min_separation_between"] == ["uav1", "uav2"]
    assert theirs.metrics["min_separation_m"] < page.limits.collision_m
