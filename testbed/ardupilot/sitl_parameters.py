"""Parameters that ArduPlane is started with: those of the aircraft and those the link needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from testbed.autopilot.known_parameters import (
    FLIGHT_OPTIONS,
    NOT_KNOWN,
    NOT_MODELLED,
    OPTION_BITS,
    is_hardware,
    is_known,
)
from testbed.autopilot.param_file import GivenValue, read_param_file
from testbed.autopilot.parameters import FbwaParams, fbwa_params, is_virtual, sitl_gyro_cutoff

# Name, value and reason.
_LINK_PARAMETERS = (
    ("AHRS_EKF_TYPE", 10, "attitude and velocity are the simulated truth, without an estimator"),
    ("EK3_ENABLE", 0, "no estimator runs beside the truth"),
    ("GPS1_TYPE", 0, "no GPS, which only the estimator would use"),
    ("GPS_TYPE", 0, "the same before version 4.6"),
    ("ARMING_SKIPCHK", -1, "no pre-arm checks, as the aircraft starts in the air"),
    ("ARMING_CHECK", 0, "the same before version 4.7"),
    ("BRD_SAFETY_DEFLT", 0, "no safety switch"),
    ("INITIAL_MODE", 5, "fly-by-wire A from the start"),
    ("FLTMODE_CH", 0, "no RC channel changes the mode"),
    ("RC_OVERRIDE_TIME", -1, "overrides do not expire in simulated time"),
    ("THR_FAILSAFE", 0, "RC does not fail; faults are in the scenario"),
    ("FS_SHORT_ACTN", 3, "no failsafe changes the mode"),
    ("FS_LONG_ACTN", 0, "no failsafe changes the mode"),
    ("FS_GCS_ENABL", 0, "no ground station sends heartbeats"),
    ("ARSPD_ENABLE", 1, "airspeed sensors are supported"),
    ("ARSPD_TYPE", 2, "an analog airspeed sensor, fed by the simulator"),
    ("ARSPD_PIN", 1, "the pin that the simulator feeds"),
    ("ARSPD_USE", 1, "gains are scaled by the measured airspeed"),
    ("ARSPD_SKIP_CAL", 1, "a calibration in the air would make the airspeed zero"),
    ("SIM_ARSPD_OFS", 0, "no offset that a calibration would remove"),
    ("ARSPD_RATIO", 2, "equal to that of the simulated sensor"),
    ("SIM_ARSPD_RATIO", 2, "equal to ARSPD_RATIO; 1.99 by default"),
    ("SIM_ARSPD_RND", 0, "noise is in the scenario"),
    ("SIM_DRIFT_SPEED", 0, "gyro drift is in the scenario"),
    ("INS_GYR_CAL", 0, "no gyro calibration in the air"),
    ("TERRAIN_ENABLE", 0, "no terrain requests"),
    ("LOG_BACKEND_TYPE", 0, "its folder is removed at the end, with every log"),
)


class TuneUse(NamedTuple):
    """How the names of a parameter file are used, by names as in the file."""

    renamed: dict[str, str]  # older names, and the present name with the converted value
    both: tuple[str, ...]  # used by the virtual autopilot and by ArduPlane
    arduplane: tuple[str, ...]  # used by ArduPlane only
    link: tuple[str, ...]  # replaced by values that the link needs
    hardware: tuple[str, ...]  # left out: of the aircraft's hardware, failsafes and missions


class TuneReport(NamedTuple):
    """What a parameter file does, with either autopilot.

    Attributes:
        use: how its names are used.
        differences: values that make ArduPlane in SITL differ from the virtual autopilot.
        unknown: names, as in the file, of which no effect on ArduPlane's flight is known here.
            ArduPlane gets them and the virtual autopilot does not use them: they may make both
            differ. All others are used by both, have a known difference, or are known to have no
            effect.
        notes: what of the file is ignored or replaced, one sentence each.
    """

    use: TuneUse
    differences: tuple[str, ...]
    unknown: tuple[str, ...]
    notes: tuple[str, ...]


def tune_report(tune: Path) -> TuneReport:
    """Read a parameter file once, and explain it.

    Raises:
        ParamError: the file cannot be read, or a line or value is invalid, as before a flight.
    """
    file = read_param_file(tune)
    params = fbwa_params(file)
    return TuneReport(
        _use(file.values),
        tuple(_differences(file.values, params)),
        _unknown(file.values),
        tuple(note.text for note in file.notes),
    )


def _use(values: Mapping[str, GivenValue]) -> TuneUse:
    link = {name for name, _, _ in _link_parameters(0, 0)}
    renamed: dict[str, str] = {}
    kinds: dict[str, list[str]] = {kind: [] for kind in TuneUse._fields[1:]}
    for name, (value, _, given) in values.items():
        if given.upper() != name:
            renamed[given] = f"{name} {value:.9g}"
        if name in link:
            kind = "link"
        elif is_hardware(name):
            kind = "hardware"
        else:
            kind = "both" if is_virtual(name) else "arduplane"
        kinds[kind].append(given)
    return TuneUse(renamed, **{kind: tuple(names) for kind, names in kinds.items()})


def _differences(given: Mapping[str, GivenValue], params: FbwaParams) -> Iterator[str]:
    values = {name: each.value for name, each in given.items()}
    for name, default, text in NOT_MODELLED:
        if values.get(name, default) != default:
            yield f"{name} {values[name]:.9g}: {text}"
    options = int(values.get("FLIGHT_OPTIONS", 0.0))
    for bit in range(OPTION_BITS):
        if options >> bit & 1 and (text := FLIGHT_OPTIONS.get(bit, NOT_KNOWN)):
            yield f"FLIGHT_OPTIONS bit {bit}: {text}"
    if (own := params.ins_gyro_filter) > 0.0:
        at_200 = sitl_gyro_cutoff(params, 200.0)
        yield (
            f"INS_GYRO_FILTER {own:.9g}: {own:.9g} Hz in the virtual autopilot, as on an aircraft; "
            f"in SITL times rates.physics_hz / 1000, {at_200:.9g} Hz at 200, which the virtual "
            "autopilot has with gyro_filter: sitl"
        )


def _unknown(values: Mapping[str, GivenValue]) -> tuple[str, ...]:
    link = {name for name, _, _ in _link_parameters(0, 0)}
    return tuple(
        each.name
        for name, each in values.items()
        if not (name in link or is_known(name) or is_virtual(name))
    )


def _link_parameters(physics_hz: int, autopilot_hz: int) -> tuple[tuple[str, float, str], ...]:
    return (
        *_LINK_PARAMETERS,
        ("SIM_RATE_HZ", physics_hz, "rates.physics_hz"),
        ("SCHED_LOOP_RATE", autopilot_hz, "rates.autopilot_hz, also if the tune has another"),
    )


def defaults_text(tune: Path, *, physics_hz: int, autopilot_hz: int) -> str:
    """Write ArduPlane's --defaults file: each parameter once, those of the link first.

    Of the tune, parameters of the aircraft's hardware are left out; older names are converted.
    ArduPlane reads at most 99 bytes of a line, so that comments have lines of their own.

    Args:
        tune: the aircraft's parameter file.
        physics_hz: rate of the flight models.
        autopilot_hz: rate of the autopilot.

    Raises:
        ParamError: the parameter file cannot be read, or a line is invalid.
    """
    lines, link = [], set()
    for name, value, reason in _link_parameters(physics_hz, autopilot_hz):
        link.add(name)
        lines += [f"# {reason}", f"{name} {value}"]
    own = [
        f"{name} {each.value:.9g}"
        for name, each in read_param_file(tune).values.items()
        if name not in link and not is_hardware(name)
    ]
    return "\n".join([*lines, "# the tune", *own, ""])
