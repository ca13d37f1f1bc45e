"""Parameters that ArduPlane is started with: those of the aircraft and those the link needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

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


# Beginnings of names that belong to the hardware of an aircraft, its failsafes and its missions:
# calibrations would be errors of the simulated sensors.
_HARDWARE = (
    *("AHRS_CUSTOM", "AHRS_ORIENT", "AHRS_TRIM", "BARO", "COMPASS", "GPS", "GND_", "INS_ACC"),
    *("INS_GYR", "INS_POS", "INS_TCAL", "INS_USE", "EK2_", "EK3_", "ARSPD", "RNGFND", "FLOW"),
    *("BATT", "BRD_", "CAN_", "NTF_", "RPM", "EFI", "ADSB", "AVD_", "OSD", "VTX", "FRSKY"),
    *("SERIAL", "SR0_", "SR1_", "SR2_", "SR3_", "SR4_", "SR5_", "SR6_", "MAV", "SYSID", "TELEM"),
    *("RC_OPTIONS", "RC_PROTOCOLS", "FLTMODE", "AFS_", "FENCE", "RALLY", "MIS_", "CHUTE"),
    *("ARMING", "FS_", "LOG_", "SCR_", "STAT_", "FORMAT_VERSION", "SYS_NUM", "Q_ENABLE"),
    *("CAM", "MNT", "RELAY", "TERRAIN", "ICE_", "FOLL", "NET_", "DDS_"),
)
# Name, value of the virtual autopilot, which is ArduPlane's default, and what it leaves out.
_NOTCH = "notch filter of the rate loop"
_AXES = ("RLL", "PTCH")
_NOT_MODELLED = (
    ("KFF_THR2PTCH", 0.0, "pitch by throttle"),
    *((f"{axis}_RATE_PDMX", 0.0, "limit of P + D") for axis in _AXES),
    *((f"{axis}_RATE_D_FF", 0.0, "feed-forward of the target's derivative") for axis in _AXES),
    *((f"{axis}_RATE_{kind}", 0.0, _NOTCH) for axis in _AXES for kind in ("NTF", "NEF")),
    ("MIXING_OFFSET", 0.0, "different travel of aileron and elevator on elevons and V-tails"),
    ("YAW2SRV_DAMP", 0.0, "yaw damper"),
    ("YAW2SRV_SLIP", 0.0, "control of sideslip"),
    ("YAW_RATE_ENABLE", 0.0, "control of the yaw rate"),
    ("STALL_PREVENTION", 1.0, "the virtual autopilot always limits the load factor"),
    ("THR_MIN", 0.0, "least throttle; 0 in the virtual autopilot"),
    ("THR_PASS_STAB", 0.0, "throttle without THR_MIN and THR_MAX"),
    ("FWD_BAT_VOLT_MAX", 0.0, "compensation of throttle for the battery's voltage"),
    ("RUDDER_ONLY", 0.0, "control by the rudder"),
    ("INS_HNTCH_ENABLE", 0.0, "notch filter"),
    ("INS_HNTC2_ENABLE", 0.0, "notch filter"),
)
# Names that have no effect in fly-by-wire A in the air, by the source of ArduPlane: of other modes,
# of take-off and landing, and of functions whose switch is in `_NOT_MODELLED`. A name that is not
# here may have any effect: fly-by-wire A reads some of take-off, such as TKOFF_TDRAG_SPD1.
_NO_EFFECT = frozenset(
    f"{group}{name}"
    for group, names in {
        "ACRO_": "LOCKING PITCH_RATE ROLL_RATE",
        "ALT_HOLD_": "FBWCM RTL",
        "AUTOTUNE_": "LEVEL",
        "CRUISE_": "ALT_FLOOR",
        "FBWB_": "CLIMB_RATE ELEV_REV",
        "LAND_": "ABORT_DEG ABORT_THR DISARMDELAY FLAP_PERCNT FLARE_ALT FLARE_SEC PF_ALT PF_ARSPD "
        "PF_SEC PITCH_CD SLOPE_RCALC THEN_NEUTRL THR_SLEW TYPE",
        "RTL_": "ALTITUDE AUTOLAND RADIUS",
        "TECS_": "APPR_SMAX CLMB_MAX FLARE_HGT HDEM_TCONST HGT_OMEGA INTEG_GAIN LAND_ARSPD "
        "LAND_DAMP LAND_IGAIN LAND_PDAMP LAND_PMAX LAND_SINK LAND_SPDWGT LAND_SRC LAND_TCONST "
        "LAND_TDAMP LAND_THR OPTIONS PITCH_MAX PITCH_MIN PTCH_DAMP PTCH_FF_K PTCH_FF_V0 RLL2THR "
        "SINK_MAX SINK_MIN SPDWEIGHT SPD_OMEGA SYNAIRSPEED THR_DAMP TIME_CONST TKOFF_IGAIN "
        "VERT_ACC",
        "TKOFF_": "ALT DIST FLAP_PCNT GND_PITCH LVL_ALT LVL_PITCH PLIM_SEC ROTATE_SPD THR_DELAY "
        "THR_MAX THR_MINACC THR_MINSPD THR_SLEW",
        "WP_": "LOITER_RAD MAX_RADIUS RADIUS",
        "INS_HNTCH_": "ATT BW FM_RAT FREQ HMNCS MODE OPTS REF",
        "INS_HNTC2_": "ATT BW FM_RAT FREQ HMNCS MODE OPTS REF",
        "": "LEVEL_ROLL_LIMIT MIN_GNDSPD_CM MIN_GROUNDSPEED STICK_MIXING THROTTLE_NUDGE",
    }.items()
    for name in names.split()
)
# Bits of FLIGHT_OPTIONS: the difference from the virtual autopilot, or "": no effect in
# fly-by-wire A in the air. A bit that is not here may have any effect.
_FLIGHT_OPTIONS = {
    0: "ArduPlane mixes no rudder in fly-by-wire A (KFF_RDDRMIX)",
    **dict.fromkeys((1, 2, 3, 4, 5, 6, 7, 8, 9), ""),
    10: "ArduPlane takes half throttle as TRIM_THROTTLE",
    **dict.fromkeys((11, 12, 13, 14), ""),
}
_OPTION_BITS = 32
_NOT_KNOWN = "not known: may change the flight"
_KEPT = ("INS_ACCEL_FILTER", "INS_GYRO_FILTER")  # of the control law


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
        elif _is_hardware(name):
            kind = "hardware"
        else:
            kind = "both" if is_virtual(name) else "arduplane"
        kinds[kind].append(given)
    return TuneUse(renamed, **{kind: tuple(names) for kind, names in kinds.items()})


def _differences(given: Mapping[str, GivenValue], params: FbwaParams) -> Iterator[str]:
    values = {name: each.value for name, each in given.items()}
    for name, default, text in _NOT_MODELLED:
        if values.get(name, default) != default:
            yield f"{name} {values[name]:.9g}: {text}"
    options = int(values.get("FLIGHT_OPTIONS", 0.0))
    for bit in range(_OPTION_BITS):
        if options >> bit & 1 and (text := _FLIGHT_OPTIONS.get(bit, _NOT_KNOWN)):
            yield f"FLIGHT_OPTIONS bit {bit}: {text}"
    if (own := params.ins_gyro_filter) > 0.0:
        at_200 = sitl_gyro_cutoff(params, 200.0)
        yield (
            f"INS_GYRO_FILTER {own:.9g}: {own:.9g} Hz in the virtual autopilot, as on an aircraft; "
            f"in SITL times rates.physics_hz / 1000, {at_200:.9g} Hz at 200, which the virtual "
            "autopilot has with gyro_filter: sitl"
        )


def _unknown(values: Mapping[str, GivenValue]) -> tuple[str, ...]:
    known = {"FLIGHT_OPTIONS", *(name for name, _, _ in _NOT_MODELLED), *_NO_EFFECT}
    known |= {name for name, _, _ in _link_parameters(0, 0)}
    return tuple(
        each.name
        for name, each in values.items()
        if not (name in known or is_virtual(name) or _is_hardware(name))
    )


def _is_hardware(name: str) -> bool:
    return name.startswith(_HARDWARE) and name not in _KEPT


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
        if name not in link and not _is_hardware(name)
    ]
    return "\n".join([*lines, "# the tune", *own, ""])
