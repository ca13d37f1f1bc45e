"""Functions and components with the literals of real files: compiled as in JSBSim, to the bit.

A sample of them on some arguments; all of them on 100,000 with TESTBED_LITERALS=100000.
"""

import os
import re

import numpy as np
import pytest
from compiled_literals import (
    FILTERS,
    LINE_PARTS,
    ONE,
    OWN_COMPONENTS,
    TWO,
    Both,
    X,
    arguments_of,
    components,
    differing,
    functions,
    literals,
    value,
)

from testbed.compiled import functions as translator
from testbed.compiled.components import _COMPONENTS
from testbed.compiled.frame import pressure
from testbed.core.compile import is_interpreted

COUNT = int(os.environ.get("TESTBED_LITERALS", "1000"))
WHOLE = COUNT >= 100_000
LARGEST = 15_000  # characters of functions that are compiled at once
PLAIN = "product sum difference quotient lt gt le ge eq nq min max"  # of which a sample is enough

pytestmark = pytest.mark.skipif(is_interpreted(), reason="what a compiler does is tested")


def sampled(texts, every):
    return texts if WHOLE else texts[::every]


def parts(texts):
    """Yield functions in parts, as a compiler takes longer for all of them at once."""
    part = {}
    for name, text in texts.items():
        part[name] = text
        if sum(map(len, part.values())) > LARGEST or text == [*texts.values()][-1]:
            yield part
            part = {}


def test_functions_equal_jsbsim(tmp_path, monkeypatch):
    """With NaN, infinities, both zeros, denormals and breakpoints among the arguments."""
    monkeypatch.setattr(translator, "_LINE_PARTS", LINE_PARTS)
    made = functions()
    simple = [name for name in made if name.split()[0] in PLAIN.split() and " at " in name]
    left_out = set(simple) - set(sampled(simple, 120))
    arguments, compared = arguments_of(COUNT, special=True), 0
    for number, part in enumerate(parts({k: v for k, v in made.items() if k not in left_out})):
        both = Both(tmp_path / str(number), part, [])
        ours, chosen = both.compiled(arguments)
        assert len(chosen) == len(both.names)
        different = differing(ours, both.jsbsim(arguments))
        found = dict(zip(both.names, different.tolist(), strict=True))
        assert found == dict.fromkeys(both.names, 0)
        compared += len(chosen)
    assert compared > 80


def test_all_functions_of_the_translator_are_compared():
    made = " ".join(functions().values())
    tags = (*translator._INFIX, *translator._COMPARE, *translator._MATH, *translator._PAIRS)
    for tag in (*tags, *translator._OTHERS, "and", "or", "min", "max", "ifthen", "table"):
        assert f"<{tag}>" in made, tag
    powers = literals()["pow", 1]
    assert {2.0, 0.5, 4.0, 0.33333, -1.0} <= set(powers)
    assert set(f"{ONE} {TWO}".split()) <= {text.split()[0] for text in functions()}


def test_components_equal_jsbsim(tmp_path):
    """One after the other in time, and filters keep their states."""
    made = components()
    chosen = made[: len(OWN_COMPONENTS)] + sampled(made[len(OWN_COMPONENTS) :], 48)
    both = Both(tmp_path, {}, chosen)
    arguments = arguments_of(COUNT, special=False)
    arguments[:, 0] = np.clip(arguments[:, 0], -1e6, 1e6)  # states stay where they are exact
    ours, translated = both.compiled(arguments)
    assert set(range(len(OWN_COMPONENTS))) <= set(translated)
    assert len(translated) > 0.8 * len(chosen)  # JSBSim flies the others
    different = differing(ours, both.jsbsim(arguments)[:, translated])
    names = [both.names[k] for k in translated]
    assert {n: d for n, d in zip(names, different.tolist(), strict=True) if d} == {}
    tags = {re.match(r"<(\w+)", name)[1] for name in components()}
    assert set(FILTERS.split()) <= tags
    assert set(_COMPONENTS) - tags <= {
        "fcs_function",
        "switch",
    }  # of which the functions are tested


FAULTS = {
    # name: a function, and what a translator could write in its place
    "a power that the compiler knows": (
        f"<pow>{X}{value(2)}</pow>",
        r"power_of\((\w+), 2\.0, one\)",
        r"pow(\1, 2.0)",
    ),
    "a root in place of a power": (
        f"<pow>{X}{value(0.5)}</pow>",
        r"power_of\((\w+), 0\.5, one\)",
        r"sqrt(\1)",
    ),
    "another order of a factor": (
        f"<toradians>{X}</toradians>",
        r"\((\w+) \* pi / 180\.0\)",
        r"(\1 * (pi / 180.0))",
    ),
    "another logarithm": (
        f"<log2>{X}</log2>",
        r"\(logarithm_10\((\w+)\) \* [\d.]+\)",
        r"(log2(\1) if \1 > 0.0 else -inf)",
    ),
    "a product with the inverse": (
        f"<difference>{X}<quotient>{X}{value(3)}</quotient></difference>",
        r"\((\w+) / (\w+) if \w+ != 0\.0 else inf\)",
        r"(\1 * (1.0 / \2))",
    ),
    "another order of a table": (
        f"<interpolate1d>{X}{value(-3)}{value(0.1)}{value(3)}{value(0.4)}</interpolate1d>",
        r"\((\w+) - (\w+)\) \* \((\w+) - (\w+)\) / \((\w+) - (\w+)\)",
        r"(\1 - \2) / (\5 - \6) * (\3 - \4)",
    ),
}


def test_planted_faults_of_one_ulp_are_found(tmp_path):
    """Each of them differs in the last bits."""
    both = Both(tmp_path, {name: text for name, (text, *_) in FAULTS.items()}, [])

    def plant(text):
        for _, right, wrong in FAULTS.values():
            text, count = re.subn(right, wrong, text, count=1)
            assert count == 1, right
        return text

    arguments = arguments_of(max(COUNT, 5_000), special=False)
    theirs = both.jsbsim(arguments)
    ours, _ = both.compiled(arguments, plant)
    assert (differing(ours, theirs) > 0).all()
    plain = np.isfinite(ours).all(axis=1) & np.isfinite(theirs).all(axis=1)
    one, other = ours[plain], theirs[plain]
    ulps = np.abs(one - other) / np.spacing(np.abs(other))
    assert ulps[: len(ulps) // 3].max() <= 8
    right, _ = both.compiled(arguments)
    assert (differing(right, theirs) == 0).all()


def test_pressure_has_the_power_of_the_c_library():
    """The only power of the frame, of a known exponent."""
    heights = np.random.default_rng(1).uniform(-2_000.0, 65_000.0, COUNT).tolist()
    python = pressure.py_func  # whose `pow` is the C library's
    assert [pressure(each, 9.0) for each in heights] == [python(each, 9.0) for each in heights]
