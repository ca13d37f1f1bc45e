"""The header of a log: what is known about a run before its first sample."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from testbed.core.records import Origin, RunInfo
from testbed.logs.messages import LOG_SCHEMA

METADATA_NAME = "testbed"
INFO_NAME = "run.json"  # attached: the RunInfo
CODE_SUFFIX = ".py"  # of attached user code
_TUPLES = ("names", "aircraft", "wingspan_m", "kappa_mps", "roll_limit_rad", "bounded_in_ned")


def metadata(info: RunInfo) -> dict[str, str]:
    """Collect the metadata record: log schema, scenario, seed and versions."""
    return {
        "log_schema": str(LOG_SCHEMA),
        "scenario": info.scenario_name,
        "scenario_sha256": hashlib.sha256(info.scenario_yaml.encode()).hexdigest(),
        "seed": str(info.seed),
        **{f"version.{name}": value for name, value in info.versions.items()},
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
    return json.dumps(values, ensure_ascii=False)


def from_json(text: str, *, scenario_yaml: str, code: Mapping[str, bytes]) -> RunInfo:
    """Decode what `to_json` encodes.

    Raises:
        ValueError: The text is not JSON, or a field is missing, unknown or of another type.
    """
    try:
        values = json.loads(text)
        values["origin"] = Origin(**values["origin"])
        path = np.array(values["leader_path_ned"], dtype=np.float64)
        values["leader_path_ned"] = path.reshape(-1, 3)
        bounds = values["speed_bounds_mps"]
        values["speed_bounds_mps"] = tuple((float(low), float(high)) for low, high in bounds)
        values["windows"] = {
            str(name): (float(start), float(end))
            for name, (start, end) in values["windows"].items()
        }
        values["barriers"] = tuple((int(number), float(nu)) for number, nu in values["barriers"])
        values |= {name: tuple(values[name]) for name in _TUPLES}
        return RunInfo(scenario_yaml=scenario_yaml, code=dict(code), **values)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{INFO_NAME}: a field is missing or unknown: {error}") from error
