"""Write the files of a new aircraft: autopilot, middle loop, guidance, and where they come from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from testbed.autopilot.parameters import FbwaParams
from testbed.commissioning.airframe_import import CopiedAircraft
from testbed.commissioning.check_flight import CheckFlight
from testbed.commissioning.first_formation import NAME as FORMATION
from testbed.commissioning.first_formation import first_formation
from testbed.commissioning.new_aircraft import ALTITUDE, DerivedAircraft
from testbed.core.files import write_text_file
from testbed.scenario.yaml_io import write
from testbed.vehicle.jsbsim_adapter import airframe

_DERIVED = "Derived from the flight model by testbed new aircraft: SOURCE.md"


def write_aircraft_files(copied: CopiedAircraft, found: DerivedAircraft) -> None:
    """Write what was derived into the folder of an aircraft.

    Raises:
        OSError: a file cannot be written.
    """
    folder = copied.main.parent
    texts = {
        "autopilot.param": _param_text(found.check.params),
        "middle_loop.yaml": (
            f"# Gains of the middle loop, [HBH23] eqs. (19)-(21).\n# {_DERIVED}\n\n"
            + write({"tuned": found.middle_loop})
        ),
        "guidance.yaml": (
            "# Gains with which the aircraft holds altitude and airspeed as a leader.\n"
            f"# {_DERIVED}\n\n" + write(found.guidance)
        ),
        "SOURCE.md": _source_text(copied, found),
    }
    if found.speed is not None:
        texts[FORMATION] = first_formation(folder.name, found, airframe(folder).span)
    for name, text in texts.items():
        with write_text_file(folder / name) as file:
            file.write(text)


def _param_text(params: FbwaParams) -> str:
    lines = [
        f"# {_DERIVED}",
        "# Angles deg, rates deg/s, speeds m/s, throttle %.",
        *(f"{each.name.upper()} {getattr(params, each.name):g}" for each in fields(params)),
    ]
    return "\n".join((*lines, ""))


def _source_text(copied: CopiedAircraft, found: DerivedAircraft) -> str:
    name, level, steps, check = copied.main.stem, found.level, found.steps, found.check
    main = copied.sources[copied.main]
    parts = [
        f"# Where the numbers of {name} come from",
        f"`{main.name}` is a JSBSim aircraft that was copied with the files that it names. Its own "
        "texts say who made it, and under which terms. Everything else was derived from this flight"
        " model by `testbed new aircraft`; no number was measured on a real aircraft, or tuned by "
        "a person.",
        "## Files",
        _table(
            ("file", "copied from"),
            (
                (f"`{copy.relative_to(copied.main.parent)}`", f"`{source}`")
                for copy, source in copied.sources.items()
            ),
        ),
        _changes(copied),
        "## Level flight",
        f"At {ALTITUDE:g} m above sea level in the standard atmosphere, with the fuel of the files,"
        " the landing gear up and all engines running. Airspeeds are true.",
        _table(
            ("", ""),
            (
                ("slowest", f"{level.lowest:.1f} m/s"),
                ("cruise", f"{level.airspeed:.4g} m/s"),
                ("fastest", f"{level.highest:.1f} m/s"),
                ("throttle at cruise", f"{level.throttle:.3f}"),
                ("throttle for 1 m/s more", f"{level.throttle_per_speed:+.4f}"),
                (
                    "throttle for 1 m/s of climb",
                    f"{level.throttle_per_climb / level.airspeed:+.4f}",
                ),
                ("throttle in a bank of 30°", f"{level.throttle_per_bank / 3.0:+.4f}"),
                ("lag of the flight path behind the pitch", f"{level.path_lag_s:.2f} s"),
            ),
        ),
        "![Throttle, angle of attack and elevator over airspeed](envelope.png)",
        "## Step responses",
        "From trim at cruise, without an autopilot, per full command.",
        _table(
            ("control", "response", "to 63 %"),
            (
                ("aileron", f"{math.degrees(steps.roll_rate):.1f}°/s", f"{steps.roll_s:.2f} s"),
                ("elevator", f"{math.degrees(steps.pitch_rate):.1f}°/s", f"{steps.pitch_s:.2f} s"),
                *(
                    [
                        (
                            "throttle",
                            f"{steps.throttle_acceleration:.2f} m/s²",
                            f"{steps.throttle_s:.2f} s",
                        )
                    ]
                    if found.speed
                    else []
                ),
            ),
        ),
        f"KFF_RDDRMIX {steps.rudder_mix:g} has the least sideslip after the step of the aileron: "
        f"{math.degrees(steps.sideslip):.1f}° per full command.",
        "## A minute of fly-by-wire A",
        "Bank 0, 30, −30, 0°, then pitch +4, −4, 0° from the trim's, with the throttle of the trim."
        f" The gains were {_times(check.softenings)}.",
        _table(
            ("axis", "to 63 %", "overshoot", "ripple"),
            (
                (
                    axis,
                    f"{each.rise_s:.2f} s",
                    f"{100.0 * each.overshoot:.1f} %",
                    f"{each.ripple_deg:.2f}°",
                )
                for axis, each in (("bank", check.roll), ("pitch", check.pitch))
            ),
        ),
        f"Largest sideslip {check.sideslip_deg:.1f}°, largest elevator {check.elevator:.2f}.",
        *_speed_parts(found),
        "## What was not checked",
        "Stall, spin, take-off and landing, other altitudes and masses, and whether the flight "
        "model is like the aircraft whose name it has.",
    ]
    return "\n\n".join((*filter(None, parts), ""))


def _speed_parts(found: DerivedAircraft) -> list[str]:
    if found.speed is None:
        return []
    model = found.speed.model
    return [
        "## Speed",
        f"A step of {found.speed.step:+g} m/s of the commanded speed, with the middle loop: pole "
        f"{model.pole:.2f} 1/s, delay {model.delay:.2f} s, fit error {100.0 * model.rms:.0f} %. "
        "The pole is `formation.speed_pole_per_s` of a scenario. A smaller one asks for more "
        "speed, and oscillates where the engine is late.",
    ]


def _changes(copied: CopiedAircraft) -> str:
    cuts = [f"- `{Path(each.place.file).name}:{each.place.line}`: `{each.element}` was cut out"
            for each in copied.cuts]  # fmt: skip
    declared = [
        f"- `{name}` is declared with the value 0: a file reads it, and none sets it"
        for name in copied.declared
    ]
    return "\n".join((*cuts, *declared)) or "Their text was not changed."


def _times(count: int) -> str:
    words = {0: "not softened", 1: "softened once", 2: "softened twice"}
    return words.get(count, f"softened {count} times")


def _table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    titles = tuple(header)
    lines = [titles, ("---",) * len(titles), *(tuple(row) for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def check_document(flight: CheckFlight) -> dict[str, Any]:
    """Convert a flight to JSON values."""
    axes: Mapping[str, Any] = {"roll": flight.roll, "pitch": flight.pitch}
    return {
        "softenings": flight.softenings,
        "problem": flight.problem,
        "flown_s": flight.flown_s,
        **{
            f"{axis}_{name}": getattr(each, name)
            for axis, each in axes.items()
            for name in each._fields
        },
        "bank_error_deg": flight.bank_error_deg,
        "sideslip_deg": flight.sideslip_deg,
        "elevator": flight.elevator,
    }
