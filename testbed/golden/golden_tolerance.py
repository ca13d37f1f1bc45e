"""How far numbers may be from their golden table: by rule, by the scenario's `expect`, or as asked.

A tolerance that is asked for limits the side that it names. The other side is free if numbers there
are better, and keeps the tolerance of the rule if they are worse.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from testbed.core.errors import InputError
from testbed.core.numbers import parse_number, parse_percent
from testbed.golden.golden_table import RULES, Rule
from testbed.scenario.problems import did_you_mean

Change = float | str  # in the unit of the quantity, or a percentage such as 5%
SIDES = ("not_above", "not_below")


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Tolerances of the numbers of a scenario, beside those of `RULES`.

    Args:
        options: by quantity, of numbers that get worse; "" stands for every other quantity.
        expect: of the scenario, as plain data.
    """

    options: Mapping[str, Change] = field(default_factory=dict)
    expect: Mapping[str, Any] = field(default_factory=dict)

    def limits(
        self, key: str, golden: float, low: float | None = None, high: float | None = None
    ) -> tuple[float, float]:
        """Return the lowest and the highest number that passes; infinite where all do.

        Args:
            key: of the row.
            golden: its number in the table.
            low: without a tolerance; None: that of the rule.
            high: the same.
        """
        quantity, *where = key.split("/")
        rule = RULES[quantity]
        allowed = rule.allowed(golden)
        low = golden - allowed if low is None else low
        high = golden + allowed if high is None else high
        given = dict(self._given(rule, quantity, where))
        if not given:
            return low, high
        above, below = (
            min((_amount(each, golden) for each in given.get(side, ())), default=None)
            for side in SIDES
        )
        if above is not None:
            high = max(high, golden + above)
        elif rule.better == "higher":
            high = math.inf
        if below is not None:
            low = min(low, golden - below)
        elif rule.better == "lower":
            low = -math.inf
        return low, high

    def _given(
        self, rule: Rule, quantity: str, where: Sequence[str]
    ) -> Iterator[tuple[str, Sequence[Change]]]:
        """Yield the sides with tolerances: of the options, else the most specific of `expect`."""
        option = self.options.get(quantity, self.options.get(""))
        if option is not None:
            yield ("not_above" if rule.better == "lower" else "not_below"), [option]
            return
        names = [(*where,)] if len(where) > 1 else []
        for side in SIDES:
            for level in (names, [(name,) for name in where], [()]):
                found = [_at(self.expect, (quantity, *each, side)) for each in level]
                if known := [each for each in found if each is not None]:
                    yield side, known
                    break


def _amount(change: Change, golden: float) -> float:
    """Return a change in the unit of the quantity."""
    if isinstance(change, str):
        percent = parse_percent(change)
        assert percent is not None  # as it has been checked
        return 0.01 * percent * abs(golden)
    return change


def _at(bounds: Mapping[str, Any], key: Sequence[str]) -> Change | None:
    value: Any = bounds
    for name in key:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value if isinstance(value, float | str) else None


def parse_tolerances(texts: Sequence[str]) -> dict[str, Change]:
    """Read texts `5%`, for every quantity, and `QUANTITY=5%` or `QUANTITY=0.1`, in its unit.

    Raises:
        InputError: one is not of this form, or names no quantity.
    """
    found: dict[str, Change] = {}
    for text in texts:
        quantity, equals, value = text.rpartition("=")
        percent, number = parse_percent(value), parse_number(value)
        known = ", ".join(RULES)
        if equals and quantity not in RULES:
            hint = did_you_mean(quantity, RULES)
            raise InputError(
                f"--tolerance {text}: golden tables have no {quantity!r}{hint} (write one of "
                f"{known})"
            )
        if percent is not None and percent >= 0.0:
            change: Change = value
        elif equals and number is not None and number >= 0.0:
            change = number
        else:
            raise InputError(
                f"--tolerance {text}: write 5% for all numbers, or QUANTITY=5% or QUANTITY=0.1, "
                f"in its unit, for one of {known}"
            )
        if quantity in found:
            raise InputError(f"--tolerance {text}: is the second one of its kind; write one")
        found[quantity] = change
    return found
