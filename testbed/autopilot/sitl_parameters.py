"""Parameters that ArduPlane is started with: those of the aircraft and those the link needs."""

from __future__ import annotations

from pathlib import Path

from testbed.core.input_files import read_bounded_text

# Name, value and reason.
_LINK_PARAMETERS = (
    ("AHRS_EKF_TYPE", 10, "attitude and velocity are the simulated truth, without an estimator"),
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


def defaults_text(tune: Path, *, physics_hz: int, autopilot_hz: int) -> str:
    """Write ArduPlane's --defaults file: each parameter once, those of the link first.

    ArduPlane reads at most 99 bytes of a line, so that comments have lines of their own.

    Args:
        tune: the aircraft's parameter file.
        physics_hz: rate of the flight models.
        autopilot_hz: rate of the autopilot.

    Raises:
        InputError: the parameter file cannot be read.
    """
    text = read_bounded_text(tune)
    given = (line.split("#", 1)[0].replace(",", " ").split() for line in text.splitlines())
    own = {words[0].upper(): words[1] for words in given if len(words) == 2}
    link = (
        *_LINK_PARAMETERS,
        ("SIM_RATE_HZ", physics_hz, "rates.physics_hz"),
        ("SCHED_LOOP_RATE", autopilot_hz, "rates.autopilot_hz, also if the tune has another"),
    )
    lines = []
    for name, value, reason in link:
        own.pop(name, None)
        lines += [f"# {reason}", f"{name} {value}"]
    return "\n".join(
        [*lines, "# the tune", *(f"{name} {value}" for name, value in own.items()), ""]
    )
