"""Parameters that the virtual autopilot does not use, by their effect on ArduPlane's flight."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

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
NOT_MODELLED = (
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
# of take-off and landing, and of functions whose switch is in `NOT_MODELLED`. A name that is not
# here may have any effect: fly-by-wire A reads some of take-off, such as TKOFF_TDRAG_SPD1.
NO_EFFECT = frozenset(
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
FLIGHT_OPTIONS = {
    0: "ArduPlane mixes no rudder in fly-by-wire A (KFF_RDDRMIX)",
    **dict.fromkeys((1, 2, 3, 4, 5, 6, 7, 8, 9), ""),
    10: "ArduPlane takes half throttle as TRIM_THROTTLE",
    **dict.fromkeys((11, 12, 13, 14), ""),
}
OPTION_BITS = 32
NOT_KNOWN = "not known: may change the flight"
_KEPT = ("INS_ACCEL_FILTER", "INS_GYRO_FILTER")  # of the control law


def is_hardware(name: str) -> bool:
    """Return whether a parameter belongs to the aircraft's hardware, failsafes or missions."""
    return name.startswith(_HARDWARE) and name not in _KEPT


def is_known(name: str) -> bool:
    """Return whether the effect of a parameter on ArduPlane's flight is known here."""
    modelled = {name for name, _, _ in NOT_MODELLED}
    return name in modelled or name in NO_EFFECT or name == "FLIGHT_OPTIONS" or is_hardware(name)


# Beginnings of names of other parts of ArduPlane, which resemble those of fly-by-wire A.
_OTHER_PARTS = ("SERVO", "RC", "YAW", "STEER", "SIM_", "SCHED_", "Q_", "TKOFF_", "LAND_", "NAVL1_")
_LIKENESS = 0.85  # of a misspelt name, by difflib


def probably_meant(name: str, used: Iterable[str]) -> str | None:
    """Return the used name that an unknown one is probably a misspelling of, or None.

    Args:
        name: in capital letters.
        used: names that the virtual autopilot uses, in capital letters.
    """
    if is_known(name) or name.startswith(_OTHER_PARTS):
        return None
    close = difflib.get_close_matches(name, list(used), n=1, cutoff=_LIKENESS)
    return close[0] if close else None
