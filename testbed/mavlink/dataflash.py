"""Read DataFlash logs of ArduPlane, the .bin files that it writes on board.

Messages and units: https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from testbed.core.input_files import MAX_FLIGHT_LOG_BYTES, read_bounded
from testbed.mavlink.codec import MavlinkError
from testbed.mavlink.dataflash_format import FMT, HEAD, Contents, Table, read_messages
from testbed.mavlink.flight_log import (
    RAD_PER_DEG,
    ColumnSource,
    FlightLog,
    MessageTable,
    ModeInterval,
    field_source,
    increasing,
    transformed_source,
    true_airspeed_source,
)
from testbed.mavlink.servo_outputs import (
    SERVO_COLUMNS,
    demand_source,
    output_source,
    throttle_output_source,
)

SIGNATURE = HEAD + bytes([FMT])  # first bytes of a log: the definition of FMT
_ATTITUDE = "ATT"
_REMEDY = "have it logged (LOG_BITMASK, or LOG_DISARMED for the ground)"


def _output_field(number: int) -> str:
    return f"C{number}"


_OUTPUTS = tuple(_output_field(n) for n in range(1, 15))
# By message: its fields, and the field with the number of the sensor, of which the first is used.
_FIELDS_BY_MESSAGE: Mapping[str, tuple[tuple[str, ...], str | None]] = {
    "ATT": (("DesRoll", "Roll", "DesPitch", "Pitch", "Yaw"), None),
    "IMU": (("GyrX", "GyrY", "GyrZ"), "I"),
    "ARSP": (("Airspeed",), "I"),
    "CTUN": (("As", "E2T", "ThO"), None),
    "RCOU": (_OUTPUTS, None),
    "AETR": (("Ail", "Elev", "Thr", "Rudd"), None),
    "POS": (("Alt", "RelHomeAlt"), None),
    "GPS": (("Alt", "VZ"), "I"),
    "BARO": (("Alt", "CRt"), "I"),
    "XKF1": (("VD",), "C"),
    "AOA": (("AOA", "SSA"), None),
}
_SEA_LEVEL = (field_source("POS", "Alt"), field_source("GPS", "Alt"))


COLUMNS: Mapping[str, tuple[ColumnSource, ...]] = {
    "theta_cmd_rad": (field_source("ATT", "DesPitch", RAD_PER_DEG, held=True),),
    "phi_cmd_rad": (field_source("ATT", "DesRoll", RAD_PER_DEG, held=True),),
    "throttle_cmd": (
        field_source("AETR", "Thr", 0.01, held=True),
        field_source("CTUN", "ThO", 0.01, held=True),
        throttle_output_source("RCOU", _output_field),
    ),
    "phi_rad": (field_source("ATT", "Roll", RAD_PER_DEG),),
    "theta_rad": (field_source("ATT", "Pitch", RAD_PER_DEG),),
    "psi_rad": (field_source("ATT", "Yaw", RAD_PER_DEG),),
    "p_radps": (field_source("IMU", "GyrX"),),
    "q_radps": (field_source("IMU", "GyrY"),),
    "r_radps": (field_source("IMU", "GyrZ"),),
    "airspeed_mps": tuple(
        true_airspeed_source(source, (field_source("CTUN", "E2T"),), _SEA_LEVEL)
        for source in (field_source("ARSP", "Airspeed"), field_source("CTUN", "As"))
    ),
    "altitude_m": (
        field_source("POS", "RelHomeAlt"),
        field_source("BARO", "Alt"),
        transformed_source(
            field_source("GPS", "Alt"), lambda values: values - values[0], "{} above its first"
        ),
    ),
    "v_down_mps": (
        field_source("XKF1", "VD"),
        field_source("GPS", "VZ"),
        field_source("BARO", "CRt", -1.0),
    ),
    "beta_rad": (field_source("AOA", "SSA", RAD_PER_DEG),),
    "alpha_rad": (field_source("AOA", "AOA", RAD_PER_DEG),),
    **{
        column: (output_source("RCOU", _output_field, column), demand_source(column))
        for column in SERVO_COLUMNS
    },
}

_MESSAGES = {
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
    **dict.fromkeys(SERVO_COLUMNS, "RCOU or AETR"),
}


def read_log(path: Path) -> FlightLog:
    """Read the .bin log of an ArduPlane flight; times are from its boot.

    Raises:
        MavlinkError: it cannot be read, or is not a log of ArduPlane.
    """
    data = read_bounded(path, MAX_FLIGHT_LOG_BYTES, error=MavlinkError)
    requested = {
        name: ("TimeUS", *fields, *([sensor] if sensor else []))
        for name, (fields, sensor) in _FIELDS_BY_MESSAGE.items()
    }
    requested |= {
        "MODE": ("TimeUS", "ModeNum", "Mode"),
        "PARM": ("Name", "Value"),
        "MSG": ("Message",),
    }
    contents = read_messages(data, requested)
    found = contents.tables
    if texts := found.get("MSG"):
        _check_vehicle(path, texts.texts.get("Message", ()))
    tables = {}
    for name, (_, sensor) in _FIELDS_BY_MESSAGE.items():
        if name in found and (table := _message_table(found[name], sensor)):
            tables[name] = table
    end = max((float(table.time[-1]) for table in tables.values()), default=0.0)
    notes = _notes(contents)
    return FlightLog(
        path=path,
        tables=tables,
        params=_params(found["PARM"]) if "PARM" in found else {},
        modes=_mode_intervals(found["MODE"], end) if "MODE" in found else (),
        notes=notes,
        attitude=_ATTITUDE,
        columns=COLUMNS,
        messages=_MESSAGES,
        remedy=f"{_REMEDY}, or download it again: {'; '.join(notes)}" if notes else _REMEDY,
        home=(field_source("POS", "Alt"), field_source("POS", "RelHomeAlt")),
    )


def _message_table(table: Table, sensor: str | None) -> MessageTable | None:
    """Take the messages of the first sensor, without times that decrease."""
    numbers = table.numbers
    if "TimeUS" not in numbers:
        return None
    time = 1e-6 * numbers["TimeUS"]
    keep = np.isfinite(time)
    if sensor is not None and sensor in numbers:  # older logs do not number them
        keep &= numbers[sensor] == 0.0
    keep[keep] = increasing(time[keep])
    if not keep.any():
        return None
    return MessageTable(time[keep], {name: values[keep] for name, values in numbers.items()})


def _params(table: Table) -> dict[str, float]:
    names, values = table.texts.get("Name", ()), table.numbers.get("Value", np.empty(0))
    return dict(zip(names, values.tolist(), strict=False))


def _mode_intervals(table: Table, log_end: float) -> tuple[ModeInterval, ...]:
    numbers = table.numbers
    modes = numbers.get("ModeNum", numbers.get("Mode"))
    if modes is None or "TimeUS" not in numbers:
        return ()
    valid = np.isfinite(modes) & np.isfinite(numbers["TimeUS"])
    starts = (1e-6 * numbers["TimeUS"][valid]).tolist()
    ends = [*starts, log_end][1:]
    return tuple(
        ModeInterval(int(mode), start, end)
        for mode, start, end in zip(modes[valid].tolist(), starts, ends, strict=True)
    )


def _check_vehicle(path: Path, texts: Iterable[str]) -> None:
    """Reject logs of other vehicles, whose modes have other numbers.

    Raises:
        MavlinkError: a text is of another vehicle.
    """
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
