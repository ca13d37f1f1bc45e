"""Shell completion of names: scenarios, runs, studies, tunes, aircraft, and keys of --set.

Libraries are imported when a shell asks. A name without a match is left to the shell, which
completes files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

_MAX_DEPTH = 6  # sections in each other


def scenario_names(incomplete: str) -> list[str]:
    """Return the names of scenarios that begin like this."""
    from testbed.scenario import list_scenarios

    return _beginning(incomplete, list_scenarios())


def study_names(incomplete: str) -> list[str]:
    """Return the names of studies that begin like this."""
    from testbed.scenario import list_studies

    return _beginning(incomplete, list_studies())


def tune_names(incomplete: str) -> list[str]:
    """Return the names of tunes that begin like this."""
    from testbed.scenario import list_tunings

    return _beginning(incomplete, list_tunings())


def aircraft_names(incomplete: str) -> list[str]:
    """Return the names of airframes that begin like this."""
    from testbed.scenario import list_aircraft

    return _beginning(incomplete, list_aircraft())


def run_names(incomplete: str) -> list[str]:
    """Return scenarios that were flown from here, or the runs of one: simulation-3/2026…."""
    from testbed.logs.run_directory import LOGS, list_run_names

    with suppress(OSError):
        return _beginning(incomplete, list_run_names(LOGS, incomplete.rpartition("/")[0]))
    return []


def scenario_keys(incomplete: str) -> list[str]:
    """Return the keys of scenarios that begin like this: network.delay_s, fleet.*.sensors."""
    from testbed.scenario import json_schema

    schema = json_schema()
    return _beginning(incomplete, dict.fromkeys(_keys(schema, schema["$defs"])))


def _beginning(incomplete: str, names: Any) -> list[str]:  # noqa: ANN401 - any names
    return [name for name in names if name.startswith(incomplete)]


def _keys(
    schema: Mapping[str, Any], definitions: Mapping[str, Any], prefix: str = ""
) -> Iterator[str]:
    """Yield the dotted keys of a schema that hold values; a list or map of names has `*`."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rpartition("/")[2]]
    parts = [each for word in ("anyOf", "oneOf", "allOf") for each in schema.get(word, ())]
    if not any(word in schema for word in ("properties", "items")) and not parts and prefix:
        yield prefix[:-1]
    if prefix.count(".") >= _MAX_DEPTH:
        return
    for part in parts:
        yield from _keys(part, definitions, prefix)
    for name, part in schema.get("properties", {}).items():
        yield from _keys(part, definitions, f"{prefix}{name}.")
    for word in ("items", "additionalProperties"):
        if isinstance(schema.get(word), dict) and _has_keys(schema[word]):
            yield from _keys(schema[word], definitions, f"{prefix}*.")


def _has_keys(schema: Mapping[str, Any]) -> bool:
    return any(word in schema for word in ("$ref", "properties", "anyOf", "oneOf", "allOf"))
