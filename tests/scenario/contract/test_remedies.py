"""The remedies of error texts are tried: what an error says to write is written.

Of each wrong scenario of tests/data/wrong_scenarios the text in parentheses at the end of each
error is read as an instruction and applied to the scenario, which must then be accepted or have
another error. The snapshot has how many are tried, and those that are no instruction which can be
applied by rule: they name no value, or a place elsewhere.
"""

import collections
import copy
import re

import pytest
from places import TESTS
from snapshot import check_snapshot

from testbed.core.numbers import parse_number
from testbed.scenario import ScenarioError, loads
from testbed.scenario.yaml_io import parse, plain, write

FOLDER = TESTS / "data"
CASES = sorted(
    path.stem
    for path in (FOLDER / "wrong_scenarios").glob("*.txt")
    if path.stem not in ("files", "settings")  # whole texts, and --set
)
NUMBER = r"(-?[\d,]*\.?\d+(?:e-?\d+)?)"
WORD = r"[\w.*+:/-]+"
FORMS = {
    "[from, to] in s": [1, 2],
    "[lowest, highest] in m/s, both above 0": [16, 26],
    "[shortest, longest], both above 0": [0.1, 0.2],
    "[behind, beside, below] in m": [10, 5, 0],
    "a map of keys and values": {},
    "a list": [],
    "[forward, right, down] in m": [-30, 20, 10],
    "a number": 1,
    "a finite number": 1,
    "a whole number": 3,
    "a probability": 0.1,
    "text": "x",
}
ABSENT = object()
VAGUE = {"less", "more", "another", "others", "fewer", "them"}


def value_of(text):
    """Return the value that a remedy names, or ABSENT."""
    text = text.partition("; ")[0]  # what follows describes the key
    text = re.sub(r",? (?:or|as) (?:another|an?|a larger|a smaller|\w+:) ?.*$|, as .*$", "", text)
    text = re.sub(r", for example.*$", "", text).removeprefix("a rate_hz of ")
    if text.startswith("{"):
        return plain(parse(re.match(r"\{[^}]*\}", text)[0], "remedy", FOLDER))
    for form, value in FORMS.items():
        if text == form or text.startswith(f"{form},"):
            return value
    for pattern, value in (
        (rf"(?:a number |one )?at (?:least|most) {NUMBER}$", lambda n: n),
        (rf"(?:a number |one )?above {NUMBER}$", lambda n: 1.5 * n + (n == 0)),
        (rf"(?:a number |one )?below {NUMBER}$", lambda n: 0.5 * n),
        (rf"{NUMBER}(?:, without .*)?$", lambda n: n),
    ):
        if found := re.match(pattern, text):
            return value(parse_number(found[1].replace(",", "")))
    if found := re.match(rf"(?:one of )?({WORD})(?:(?:, {WORD})* or {WORD}|(?:, {WORD})*)$", text):
        words = {"true": True, "false": False, **dict.fromkeys(VAGUE, ABSENT)}
        return words.get(found[1], found[1])
    return ABSENT


def place(document, path):
    """Return the map or list that has the last key of a path, made where it is missing."""
    for key in path[:-1]:
        if isinstance(document, list):
            document = document[int(key)]
        else:
            if not isinstance(document.get(key), dict | list):
                document[key] = {}
            document = document[key]
    return document


def put(document, path, value):
    """Write a value, or take the key away."""
    inside = place(document, path)
    key = int(path[-1]) if isinstance(inside, list) else path[-1]
    if value is not ABSENT:
        inside[key] = copy.deepcopy(value)
    else:
        del inside[key]


def apply(document, problem):
    """Apply the remedy of a problem to a scenario; return whether it has one that can be."""
    if not problem.path or "*" in problem.path:
        return False
    near = re.search(r"did you mean '([^']+)'", problem.text)
    if near:
        inside, key = place(document, problem.path), problem.path[-1]
        if isinstance(inside, list):
            inside[int(key)] = near[1]
        elif isinstance(inside[key], str) and "is not a key" not in problem.text:
            inside[key] = near[1]
        else:
            inside[near[1]] = inside.pop(key)
        return True
    found = re.search(r"\((write |leave )(.*)\)$", problem.text)
    if found is None:
        return False
    verb, text = found.groups()
    if re.search(r"or leave this out", text):
        put(document, problem.path, ABSENT)
        return True
    if verb == "leave ":
        alone = re.match(r"(?:this|it|this key|one of them|one|the fault) out|out this", text)
        if alone:
            put(document, problem.path, ABSENT)
        return bool(alone)
    if "is not a key of this section" in problem.text:
        inside, new = place(document, problem.path), re.match(rf"one of ({WORD})", text)[1]
        inside[new] = inside.pop(problem.path[-1])
        return True
    if pair := re.match(rf"(\w+): ({WORD}|\[[^\]]*\](?: in m)?)(?:; .*|, .*| or .*)?$", text):
        key, value = pair[1], value_of(pair[2])
        if value is ABSENT:
            return False
        inside = place(document, (*problem.path, key))
        if not isinstance(inside, dict):
            return False
        own = inside.get(key) is None and key not in problem.path
        put(document, (*problem.path[: None if own else -1], key), value)
        return True
    value = value_of(text)
    if value is not ABSENT:
        put(document, problem.path, value)
    return value is not ABSENT


def problems_of(document):
    """Return the problems of a scenario on top of minimal.yaml."""
    try:
        loads(write({"extends": "minimal.yaml", **document}), source="case.yaml")
    except ScenarioError as error:
        return error.problems
    return ()


def test_remedies_of_wrong_scenarios_are_tried(monkeypatch):
    """A remedied scenario is accepted, or has another error at that place."""
    monkeypatch.chdir(FOLDER / "scenarios")
    count, untried, wrong = collections.Counter(), [], []
    for section in CASES:
        for case in (FOLDER / "wrong_scenarios" / f"{section}.txt").read_text().split("\n\n"):
            try:
                document = plain(parse(case, "case.yaml", FOLDER))
            except ScenarioError:
                continue  # no YAML
            before = problems_of(document)
            for problem in before:
                remedied = copy.deepcopy(document)
                try:
                    applied = apply(remedied, problem)
                except (KeyError, IndexError, TypeError, ValueError, AttributeError):
                    applied = False
                if not applied:
                    untried.append(f"{'.'.join(problem.path)}: {problem.text}")
                    continue
                after = {(each.path, each.text) for each in problems_of(remedied)}
                if (problem.path, problem.text) in after:
                    wrong.append(f"{case.strip()}\n  {problem}\n  {remedied}")
                count["accepted" if not after else "another error"] += 1
    assert not wrong, "\n".join(wrong)
    untried = [each.replace(str(FOLDER.parents[1]), ".") for each in untried]
    check_snapshot(
        "remedies",
        "\n".join(
            [*(f"{name}: {n}" for name, n in sorted(count.items())), f"not tried: {len(untried)}"]
            + untried
        ),
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a number at least 0.5", 0.5),
        ("a number above 0", 1.0),
        ("a number below 10", 5.0),
        ("one of vee, column", "vee"),
        ("stop or continue", "stop"),
        ("false", False),
        ("[from, to] in s", [1, 2]),
        ("25, or another physics_hz", 25.0),
        ("0.1, for example, in 1/s", 0.1),
        ("{max: 1}, or max or min as the key", {"max": 1}),
        ("another start", ABSENT),
        ("less, or a longer delay_s", ABSENT),
    ],
)
def test_remedies_are_read(text, value):
    assert value_of(text) is value or value_of(text) == value
