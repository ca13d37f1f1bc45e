"""Check of a metrics document from a log before it is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from testbed.core.errors import InputError
from testbed.core.records import RunInfo
from testbed.core.shape import Each, ListOf, Number, Optional, check_shape
from testbed.formation.law import LimiterFlag, Saturation
from testbed.metrics.accumulator import ESTIMATE_KEYS
from testbed.metrics.document import OUTCOMES, Document
from testbed.metrics.facts import facts
from testbed.metrics.summary import RINGING_KEYS, SCHEMA
from testbed.metrics.tables import (
    arrival_tables,
    error_tables,
    follower_tables,
    published_mean,
    published_note,
    worst_followers,
    worst_links,
)

_NUMBER = Number()
_COUNT = Number(whole=True, least=0)
_KNOWN = Optional(_NUMBER)  # null: unknown
_LINK: Mapping[str, Any] = {
    "sent": _COUNT,
    "delivered": _COUNT,
    "delivered_share": _KNOWN,
    "lost": Each(_COUNT),
    "muted": _COUNT,
    "duplicated": _COUNT,
    "overtaken": _COUNT,
    "delay_s": Optional(dict.fromkeys(("mean", "min", "max", "p50", "p95", "p99"), _NUMBER)),
    "bursts": {"count": _COUNT, "mean": _KNOWN, "longest": _COUNT, "lengths": Each(_COUNT)},
    "age_s": Optional(dict.fromkeys(("mean", "max", "p50", "p95", "uses"), _NUMBER)),
}
_PUBLISHED = {
    "source": str,
    "rms_m": Each(ListOf(_NUMBER)),
    "mean_rms_m": Each(_NUMBER),
    "percent_error": Each(_NUMBER),
}
_EVENT = {"time_s": _NUMBER, "level": str, "source": str, "text": str}
# Of external programs; only runs that have them have these keys.
_EXTERNAL: Mapping[str, Any] = {
    "pace": {
        "requested": _NUMBER,
        "achieved": _KNOWN,
        "late_s": dict.fromkeys(("mean", "p99", "max"), _NUMBER),
    },
    "mavlink": {
        "frames_sent": _COUNT,
        "frames_received": _COUNT,
        "rejected": Each(_COUNT),
        "clients": ListOf(str),
    },
    "arduplane": Each(str),
    "commanded": Each(Each(_COUNT)),
}
_BOUND = {
    "key": ListOf(str),
    "quantity": str,
    "window": Optional(str),
    "follower": Optional(str),
    "side": str,
    "bound": _NUMBER,
    "value": _KNOWN,
    "met": bool,
}
# Only runs of scenarios with `expect` have this key.
_EXPECT = {"expect": {"checked": _COUNT, "violated": _COUNT, "bounds": ListOf(_BOUND)}}


def check_metrics(document: Document, info: RunInfo, where: str) -> None:
    """Check that a document has the keys and types of this version, for this run.

    Args:
        document: of metrics.json.
        info: of the run.
        where: file of the document, for the error.

    Raises:
        InputError: naming the first wrong value.
    """
    try:
        check_shape(document.get("schema"), Number(whole=True), "schema")
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema: is {document['schema']}; this version reads {SCHEMA}")
        optional = {**_EXTERNAL, **_EXPECT}
        external = {key: shape for key, shape in optional.items() if document.get(key)}
        shape = _shape(info)
        check_shape(document, shape | external)
        for key, by_name in shape.items():
            if isinstance(by_name, dict) and list(document[key]) != list(by_name):
                raise ValueError(f"{key}: its keys are not those of the run, in order")
        outcome, closest = document["outcome"], document["min_separation_between"]
        if outcome is not None and outcome not in OUTCOMES:
            raise ValueError(f"outcome: is none of {', '.join(OUTCOMES)}")
        if closest is not None and not (len(closest) == 2 and set(closest) <= {*info.names}):
            raise ValueError("min_separation_between: are not two aircraft of the run")
        try:
            _render(document, info)
        except (KeyError, TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
            raise ValueError(f"its values contradict each other ({error!r})") from error
    except ValueError as error:
        raise InputError(f"{where}: metrics.json: {error}") from error


def _render(document: Document, info: RunInfo) -> None:
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
    if document["min_separation_between"]:
        float(document["min_separation_m"])


def _shape(info: RunInfo) -> dict[str, Any]:
    """Return the shape of the document of a run."""
    names, followers = info.names, info.names[1:]

    def by(aircraft: tuple[str, ...], shape: Any) -> dict[str, Any]:  # noqa: ANN401 - a Shape
        return dict.fromkeys(aircraft, shape)

    def flags(kind: type[LimiterFlag] | type[Saturation]) -> dict[str, Any]:
        kinds = {str(flag.name).lower(): _COUNT for flag in kind}
        return by(followers, {"samples": _COUNT, "seconds": _NUMBER, "by_kind": kinds})

    slot_speed = {
        "kappa_mps": by(followers, _KNOWN),
        "slot_speed_mps": by(followers, ListOf(_KNOWN, 2)),
    }
    window = {
        "window_s": ListOf(_NUMBER, 2),
        "covered_s": _NUMBER,
        "complete": bool,
        "rms_m": by(followers, _KNOWN),
        "mean_rms_m": _KNOWN,
        "estimated_rms_m": by(followers, _KNOWN),
        "estimated_mean_rms_m": _KNOWN,
        "percent_error": _KNOWN,
        "max_error_m": by(followers, _KNOWN),
        "leader_bank_deg": _KNOWN,
        **slot_speed,
    }
    wind = {
        "mean_ned_mps": ListOf(_KNOWN, 3),
        "mean_mps": _KNOWN,
        "from_deg": _KNOWN,
        "gusts_rms_ned_mps": ListOf(_KNOWN, 3),
        "max_mps": _KNOWN,
        "max_wake_delta_cl": _KNOWN,
    }
    recovery = {"last_saturated_s": _KNOWN, "in_slot_since_s": _KNOWN}
    return {
        "scenario": str,
        "seed": Number(whole=True, least=0),
        "versions": Each(str),
        "outcome": Optional(str),
        "simulated_s": _NUMBER,
        "wall_s": _KNOWN,
        "real_time_factor": _KNOWN,
        "windows": by(tuple(info.windows), window),
        "min_separation_m": _KNOWN,
        "min_separation_at_s": _KNOWN,
        "min_separation_between": Optional(ListOf(str)),
        "lost_at_s": by(names, _KNOWN),
        "joined_at_s": by(followers, _KNOWN),
        "max_error_m": by(followers, _KNOWN),
        "leader_bank_deg": _KNOWN,
        "limiter_flags": flags(LimiterFlag),
        "saturations": flags(Saturation),
        "ringing": by(followers, dict.fromkeys(RINGING_KEYS, _KNOWN)),
        **slot_speed,
        "kappa_at_s": by(followers, _KNOWN),
        "kappa_assumed_mps": by(followers, Number(finite=False)),
        "left_speed_set": by(followers, {"times": _COUNT, "first_s": _KNOWN}),
        "recovery": by(followers, recovery),
        "age_of_information_s": by(followers, {"mean": _KNOWN, "max": _KNOWN}),
        "network": Optional({"links": Each(Each(_LINK)), "all": _LINK}),
        "mean_throttle": by(names, _KNOWN),
        "wind": by(names, wind),
        "estimate_error": by(names, dict.fromkeys((*ESTIMATE_KEYS, "max_horizontal_m"), _KNOWN)),
        "relative_position_error_m": by(followers, _KNOWN),
        "published": Optional(_PUBLISHED),
        "events": ListOf(_EVENT),
    }
