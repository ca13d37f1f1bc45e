"""The parameters with which ArduPlane is started: the aircraft's tune, and what the link needs."""

from __future__ import annotations

from pathlib import Path

from testbed.errors import InputError

# Name, value, and why.
_FOR_THE_LINK = (
    ("AHRS_EKF_TYPE", 10, "attitude and velocity are the simulated truth, without an estimator"),
    ("ARMING_SKIPCHK", -1, "what is checked before a flight is checked on the ground"),
    ("ARMING_CHECK", 0, "the same before version 4.7"),
    ("BRD_SAFETY_DEFLT", 0, "there is no safety switch to press"),
    ("INITIAL_MODE", 5, "fly-by-wire A from the start"),
    ("FLTMODE_CH", 0, "no channel of the receiver changes the mode"),
    ("RC_OVERRIDE_TIME", -1, "a stick that is overridden stays so: time is simulated time"),
    ("THR_FAILSAFE", 0, "the receiver never fails; what the radio loses is on the page"),
    ("FS_SHORT_ACTN", 3, "no failsafe takes the mode"),
    ("FS_LONG_ACTN", 0, "no failsafe takes the mode"),
    ("FS_GCS_ENABL", 0, "nobody sends heartbeats of a ground station"),
    ("ARSPD_TYPE", 2, "an analog pitot tube, which the simulator feeds"),
    ("ARSPD_PIN", 1, "where the simulator feeds it"),
    ("ARSPD_USE", 1, "gains are scaled by the airspeed measured"),
    ("ARSPD_SKIP_CAL", 1, "it starts in the air: calibrated there, its airspeed would be zero"),
    ("SIM_ARSPD_OFS", 0, "the tube has no offset that a calibration would take away"),
    ("ARSPD_RATIO", 2, "what the tube is taken to be is what it is"),
    ("SIM_ARSPD_RATIO", 2, "the same, of the simulator's; 1.99 by default"),
    ("SIM_ARSPD_RND", 0, "its noise is the page's"),
    ("SIM_DRIFT_SPEED", 0, "the gyros it flies by do not drift"),
    ("INS_GYR_CAL", 0, "no gyro is calibrated in the air"),
    ("TERRAIN_ENABLE", 0, "no terrain is asked for"),
    ("LOG_BACKEND_TYPE", 0, "its folder is removed at the end, with every log"),
)


def defaults_text(tune: Path, *, physics_hz: int, autopilot_hz: int) -> str:
    """What goes into ArduPlane's --defaults file: each parameter once, the link's first.

    ArduPlane reads 99 bytes of a line at a time, so that comments stand alone and are short.

    Raises:
        InputError: the tune cannot be read.
    """
    try:
        text = tune.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{tune}: cannot read this parameter file: {error}") from error
    given = (line.split("#", 1)[0].replace(",", " ").split() for line in text.splitlines())
    own = {words[0].upper(): words[1] for words in given if len(words) == 2}
    link = (
        *_FOR_THE_LINK,
        ("SIM_RATE_HZ", physics_hz, "a time step of rates.physics_hz"),
        ("SCHED_LOOP_RATE", autopilot_hz, "rates.autopilot_hz, whatever the tune says"),
    )
    lines = []
    for name, value, why in link:
        own.pop(name, None)
        lines += [f"# {why}", f"{name} {value}"]
    return "\n".join(
        [*lines, "# the tune", *(f"{name} {value}" for name, value in own.items()), ""]
    )
