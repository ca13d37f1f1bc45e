"""What is known about a run before its first frame, as JSON and back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from testbed.state import Origin, RunInfo


def to_json(info: RunInfo) -> str:
    """All of it but where the log lies, and the page and its code, which are beside."""
    values: dict[str, Any] = {
        field.name: getattr(info, field.name)
        for field in dataclasses.fields(info)
        if field.name not in ("directory", "scenario_yaml", "code")
    }
    values["origin"] = dataclasses.asdict(info.origin)
    values["leader_path_ned"] = np.asarray(info.leader_path_ned).tolist()
    values["portions"] = dict(info.portions)
    values["versions"] = dict(info.versions)
    return json.dumps(values, ensure_ascii=False)


def from_json(text: str, *, scenario_yaml: str, code: Mapping[str, bytes]) -> RunInfo:
    """The same again.

    Raises:
        ValueError: The text is not what `to_json` writes.
    """
    try:
        values = json.loads(text)
        values["origin"] = Origin(**values["origin"])
        path = np.array(values["leader_path_ned"], dtype=np.float64)
        values["leader_path_ned"] = path.reshape(-1, 3)
        bounds = values["speed_bounds_mps"]
        values["speed_bounds_mps"] = tuple((float(low), float(high)) for low, high in bounds)
        values["portions"] = {
            str(name): (float(start), float(end))
            for name, (start, end) in values["portions"].items()
        }
        barriers = values.get("barriers", ())  # logs of before 2026-11-22 have none
        values["barriers"] = tuple((int(example), float(nu)) for example, nu in barriers)
        for name in (
            "names",
            "aircraft",
            "wingspan_m",
            "kappa_mps",
            "roll_limit_rad",
            "bounded_in_ned",
        ):
            values[name] = tuple(values[name])
        return RunInfo(scenario_yaml=scenario_yaml, code=dict(code), **values)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the run's header lacks or adds something: {error}") from error
