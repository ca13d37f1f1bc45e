"""Digests by which companions find that they fly different scenarios or different parameters.

FOLLOW_TARGET has 8 bytes for the sender's own use, `custom_state`: here 4 of the scenario's digest
and 4 of the parameters'. They find mistakes; against forgery messages are signed.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping

UNREAD = 0  # in place of the digest of parameters, before all are read
_BYTES = 4
_FIGURES = 6  # of a parameter: MAVLink has float32

# Limits and trims by which equal commands give equal flights; ArduPlane's present names.
AGREED_PARAMETERS = (
    *("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG", "PTCH_TRIM_DEG"),
    *("TRIM_THROTTLE", "THR_MIN", "THR_MAX", "THR_SLEWRATE"),
    *("AIRSPEED_MIN", "AIRSPEED_MAX", "AIRSPEED_CRUISE"),
)
# Without these there is no flight; others of the list may be missing in some versions.
NEEDED_PARAMETERS = (
    *("ROLL_LIMIT_DEG", "PTCH_LIM_MAX_DEG", "PTCH_LIM_MIN_DEG"),
    *("TRIM_THROTTLE", "AIRSPEED_MIN", "AIRSPEED_MAX"),
)


def scenario_digest(parts: Iterable[tuple[str, bytes]]) -> int:
    """Return the digest of a scenario.

    Args:
        parts: name and content: the resolved scenario, the file of the law, files of gains.
            Names are no paths, which differ among computers.
    """
    digest = hashlib.sha256()
    for name, content in sorted(parts):
        for each in (name.encode(), content):
            digest.update(len(each).to_bytes(8, "little") + each)
    return int.from_bytes(digest.digest()[:_BYTES], "little")


def parameter_digest(parameters: Mapping[str, float]) -> int:
    """Return the digest of `AGREED_PARAMETERS`; others, and the order, change nothing."""
    lines = [
        f"{name} {parameters[name] + 0.0:.{_FIGURES}g}\n"
        for name in AGREED_PARAMETERS
        if name in parameters and math.isfinite(parameters[name])
    ]
    return scenario_digest([("parameters", "".join(lines).encode())]) or UNREAD + 1


def join_digests(scenario: int, parameters: int) -> int:
    """Return `custom_state` of FOLLOW_TARGET."""
    return scenario | parameters << 8 * _BYTES


def split_digests(custom_state: int) -> tuple[int, int]:
    """Return the digests of the scenario and of the parameters in `custom_state`."""
    return custom_state & 0xFFFFFFFF, custom_state >> 8 * _BYTES & 0xFFFFFFFF
