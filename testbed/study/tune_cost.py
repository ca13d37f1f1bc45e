"""What a flight costs a search, and what the flights of one set of gains cost together.

A metric counts as it is up to a bound B, and beyond it as B (2 - B / value), which is as steep
there and stays below 2 B. An aircraft that is lost or upset costs 2 B and up to B more the earlier
it was; a flight that gives no number costs 3 B. So any loss is worse than any flight without one, a
later loss is better than an early one, and no number runs away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from testbed.metrics.document import errors
from testbed.scenario.fields import NotNegative, Number, Section

Metrics = Mapping[str, Any]
FACTOR = 10.0  # of the worst flight with the gains as they were: the bound where the page has none
Share = Number


class MeanPlusSd(Section):
    """Mean plus so many standard deviations."""

    mean_plus_sd: NotNegative


class Quantile(Section):
    """A quantile, 0 to 1."""

    quantile: Share


Robust = Literal["worst", "mean"] | MeanPlusSd | Quantile


def number_at(metrics: Metrics, path: str) -> float | None:
    """The number of a metrics document at a dotted path; None where there is none."""
    node: Any = metrics
    for part in path.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return None
        node = node[part]
    known = isinstance(node, int | float) and not isinstance(node, bool)
    return float(node) if known and math.isfinite(node) else None


def sound(metrics: Metrics | None, metric: str) -> float | None:
    """The metric of a flight to its end with everybody; None of any other."""
    if metrics is None or metrics["outcome"] != "flown":
        return None
    return number_at(metrics, metric)


def cost(metrics: Metrics | None, metric: str, *, duration_s: float, bound: float) -> float:
    """What one flight costs, 0 to 3 bounds.

    Args:
        metrics: the document of metrics.json; None of a flight that failed.
        metric: path in metrics.json; smaller is better, none is below 0.
        duration_s: of the flight as planned.
        bound: B, above 0.
    """
    value = sound(metrics, metric)
    if value is not None:
        return value if value <= bound else bound * (2.0 - bound / value)
    if metrics is None or metrics["outcome"] not in ("lost", "upset"):
        return 3.0 * bound
    wrong = [at for at in metrics["lost_at_s"].values() if at is not None]
    if metrics["outcome"] == "upset":
        wrong += [at for at, _ in errors(metrics)]
    held = min(wrong) / duration_s if wrong else 0.0
    return bound * (3.0 - min(max(held, 0.0), 1.0))


def together(costs: Sequence[float], robust: Robust) -> float:
    """What the flights of one set of gains cost together."""
    values = np.array(costs)
    if robust == "worst":
        return float(values.max())
    if isinstance(robust, Quantile):
        return float(np.quantile(values, robust.quantile))
    spread = float(values.std(ddof=1)) if values.size > 1 else 0.0
    weight = robust.mean_plus_sd if isinstance(robust, MeanPlusSd) else 0.0
    return float(values.mean()) + weight * spread


def said(robust: Robust) -> str:
    """In words."""
    if isinstance(robust, Quantile):
        return f"the {100.0 * robust.quantile:g} % quantile"
    if isinstance(robust, MeanPlusSd):
        return f"the mean plus {robust.mean_plus_sd:g} standard deviations"
    return f"the {robust}"
