"""The verdict on a formation: what is short in the rows of an assessment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from testbed.assessment.conditions import CONDITIONS
from testbed.assessment.measures import FAULTS, OUTAGES
from testbed.core.records import join_names

MIN_FACTOR, MIN_PHASE_DEG = 2.0, 30.0  # margins of a command: 6 dB
CHARGE_RESERVE = 0.2  # of a full battery, at the end of the flight
DECIDING = ("nominal", "margins", *CONDITIONS)  # rows without which there is no verdict
GO, NO_GO, INCOMPLETE = "go", "no-go", "incomplete"

Row = Mapping[str, Any]


def shortcomings(
    rows: Mapping[str, Row], energy: list[dict[str, Any]], compared: list[dict[str, Any]]
) -> list[dict[str, str]]:
    """Return what speaks against the flight, as `row` and `text`."""
    found = []
    for name, row in rows.items():
        found += [{"row": name, "text": text} for text in _of_row(name, row)]
    for each in energy:
        if each["short"]:
            found.append({"row": "energy", "text": f"{each['aircraft']}: {each['text']}"})
    for each in compared:
        if each["differences"]:
            found.append({"row": "parameters", "text": _of_parameters(each)})
    return found


def _of_row(name: str, row: Row) -> Iterator[str]:
    if row.get("problem"):
        yield f"not flown: {row['problem']}"
    elif name == "nominal":
        if row["kept"] < row["flights"]:
            first = row["broken"][0]
            kept = f"{row['kept']} of {row['flights']} flights keep the criteria"
            yield f"{kept}; seed {first['seed']}: {first['why']}"
    elif name == "margins":
        for case in row["cases"]:
            yield from _of_margins(case)
    elif name in CONDITIONS and row["value"] is None and not row.get("skipped"):
        yield f"no value: {no_value(row)}"


def _of_parameters(compared: Row) -> str:
    differences, names = compared["differences"], compared["aircraft"]
    count = f"{len(differences)} parameter{'s' * (len(differences) != 1)}"
    more = f", and {len(differences) - 3} more" if len(differences) > 3 else ""
    return (
        f"{count} of {join_names(names)} not as in {compared['file']}: "
        f"{'; '.join(differences[:3])}{more} (fly with those of the file: its path as tune of "
        f"{join_names(names)})"
    )


def no_value(row: Row) -> str:
    """Return why a condition has no value."""
    weakest = row["weakest"]
    with_what = f" ({row['flown_with']})" if row["flown_with"] else ""
    return f"seed {weakest['seed']} at {weakest['value']:g}{with_what}: {weakest['why']}"


def _of_margins(case: Row) -> Iterator[str]:
    where = describe_case(case)
    if case.get("problem"):
        yield f"{where}: {case['problem']}"
    for each in case.get("followers", ()):
        if each["damping"] is not None and each["damping"] <= 0.0:
            yield f"{where}: {each['name']} is unstable, damping ratio {each['damping']:.3f}"
            continue
        if each["factor"] is not None and each["factor"] < MIN_FACTOR:
            yield (
                f"{where}: {each['name']} bears a factor of {each['factor']:.2f} on "
                f"{each['factor_of']}, less than {MIN_FACTOR:g}"
            )
        if each["phase_deg"] is not None and each["phase_deg"] < MIN_PHASE_DEG:
            yield (
                f"{where}: {each['name']} has a phase margin of {each['phase_deg']:.0f}° on "
                f"{each['phase_of']}, less than {MIN_PHASE_DEG:g}°"
            )


def describe_case(case: Row) -> str:
    """Name the steady flight of margins."""
    if case["bank_deg"]:
        return f"turn at {case['bank_deg']:.0f}° of bank"
    climb = case["climb_mps"]
    if climb:
        return f"{'climb' if climb > 0 else 'descent'} at {abs(climb):.1f} m/s"
    return "straight"


def energy(nominal: Row, flown_s: float, whole_s: float) -> list[dict[str, Any]]:
    """Return the charge of each battery at the end of the flight, and when it is at the reserve.

    Args:
        nominal: row of the flight at nominal conditions.
        flown_s: that was flown.
        whole_s: planned, to which the use of the flight is continued.
    """
    found = []
    for name, (begin, end) in nominal["charge"].items():
        if begin is None or end is None:
            text = "not modelled: its power does not depend on battery or fuel"
            found.append({"aircraft": name, "text": text, "short": False, "modelled": False})
            continue
        per_s = (begin - end) / flown_s if flown_s else 0.0
        at_end = begin - per_s * whole_s
        lasts_s = (begin - CHARGE_RESERVE) / per_s if per_s > 0.0 else None
        until = "" if lasts_s is None else f"; {CHARGE_RESERVE:.0%} after {lasts_s / 60.0:.0f} min"
        text = f"charge {begin:.0%} at the start, {max(at_end, 0.0):.0%} after {whole_s:g} s{until}"
        short = at_end < CHARGE_RESERVE
        found.append({"aircraft": name, "text": text, "short": short, "modelled": True})
    return found


def decide(rows: Mapping[str, Row], short: list[dict[str, str]]) -> str:
    """Return the verdict. Faults and outages do not decide it: what they do is for the pilot."""
    if any(each["row"] not in (*FAULTS, *OUTAGES) for each in short):
        return NO_GO
    return GO if all(name in rows for name in DECIDING) else INCOMPLETE
