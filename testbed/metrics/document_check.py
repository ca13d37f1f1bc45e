"""Check of a metrics document from a log before it is used."""

from __future__ import annotations

from functools import cache

from pydantic import TypeAdapter, ValidationError

from testbed.core.data_errors import describe_first
from testbed.core.errors import InputError
from testbed.core.flags import LimiterFlag, Saturation, flag_names
from testbed.core.records import RunInfo
from testbed.metrics.document import OUTCOMES
from testbed.metrics.facts import facts
from testbed.metrics.model import Metrics
from testbed.metrics.printed_tables import (
    arrival_tables,
    error_tables,
    follower_tables,
    published_mean,
    published_note,
    worst_followers,
    worst_links,
)
from testbed.metrics.summary import SCHEMA


def check_metrics(document: Metrics, info: RunInfo, where: str) -> None:
    """Check that a document has the keys and types of this version, for this run.

    Args:
        document: of metrics.json.
        info: of the run.
        where: file of the document, for the error.

    Raises:
        InputError: naming the first wrong value.
    """
    names = {
        "names": info.names,
        "followers": info.names[1:],
        "windows": tuple(info.windows),
        "limiter_flags": flag_names(LimiterFlag),
        "saturations": flag_names(Saturation),
    }
    # an empty map stands for no external programs
    given = {key: value for key, value in document.items() if value or key not in _EXTERNAL}
    try:
        schema = document.get("schema", SCHEMA)
        if type(schema) is int and schema != SCHEMA:
            raise ValueError(f"schema: is {schema}; this version reads {SCHEMA}")
        metrics = _adapter().validate_python(given, strict=True, context=names)
        outcome, closest = metrics["outcome"], metrics["min_separation_between"]
        if outcome is not None and outcome not in OUTCOMES:
            raise ValueError(f"outcome: is none of {', '.join(OUTCOMES)}")
        if closest is not None and not (len(closest) == 2 and set(closest) <= {*info.names}):
            raise ValueError("min_separation_between: are not two aircraft of the run")
        try:
            _render(metrics, info)
        except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
            raise ValueError(f"its values contradict each other ({error!r})") from error
    except ValidationError as error:
        raise InputError(f"{where}: metrics.json: {describe_first(error)}") from None
    except ValueError as error:
        raise InputError(f"{where}: metrics.json: {error}") from error


_EXTERNAL = ("pace", "mavlink", "arduplane", "commanded", "expect")


@cache
def _adapter() -> TypeAdapter[Metrics]:
    return TypeAdapter(Metrics)


def _render(document: Metrics, info: RunInfo) -> None:
    """Make all texts: numbers that contradict each other show here, as null beside a count."""
    facts(document)
    followers = info.names[1:]
    if followers:
        follower_tables(document, followers)
        error_tables(document, worst_followers(document))
    published_note(document)
    for window in document["windows"]:
        published_mean(document, window)
    if document["network"]:
        arrival_tables(worst_links(document["network"]["links"]), document["network"]["all"])
    if document["min_separation_between"] and document["min_separation_m"] is None:
        raise ValueError("min_separation_m")
