"""Kept results: equal to the bit, made anew where a file is damaged or what they depend on differs.

The files themselves, their owners and their folders are those of test_kept_files.py.
"""

import json
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from testbed.core import compile as compile_module
from testbed.core import kept_results
from testbed.core.compile import KERNEL_PACKAGES
from testbed.core.kept_files import Place, open_kept_files
from testbed.core.kept_results import find_result, keep_result, machine_facts


class Pair(NamedTuple):
    first: float
    second: str = ""


@dataclass(frozen=True, slots=True)
class Result:
    number: float
    count: int
    is_right: bool
    text: str
    pairs: tuple[Pair, ...]
    triple: tuple[float, float, float]
    by_name: dict[str, tuple[str, ...]]
    array: NDArray[np.float64]
    flags: NDArray[np.bool_]
    missing: float | None = None


RESULT = Result(
    0.1 + 0.2,
    -3,
    True,
    "é \n",
    (Pair(-0.0, "a"), Pair(5e-324)),
    (math.inf, -math.inf, math.nan),
    {"one": ("a", "b"), "none": ()},
    np.array([[1 / 3, np.nan], [-0.0, 1e300]]),
    np.array([True, False]),
)


@pytest.fixture
def kept(tmp_path, monkeypatch):
    found = open_kept_files("kernels-0123456789abcdef", [Place(tmp_path)])
    monkeypatch.setattr(kept_results, "kept_files", lambda: found)
    return found


def bits(result):
    """All of a result, with the sign of zero and NaN."""
    arrays = result.array.tobytes(), result.array.shape, result.flags.tobytes()
    return repr(result), *arrays, type(result.pairs[0])


def counted(value):
    def make():
        make.calls += 1
        return value

    make.calls = 0
    return make


def test_result_is_read_to_the_bit(kept):
    make = counted(RESULT)
    first = find_result(Result, "some-thing", (1.0,), make)
    second = find_result(Result, "some-thing", (1.0,), make)
    assert make.calls == 1 and first is RESULT and second is not RESULT
    assert bits(second) == bits(RESULT)


def test_another_bit_is_another_result(kept):
    """Negative control of the test above."""
    moved = RESULT.array.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], 1.0)
    keep_result("some-thing", (1.0,), replace(RESULT, array=moved))
    found = find_result(Result, "some-thing", (1.0,), counted(RESULT))
    assert bits(found) != bits(RESULT)


def test_result_is_of_all_that_it_depends_on(kept, monkeypatch):
    """Arguments, name, versions of libraries, JSBSim's binary, processor, sources."""
    make = counted(1.0)
    find_result(float, "one", ("a", 1.0), make)
    for name, of in (("one", ("a", 1)), ("one", ("b", 1.0)), ("other", ("a", 1.0))):
        find_result(float, name, of, make)
    assert make.calls == 4
    monkeypatch.setattr(kept_results, "machine_facts", machine_facts.__wrapped__)
    find_result(float, "one", ("a", 1.0), make)
    assert make.calls == 4
    for what, other in (
        ("version", lambda _: "0.0"),
        ("_binaries", list),
        ("_processor", lambda: "another"),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(kept_results, what, other)
            before = make.calls
            find_result(float, "one", ("a", 1.0), make)
            assert make.calls == before + 1, what
    assert {"airframes", "compiled", "vehicle"} <= set(KERNEL_PACKAGES)


def test_facts_have_jsbsim_and_the_processor():
    facts = machine_facts()
    assert ("numpy", np.__version__) in facts
    assert any(isinstance(each, tuple) and "jsbsim" in str(each[0]).lower() for each in facts[4:])
    if Path("/proc/cpuinfo").exists():
        assert "flags" in facts[-1] or "Features" in facts[-1]
        assert "MHz" not in facts[-1], "the clock's rate changes"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"[1]",
        b"{",
        b'{"result": 1.0}',
        *(b'{"of": "%s", "result": ' + each + b"}" for each in (b"1", b'"1.0"', b"[1.0]", b"null")),
        b'{"of": "another", "result": 2.0}',
    ],
)
def test_foreign_content_is_made_anew(kept, content):
    """Whole by its checksum, and no such result."""
    make = counted(1.0)
    file, digest = kept_results._place("one", ("a",))
    kept.write(file, content.replace(b"%s", digest.encode()))
    assert find_result(float, "one", ("a",), make) == 1.0 and make.calls == 1
    assert find_result(float, "one", ("a",), make) == 1.0 and make.calls == 1  # replaced


def test_damaged_file_is_made_anew(kept):
    make = counted(RESULT)
    find_result(Result, "one", (), make)
    (path,) = Path(kept.folder).glob("result-*")
    content = path.read_bytes()
    for k, damaged in enumerate(
        (b"", content[:-1], content[: len(content) // 2], content[:-9] + b"x" + content[-8:])
    ):
        path.write_bytes(damaged)
        find_result(Result, "one", (), make)
        assert make.calls == k + 2
    find_result(Result, "one", (), make)
    assert make.calls == 5


def test_the_number_of_files_is_bounded(kept, monkeypatch):
    monkeypatch.setattr(kept_results, "_PLACES", 4)
    make = counted(1.0)
    for k in range(50):
        find_result(float, "one", (k,), make)
    assert len(os.listdir(kept.folder)) == 4
    assert all(compile_module._FILE_NAME.fullmatch(each) for each in os.listdir(kept.folder))


def test_error_is_not_kept(kept):
    def fail():
        raise ValueError("no such thing")

    for _ in range(2):
        with pytest.raises(ValueError, match="no such thing"):
            find_result(float, "one", (), fail)
    assert os.listdir(kept.folder) == []


def test_nothing_is_kept_without_a_folder(tmp_path, monkeypatch):
    nowhere = open_kept_files("kernels-0123456789abcdef", [])
    monkeypatch.setattr(kept_results, "kept_files", lambda: nowhere)
    make = counted(1.0)
    assert [find_result(float, "one", (), make) for _ in range(2)] == [1.0, 1.0]
    assert make.calls == 2


def test_what_is_kept_is_json(kept):
    find_result(Pair, "one", (), lambda: Pair(1.5, "x"))
    (path,) = Path(kept.folder).glob("result-*")
    text = path.read_bytes()[path.read_bytes().index(b'{"of"') :]  # behind a digest of any bytes
    assert json.loads(text)["result"] == [1.5, "x"]
