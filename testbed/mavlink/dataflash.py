"""DataFlash logs of ArduPlane: the .bin files it writes on board.

Messages and units: https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from testbed.mavlink.dataflash_format import FMT, HEAD, Contents, Table, read_messages
from testbed.mavlink.door import MavlinkError
from testbed.mavlink.logged import (
    RADIAN,
    Draw,
    Log,
    Rows,
    Span,
    changed,
    entry,
    in_order,
    true_airspeed,
)
from testbed.mavlink.servos import CONTROLS, demand, output, throttle

BEGINNING = HEAD + bytes([FMT])  # the definition of definitions
ATTITUDE = "ATT"
_REMEDY = "have it logged (LOG_BITMASK, or LOG_DISARMED for the ground)"


def _outputs(number: int) -> str:
    return f"C{number}"


_CHANNELS = tuple(_outputs(n) for n in range(1, 15))
# By message: its fields, and the field that numbers several sensors of a kind, of which the first
# is taken.
_WANTED: Mapping[str, tuple[tuple[str, ...], str | None]] = {
    "ATT": (("DesRoll", "Roll", "DesPitch", "Pitch", "Yaw"), None),
    "IMU": (("GyrX", "GyrY", "GyrZ"), "I"),
    "ARSP": (("Airspeed",), "I"),
    "CTUN": (("As", "E2T", "ThO"), None),
    "RCOU": (_CHANNELS, None),
    "AETR": (("Ail", "Elev", "Thr", "Rudd"), None),
    "POS": (("Alt", "RelHomeAlt"), None),
    "GPS": (("Alt", "VZ"), "I"),
    "BARO": (("Alt", "CRt"), "I"),
    "XKF1": (("VD",), "C"),
    "AOA": (("AOA", "SSA"), None),
}
_SEA_LEVEL = (entry("POS", "Alt"), entry("GPS", "Alt"))


COLUMNS: Mapping[str, tuple[Draw, ...]] = {
    "theta_cmd_rad": (entry("ATT", "DesPitch", RADIAN, held=True),),
    "phi_cmd_rad": (entry("ATT", "DesRoll", RADIAN, held=True),),
    "throttle_cmd": (
        entry("AETR", "Thr", 0.01, held=True),
        entry("CTUN", "ThO", 0.01, held=True),
        throttle("RCOU", _outputs),
    ),
    "phi_rad": (entry("ATT", "Roll", RADIAN),),
    "theta_rad": (entry("ATT", "Pitch", RADIAN),),
    "psi_rad": (entry("ATT", "Yaw", RADIAN),),
    "p_radps": (entry("IMU", "GyrX"),),
    "q_radps": (entry("IMU", "GyrY"),),
    "r_radps": (entry("IMU", "GyrZ"),),
    "airspeed_mps": tuple(
        true_airspeed(source, (entry("CTUN", "E2T"),), _SEA_LEVEL)
        for source in (entry("ARSP", "Airspeed"), entry("CTUN", "As"))
    ),
    "altitude_m": (
        entry("POS", "RelHomeAlt"),
        entry("BARO", "Alt"),
        changed(entry("GPS", "Alt"), lambda values: values - values[0], "{} above its first"),
    ),
    "v_down_mps": (entry("XKF1", "VD"), entry("GPS", "VZ"), entry("BARO", "CRt", -1.0)),
    "beta_rad": (entry("AOA", "SSA", RADIAN),),
    "alpha_rad": (entry("AOA", "AOA", RADIAN),),
    **{column: (output("RCOU", _outputs, column), demand(column)) for column in CONTROLS},
}

SOUGHT = {
    "theta_cmd_rad": "ATT.DesPitch",
    "phi_cmd_rad": "ATT.DesRoll",
    "throttle_cmd": "AETR or CTUN",
    "p_radps": "IMU",
    "q_radps": "IMU",
    "r_radps": "IMU",
    "airspeed_mps": "ARSP or CTUN",
    "altitude_m": "POS, BARO or GPS",
    "v_down_mps": "XKF1, GPS or BARO",
    "beta_rad": "AOA",
    "alpha_rad": "AOA",
    **dict.fromkeys(CONTROLS, "RCOU or AETR"),
}


def read_log(path: Path) -> Log:
    """Read the .bin log of an ArduPlane flight; times are since the autopilot booted.

    Raises:
        MavlinkError: it cannot be read, or another vehicle wrote it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MavlinkError(f"{path}: cannot be read: {error.strerror}") from error
    asked = {
        name: ("TimeUS", *fields, *([which] if which else []))
        for name, (fields, which) in _WANTED.items()
    }
    asked |= {"MODE": ("TimeUS", "ModeNum", "Mode"), "PARM": ("Name", "Value"), "MSG": ("Message",)}
    contents = read_messages(data, asked)
    found = contents.tables
    if said := found.get("MSG"):
        _refuse_others(path, said.texts.get("Message", ()))
    rows = {}
    for name, (_, which) in _WANTED.items():
        if name in found and (made := _rows(found[name], which)):
            rows[name] = made
    stop = max((float(made.time[-1]) for made in rows.values()), default=0.0)
    notes = _notes(contents)
    return Log(
        path=path,
        rows=rows,
        params=_params(found["PARM"]) if "PARM" in found else {},
        spans=_spans(found["MODE"], stop) if "MODE" in found else (),
        notes=notes,
        home=(entry("POS", "Alt"), entry("POS", "RelHomeAlt")),
        remedy=f"{_REMEDY}, or download it again: {'; '.join(notes)}" if notes else _REMEDY,
    )


def _rows(table: Table, which: str | None) -> Rows | None:
    """Messages as columns: of the first sensor, with times that do not run backwards."""
    numbers = table.numbers
    if "TimeUS" not in numbers:
        return None
    time = 1e-6 * numbers["TimeUS"]
    taken = np.isfinite(time)
    if which is not None and which in numbers:  # older logs do not number them
        taken &= numbers[which] == 0.0
    taken[taken] = in_order(time[taken])
    if not taken.any():
        return None
    return Rows(time[taken], {name: values[taken] for name, values in numbers.items()})


def _params(table: Table) -> dict[str, float]:
    names, values = table.texts.get("Name", ()), table.numbers.get("Value", np.empty(0))
    return dict(zip(names, values.tolist(), strict=False))


def _spans(table: Table, stop: float) -> tuple[Span, ...]:
    numbers = table.numbers
    flown = numbers.get("ModeNum", numbers.get("Mode"))
    if flown is None or "TimeUS" not in numbers:
        return ()
    known = np.isfinite(flown) & np.isfinite(numbers["TimeUS"])
    begins = (1e-6 * numbers["TimeUS"][known]).tolist()
    ends = [*begins, stop][1:]
    return tuple(
        Span(int(mode), begin, end)
        for mode, begin, end in zip(flown[known].tolist(), begins, ends, strict=True)
    )


def _refuse_others(path: Path, texts: Iterable[str]) -> None:
    """Modes have other numbers on other vehicles."""
    for text in texts:
        if vehicle := re.match(r"Ardu(Copter|Rover|Sub)|APMrover2|Blimp|AntennaTracker", text):
            raise MavlinkError(f"{path}: a log of {vehicle.group()}; give one of ArduPlane")
        if text.startswith("ArduPlane"):
            return


def _notes(contents: Contents) -> tuple[str, ...]:
    notes = []
    if contents.skipped:
        notes.append(f"{contents.skipped} bytes are damaged and were left out")
    if contents.unreadable:
        notes.append(f"the definition of {', '.join(contents.unreadable)} is damaged")
    if contents.cut:
        notes.append(f"the last message is cut off after {contents.cut} bytes")
    return tuple(notes)
