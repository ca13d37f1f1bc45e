"""The header of a log: what is known about a run before its first sample."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from testbed.core.data_errors import MAX_WHOLE, describe_first
from testbed.core.input_files import parse_json_map
from testbed.core.records import NedOrigin, RunInfo
from testbed.core.start_time import MAX_START_NS
from testbed.logs.messages import LOG_SCHEMA

METADATA_NAME = "testbed"
INFO_NAME = "run.json"  # attached: the RunInfo
CODE_SUFFIX = (".py", ".fmu")  # of attached user code
_ValueT = TypeVar("_ValueT")
_Number = Annotated[float, Field(le=MAX_WHOLE, allow_inf_nan=False)]
_Rate = Annotated[int, Field(ge=1, le=100_000)]
_Pair = Annotated[tuple[_ValueT, ...], Field(min_length=2, max_length=2)]
_Triple = Annotated[tuple[_ValueT, ...], Field(min_length=3, max_length=3)]


class _Header(BaseModel):
    """A RunInfo as JSON, without its directory and what has attachments of its own."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=True)

    scenario_name: str
    names: tuple[str, ...]
    aircraft: tuple[str, ...]
    wingspan_m: tuple[_Number, ...]
    origin: NedOrigin
    base_rate_hz: _Rate
    sample_rate_hz: _Rate
    duration_s: Annotated[_Number, Field(ge=0.0)]
    seed: Annotated[int, Field(ge=0, le=MAX_WHOLE)]
    speed_bounds_mps: tuple[_Pair[float], ...]
    kappa_mps: tuple[float, ...]
    roll_limit_rad: tuple[float, ...]
    leader_path_ned: tuple[_Triple[float], ...]
    windows: dict[str, _Pair[_Number]]
    versions: dict[str, str]
    bounded_in_ned: _Triple[_Number]
    barriers: tuple[_Pair[_Number], ...]
    barrier_samples: tuple[tuple[_Number, ...], ...]
    estimated: bool
    start_unix_ns: Annotated[int, Field(ge=0, le=MAX_START_NS)]
    integrators: dict[str, str]
    engine: Literal["", "compiled", "jsbsim"] = ""  # logs of earlier versions do not have it
    law_numbers: tuple[str, ...] = ()  # in logs with such numbers


def metadata(info: RunInfo) -> dict[str, str]:
    """Collect the metadata record: schema, scenario, seed, versions, rate, integrators, engine."""
    return {
        "log_schema": str(LOG_SCHEMA),
        "scenario": info.scenario_name,
        "scenario_sha256": hashlib.sha256(info.scenario_yaml.encode()).hexdigest(),
        "seed": str(info.seed),
        **{f"version.{name}": value for name, value in info.versions.items()},
        "base_rate_hz": str(info.base_rate_hz),
        **{f"integrator.{name}": value for name, value in info.integrators.items()},
        **({"engine": info.engine} if info.engine else {}),
    }


def to_json(info: RunInfo) -> str:
    """Encode a RunInfo without its directory, and without what has attachments of its own."""
    values: dict[str, Any] = {
        field.name: getattr(info, field.name)
        for field in dataclasses.fields(info)
        if field.name not in ("directory", "make_yaml", "code")
    }
    if not info.law_numbers:
        del values["law_numbers"]
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
        parse_json_map(text)  # limits the depth
        header = _Header.model_validate_json(text)
        _check_sizes(header)
    except ValidationError as error:
        raise ValueError(f"{INFO_NAME}: {describe_first(error)}") from None
    except ValueError as error:
        raise ValueError(f"{INFO_NAME}: {error}") from None
    values = dict(header)
    values["leader_path_ned"] = np.array(header.leader_path_ned, dtype=np.float64).reshape(-1, 3)
    return RunInfo(make_yaml=partial(str, scenario_yaml), code=dict(code), **values)


def _check_sizes(header: _Header) -> None:
    """Check that names differ, and that there is a value for each.

    Raises:
        ValueError: naming the first wrong field.
    """
    names = header.names
    if not names or len(set(names)) < len(names):
        raise ValueError("names: is empty or has repeated names")
    n = len(names) - 1
    sizes = {"aircraft": n + 1, "wingspan_m": n + 1, "speed_bounds_mps": n, "kappa_mps": n}
    for name, size in (sizes | {"roll_limit_rad": n}).items():
        if len(getattr(header, name)) != size:
            raise ValueError(f"{name}: has {len(getattr(header, name))} elements, not {size}")
    if len(set(header.law_numbers)) < len(header.law_numbers) or not all(
        each.isidentifier() for each in header.law_numbers
    ):
        raise ValueError("law_numbers: has repeated names, or one that is no name of a field")
    for name in ("barriers", "barrier_samples"):
        if len(getattr(header, name)) not in (0, n):
            raise ValueError(f"{name}: has {len(getattr(header, name))} elements, not {n}")
