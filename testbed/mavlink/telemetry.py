"""Telemetry logs of ArduPlane: the .tlog files ground stations keep.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from testbed.mavlink.door import MavlinkError, Message, number
from testbed.mavlink.logged import (
    RADIAN,
    Draw,
    Log,
    Rows,
    Span,
    changed,
    entry,
    in_order,
    mode_name,
    true_airspeed,
)
from testbed.mavlink.servos import CONTROLS, output, stick, throttle
from testbed.mavlink.tlog import Tlog
from testbed.state import Array

ATTITUDE = "ATTITUDE"
_REMEDY = "have it streamed (SRn_ parameters, or MAV_CMD_SET_MESSAGE_INTERVAL)"
_AUTOPILOT = 1  # component
_REBOOT = 1.0  # s that a vehicle's clock goes back by
_LATE = 5.0  # s without a heartbeat after which the mode is not known


def _outputs(number: int) -> str:
    return f"servo{number}_raw"


def _sticks(number: int) -> str:
    return f"chan{number}_raw"


_WANTED: Mapping[str, tuple[str, ...]] = {
    "ATTITUDE": ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
    "NAV_CONTROLLER_OUTPUT": ("nav_roll", "nav_pitch"),
    "VFR_HUD": ("airspeed", "alt", "climb", "throttle"),
    "GLOBAL_POSITION_INT": ("alt", "relative_alt", "vz"),
    "SERVO_OUTPUT_RAW": tuple(_outputs(n) for n in range(1, 17)),
    "RC_CHANNELS": tuple(_sticks(n) for n in range(1, 19)),
    "AOA_SSA": ("AOA", "SSA"),
}
_ABOVE_FIRST = changed(
    entry("VFR_HUD", "alt"), lambda values: values - values[0], "{} above its first"
)
COLUMNS: Mapping[str, tuple[Draw, ...]] = {
    "theta_cmd_rad": (entry("NAV_CONTROLLER_OUTPUT", "nav_pitch", RADIAN, held=True),),
    "phi_cmd_rad": (entry("NAV_CONTROLLER_OUTPUT", "nav_roll", RADIAN, held=True),),
    "throttle_cmd": (
        throttle("SERVO_OUTPUT_RAW", _outputs),
        entry("VFR_HUD", "throttle", 0.01, held=True),
        stick("RC_CHANNELS", _sticks),
    ),
    "phi_rad": (entry("ATTITUDE", "roll"),),
    "theta_rad": (entry("ATTITUDE", "pitch"),),
    "psi_rad": (entry("ATTITUDE", "yaw"),),
    "p_radps": (entry("ATTITUDE", "rollspeed"),),
    "q_radps": (entry("ATTITUDE", "pitchspeed"),),
    "r_radps": (entry("ATTITUDE", "yawspeed"),),
    "airspeed_mps": (
        true_airspeed(
            entry("VFR_HUD", "airspeed"),
            (),
            (entry("VFR_HUD", "alt"), entry("GLOBAL_POSITION_INT", "alt", 1e-3)),
        ),
    ),
    "altitude_m": (entry("GLOBAL_POSITION_INT", "relative_alt", 1e-3), _ABOVE_FIRST),
    "v_down_mps": (
        entry("GLOBAL_POSITION_INT", "vz", 0.01),
        entry("VFR_HUD", "climb", -1.0),
    ),
    "beta_rad": (entry("AOA_SSA", "SSA", RADIAN),),
    "alpha_rad": (entry("AOA_SSA", "AOA", RADIAN),),
    **{column: (output("SERVO_OUTPUT_RAW", _outputs, column),) for column in CONTROLS},
}
SOUGHT = {
    "theta_cmd_rad": "NAV_CONTROLLER_OUTPUT",
    "phi_cmd_rad": "NAV_CONTROLLER_OUTPUT",
    "throttle_cmd": "VFR_HUD or SERVO_OUTPUT_RAW",
    "airspeed_mps": "VFR_HUD",
    "altitude_m": "GLOBAL_POSITION_INT or VFR_HUD",
    "v_down_mps": "GLOBAL_POSITION_INT or VFR_HUD",
    "beta_rad": "AOA_SSA",
    "alpha_rad": "AOA_SSA",
    **dict.fromkeys(CONTROLS, "SERVO_OUTPUT_RAW"),
}


@dataclass(slots=True)
class _Heard:
    """What one autopilot said, with the times at which it was heard, s."""

    messages: dict[str, list[tuple[float, Message]]] = field(default_factory=dict)
    beats: list[tuple[float, Message]] = field(default_factory=list)
    params: dict[str, float] = field(default_factory=dict)
    stop: float = 0.0

    def hear(self, time: float, message: Message) -> None:
        self.stop = time
        if message.name in _WANTED:
            self.messages.setdefault(message.name, []).append((time, message))
        elif message.name == "HEARTBEAT":
            self.beats.append((time, message))
        elif message.name == "PARAM_VALUE":
            self.params[str(message.fields["param_id"])] = message.number("param_value")


def read_log(path: Path, system: int | None = None) -> Log:
    """Read the .tlog of an ArduPlane flight; times are since its first record.

    A vehicle's own clock is used where its messages carry it, since radio links delay them; the
    others are placed between those they came with.

    Args:
        path: the log.
        system: which vehicle; None: the only one.

    Raises:
        MavlinkError: it cannot be read, there are several vehicles or not this one, or it is not
            ArduPlane.
    """
    records = Tlog(path)
    vehicles: dict[int, _Heard] = {}
    begin = None
    for time_us, message in records:
        begin = time_us if begin is None else begin
        if message.component == _AUTOPILOT:
            heard = vehicles.setdefault(message.system, _Heard())
            heard.hear(1e-6 * (time_us - begin), message)
    heard = _choose(path, vehicles, system)
    _refuse_others(path, heard.beats)
    clock = _Clock(heard.messages[ATTITUDE])
    rows = {name: _rows(clock, found, _WANTED[name]) for name, found in heard.messages.items()}
    return Log(
        path=path,
        rows=rows,
        params=heard.params,
        spans=_spans(heard.beats, clock, heard.stop),
        notes=_notes(records, heard.params),
        home=(
            entry("GLOBAL_POSITION_INT", "alt", 1e-3),
            entry("GLOBAL_POSITION_INT", "relative_alt", 1e-3),
        ),
        remedy=_REMEDY,
    )


class _Clock:
    """The vehicle's clock, laid on the listener's where the vehicle (re)booted."""

    def __init__(self, attitudes: Sequence[tuple[float, Message]]) -> None:
        heard = np.array([time for time, _ in attitudes])
        boot = _boot(attitudes)
        again = np.flatnonzero(np.diff(boot) < -_REBOOT) + 1
        begins = np.concatenate([[0], again])
        self._since = heard[begins]
        self._shift = heard[begins] - boot[begins]
        own = self.place(heard, boot)
        forward = in_order(own)
        self._heard, self._own = heard[forward], own[forward]

    def place(self, heard: Array, boot: Array) -> Array:
        """When messages with the vehicle's time, s since it booted, were made."""
        epoch = np.maximum(np.searchsorted(self._since, heard, side="right") - 1, 0)
        made: Array = boot + self._shift[epoch]
        return made

    def guess(self, heard: Array) -> Array:
        """When messages without a time were made: between those that were heard around them."""
        inside = np.interp(heard, self._heard, self._own)
        early, late = heard < self._heard[0], heard > self._heard[-1]
        inside[early] = heard[early] - self._heard[0] + self._own[0]
        inside[late] = heard[late] - self._heard[-1] + self._own[-1]
        return inside


def _boot(found: Sequence[tuple[float, Message]]) -> Array:
    return 1e-3 * np.array([message.number("time_boot_ms") for _, message in found])


def _rows(clock: _Clock, found: Sequence[tuple[float, Message]], fields: Sequence[str]) -> Rows:
    heard = np.array([time for time, _ in found])
    stamped = "time_boot_ms" in found[0][1].fields
    time = clock.place(heard, _boot(found)) if stamped else clock.guess(heard)
    forward = in_order(time)
    table = np.array([[m.number(name) for name in fields] for _, m in found])[forward]
    return Rows(time[forward], {name: table[:, k] for k, name in enumerate(fields)})


def _choose(path: Path, vehicles: Mapping[int, _Heard], system: int | None) -> _Heard:
    flown = {n: heard for n, heard in sorted(vehicles.items()) if ATTITUDE in heard.messages}
    listed = ", ".join(f"{n} ({_described(heard)})" for n, heard in flown.items())
    if not flown:
        others = f"; systems {sorted(vehicles)} were heard" if vehicles else ""
        raise MavlinkError(f"{path}: no autopilot sent ATTITUDE{others}; {_REMEDY}")
    if system is None and len(flown) > 1:
        raise MavlinkError(f"{path}: several vehicles; write --system with one of {listed}")
    if system is not None and system not in flown:
        raise MavlinkError(f"--system {system}: not in {path}; write one of {listed}")
    return flown[next(iter(flown)) if system is None else system]


def _described(heard: _Heard) -> str:
    attitudes = heard.messages[ATTITUDE]
    modes = dict.fromkeys(mode_name(_mode(beat)) for _, beat in heard.beats)
    lasting = attitudes[-1][0] - attitudes[0][0]
    return " ".join([f"{lasting:.0f} s", *modes])


def _mode(beat: Message) -> int:
    mode = beat.fields["custom_mode"]
    return mode if isinstance(mode, int) else -1


def _refuse_others(path: Path, beats: Sequence[tuple[float, Message]]) -> None:
    """Modes have other numbers on other vehicles."""
    wings = {number("MAV_TYPE_FIXED_WING"), *range(19, 26)}  # and those that also hover
    for _, beat in beats:
        autopilot, kind = beat.fields["autopilot"], beat.fields["type"]
        if autopilot != number("MAV_AUTOPILOT_ARDUPILOTMEGA") or kind not in wings:
            raise MavlinkError(
                f"{path}: the vehicle is not ArduPlane (HEARTBEAT has autopilot {autopilot}, "
                f"type {kind}); give a log of ArduPlane"
            )


def _spans(beats: Sequence[tuple[float, Message]], clock: _Clock, stop: float) -> tuple[Span, ...]:
    """Modes from their first heartbeat to their last; between two modes nothing is known."""
    if not beats:
        return ()
    heard = clock.guess(np.array([time for time, _ in beats]))
    spans: list[Span] = []
    for time, (_, beat) in zip(heard.tolist(), beats, strict=True):
        mode = _mode(beat)
        if spans and spans[-1].mode == mode and time - spans[-1].end <= _LATE:
            spans[-1] = Span(mode, spans[-1].begin, time)
        else:
            spans.append(Span(mode, time, time))
    end = float(clock.guess(np.array([stop]))[0])
    if end - spans[-1].end <= _LATE:
        spans[-1] = Span(spans[-1].mode, spans[-1].begin, end)
    return tuple(spans)


def _notes(records: Tlog, params: Mapping[str, float]) -> tuple[str, ...]:
    notes = []
    if params.get("PTCH_TRIM_DEG"):
        notes.append(
            f"PTCH_TRIM_DEG is {params['PTCH_TRIM_DEG']:g}: ArduPlane may have sent ATTITUDE.pitch "
            "without it"
        )
    if records.cut:
        notes.append(f"its last record is cut off; {records.cut} bytes were left out")
    if records.damaged:
        notes.append(f"{records.damaged} bytes are damaged and were left out")
    if records.unread:
        notes.append(f"{records.unread} records are damaged or of unknown messages")
    return tuple(notes)
