"""The file of a result is data: strict keys, finite numbers, a bounded size."""

import copy
import json

import pytest

from testbed.benchmark.campaign import conditions, practice_seeds, pulse_seeds
from testbed.benchmark.cell import LOST_M
from testbed.benchmark.entry import open_entries
from testbed.benchmark.result import (
    MAX_BYTES,
    check_seeds,
    parse_result,
    read_result,
    to_document,
)
from testbed.benchmark.seeds import PRACTICE, rank_seeds, read_pulse
from testbed.benchmark.task import load_benchmark
from testbed.benchmark.verify import check_law, check_present
from testbed.core.errors import InputError


def cell(**changes):
    return {
        **{"task": "wind", "level": 1, "seed": 1, "outcome": "flown", "failure": "", "why": ""},
        **{"number_m": 1.5, "lost_at_s": None, "separation_joining_m": 9.0, "effort": 0.3},
        **{"separation_window_m": None, "saturated_s": 0.0, **changes},
    }


@pytest.fixture(scope="module")
def document():
    benchmark = load_benchmark()
    entry = open_entries(["hbh23"])[0]
    return {
        "schema": 1,
        "conditions": conditions(benchmark, practice_seeds()).model_dump(mode="json"),
        "entry": {
            **{"name": "hbh23", "digest": entry.digest, "law": "hbh23", "law_sha256": ""},
            **{"function": "", "set": {}, "tuning": None},
        },
        "gains": {},
        "cells": [cell(), cell(seed=2)],
        "messages": None,
        "margins": [],
        "cpu_s": 0.1,
        "command": "testbed benchmark verify hbh23.json --cell CELL",
    }


def parse(document):
    return parse_result(json.dumps(document).encode(), "result.json")


def changed(document, *path, value):
    found = copy.deepcopy(document)
    node = found
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return found


def test_a_result_is_read_as_it_was_written(document):
    result = parse(document)
    assert parse(to_document(result)) == result
    check_present(result, load_benchmark())
    check_law(result, open_entries(["hbh23"])[0].law)


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("cells", 0, "number_m"), float("nan"), "finite number"),
        (("cells", 0, "number_m"), float("inf"), "finite number"),
        (("cells", 0, "number_m"), -1.0, "greater than or equal to 0"),
        (("cells", 0, "number_m"), 51.0, "less than or equal to 50"),
        (("cells", 0, "number_m"), "1.5", "valid number"),
        (("cells", 0, "outcome"), "lost", "of a flight that was lost"),
        (("cells", 0, "failure"), "time", "does not fit the outcome"),
        (("cells", 1), cell(), "has a flight twice"),
        (("cells", 0, "code"), "import os", "Extra inputs are not permitted"),
        (("cells", 0, "task"), "../wind", "pattern"),
        (("cells", 0, "level"), 4, "less than or equal to 3"),
        (("cells", 0, "seed"), True, "valid integer"),
        (("entry", "name"), "../../x", "pattern"),
        (("entry", "law_sha256"), "abc", "pattern"),
        (("entry", "set"), {"controller.options.k": 1.0}, "are not the settings"),
        (("gains",), {"controller.law": 1.0}, "is not a key of a law"),
        (("gains",), {"controller.options.k": "os"}, "gains"),
        (("import",), "os", "Extra inputs are not permitted"),
        (("schema",), 2, "schema"),
        (("cells",), None, "cells"),
    ],
)
def test_what_is_no_result_is_refused(document, path, value, reason):
    with pytest.raises(
        InputError, match=r"result\.json: is no result of testbed benchmark"
    ) as error:
        parse(changed(document, *path, value=value))
    assert reason in str(error.value)


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'"x"', b"[" * 100_000, b"\xff\xfe"])
def test_what_is_no_json_is_refused(data):
    with pytest.raises(InputError, match=r"result\.json: is no result"):
        parse_result(data, "result.json")


def test_a_large_file_is_refused_unread(tmp_path):
    path = tmp_path / "result.json"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(InputError, match="is larger than"):
        read_result(path)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("code", "flight"), "0" * 12),
        (("pins", "numpy"), "1.0"),
        (("limits", "cpu_s"), 10**6),
        (("benchmark_digest",), "0" * 64),
    ],
)
def test_other_code_pins_or_limits_are_not_repeated(document, path, value):
    result = parse(changed(document, "conditions", *path, value=value))
    with pytest.raises(InputError, match=f"was flown with {'.'.join(path)}"):
        check_present(result, load_benchmark())


def test_seeds_are_those_that_follow(document):
    seeds = changed(document, "conditions", "seeds", "values", value=[3, 4, 9])
    with pytest.raises(InputError, match="has other seeds than those of its practice"):
        check_seeds(parse(seeds))


def test_seeds_of_ranks_follow_from_entries_and_pulse(document):
    """Neither the order of entries nor the form of the pulse changes them; anything else does."""
    benchmark = load_benchmark()
    entries = open_entries(["hbh23", "leader-follower"])
    pulse = read_pulse("0xABCDEF0123456789")
    record = pulse_seeds(benchmark, entries, pulse)
    assert record == pulse_seeds(benchmark, entries[::-1], read_pulse(" abcdef0123456789 "))
    assert len(set(record.values)) == len(PRACTICE)
    name = f"{benchmark.name} {benchmark.digest}"
    digests = [each.digest for each in entries]
    others = (
        rank_seeds(name, digests, "abcdef012345678a"),
        rank_seeds(name, digests[:1], pulse),
        rank_seeds("formation-bench 1.1", digests, pulse),
    )
    assert not {record.values[0]} & {each[0] for each in others}
    good = changed(document, "conditions", "seeds", value=record.model_dump(mode="json"))
    check_seeds(parse(good))
    assert check_seeds(parse(good)) is None
    forged = changed(good, "conditions", "seeds", "pulse", value="abcdef012345678a")
    with pytest.raises(InputError, match="has other seeds than those of its pulse"):
        check_seeds(parse(forged))
    alone = pulse_seeds(benchmark, entries[1:], pulse).model_dump(mode="json")
    with pytest.raises(InputError, match="the seeds were drawn for other entries"):
        check_seeds(parse(changed(document, "conditions", "seeds", value=alone)))


@pytest.mark.parametrize("text", ["", "xyz", "abc", "g" * 16, "1" * 2000])
def test_a_pulse_is_hexadecimal(text):
    with pytest.raises(InputError, match="--pulse"):
        read_pulse(text)


def test_a_lost_flight_counts_in_full(document):
    lost = cell(outcome="lost", number_m=LOST_M, why="lost: uav1 at 3.0 s", lost_at_s=3.0)
    assert parse(changed(document, "cells", 0, value=lost)).cells[0].number_m == LOST_M
