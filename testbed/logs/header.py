"""The header of a log: what is known about a run before its first sample."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from testbed.core.input_files import parse_json_map
from testbed.core.records import Origin, RunInfo
from testbed.core.shape import Each, ListOf, Number, check_shape
from testbed.core.start_time import MAX_START_NS
from testbed.logs.messages import LOG_SCHEMA

METADATA_NAME = "testbed"
INFO_NAME = "run.json"  # attached: the RunInfo
CODE_SUFFIX = ".py"  # of attached user code
_NUMBER, _ANY_NUMBER = Number(), Number(finite=False)
_RATE = Number(whole=True, least=1, most=100_000)
_SHAPE: Mapping[str, Any] = {
    "scenario_name": str,
    "names": ListOf(str),
    "aircraft": ListOf(str),
    "wingspan_m": ListOf(_NUMBER),
    "origin": {each.name: _NUMBER for each in dataclasses.fields(Origin)},
    "base_rate_hz": _RATE,
    "sample_rate_hz": _RATE,
    "duration_s": Number(least=0.0),
    "seed": Number(whole=True, least=0),
    "speed_bounds_mps": ListOf(ListOf(_ANY_NUMBER, 2)),
    "kappa_mps": ListOf(_ANY_NUMBER),
    "roll_limit_rad": ListOf(_ANY_NUMBER),
    "leader_path_ned": ListOf(ListOf(_ANY_NUMBER, 3)),
    "windows": Each(ListOf(_NUMBER, 2)),
    "versions": Each(str),
    "bounded_in_ned": ListOf(_NUMBER, 3),
    "barriers": ListOf(ListOf(_NUMBER, 2)),
    "barrier_samples": ListOf(ListOf(_NUMBER)),
    "estimated": bool,
    "start_unix_ns": Number(whole=True, least=0, most=MAX_START_NS),
    "integrators": Each(str),
}
_TUPLES = ("names", "aircraft", "wingspan_m", "kappa_mps", "roll_limit_rad", "bounded_in_ned")


def metadata(info: RunInfo) -> dict[str, str]:
    """Collect the metadata record: log schema, scenario, seed, versions, step rate, integrators."""
    return {
        "log_schema": str(LOG_SCHEMA),
        "scenario": info.scenario_name,
        "scenario_sha256": hashlib.sha256(info.scenario_yaml.encode()).hexdigest(),
        "seed": str(info.seed),
        **{f"version.{name}": value for name, value in info.versions.items()},
        "base_rate_hz": str(info.base_rate_hz),
        **{f"integrator.{name}": value for name, value in info.integrators.items()},
    }


def to_json(info: RunInfo) -> str:
    """Encode a RunInfo without its directory, and without what has attachments of its own."""
    values: dict[str, Any] = {
        field.name: getattr(info, field.name)
        for field in dataclasses.fields(info)
        if field.name not in ("directory", "scenario_yaml", "code")
    }
    values["origin"] = dataclasses.asdict(info.origin)
    values["leader_path_ned"] = np.asarray(info.leader_path_ned).tolist()
    values["windows"] = dict(info.windows)
    values["versions"] = dict(info.versions)
    values["integrators"] = dict(info.integrators)
    return json.dumps(values, ensure_ascii=False)


def from_json(text: str, *, scenario_yaml: str, code: Mapping[str, bytes]) -> RunInfo:
    """Decode what `to_json` encodes.

    Raises:
        ValueError: The text is not JSON, or a field is missing, unknown or of another type or size.
    """
    try:
        early: dict[str, Any] = {"barrier_samples": [], "integrators": {}}  # early logs have none
        values = early | parse_json_map(text)
        _check(values)
    except ValueError as error:
        raise ValueError(f"{INFO_NAME}: {error}") from None
    values["origin"] = Origin(**values["origin"])
    path = np.array(values["leader_path_ned"], dtype=np.float64)
    values["leader_path_ned"] = path.reshape(-1, 3)
    for name in ("speed_bounds_mps", "barriers", "barrier_samples"):
        values[name] = tuple(map(tuple, values[name]))
    values["windows"] = {name: tuple(span) for name, span in values["windows"].items()}
    values |= {name: tuple(values[name]) for name in _TUPLES}
    return RunInfo(scenario_yaml=scenario_yaml, code=dict(code), **values)


def _check(values: Mapping[str, Any]) -> None:
    """Check the fields of a RunInfo.

    Raises:
        ValueError: naming the first wrong one.
    """
    check_shape(values, _SHAPE)
    unknown = values.keys() - _SHAPE.keys() | values["origin"].keys() - _SHAPE["origin"].keys()
    if unknown:
        raise ValueError(f"{min(unknown)[:60]}: is an unknown field")
    names = values["names"]
    if not names or len(set(names)) < len(names):
        raise ValueError("names: is empty or has repeated names")
    n = len(names) - 1
    sizes = {"aircraft": n + 1, "wingspan_m": n + 1, "speed_bounds_mps": n, "kappa_mps": n}
    for name, size in (sizes | {"roll_limit_rad": n}).items():
        if len(values[name]) != size:
            raise ValueError(f"{name}: has {len(values[name])} elements, not {size}")
    for name in ("barriers", "barrier_samples"):
        if len(values[name]) not in (0, n):
            raise ValueError(f"{name}: has {len(values[name])} elements, not {n}")
