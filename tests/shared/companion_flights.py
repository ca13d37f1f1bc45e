"""Observations of a companion in good flight, and what is wrong with them for each reason."""

import dataclasses
import math

from testbed.companion.checks import EngagementLimits, Reason
from testbed.companion.observation import (
    STATE_MESSAGES,
    STATUS_MESSAGES,
    STICKS,
    Observation,
    PeerObservation,
)
from testbed.companion.scenario_digest import UNREAD, join_digests
from testbed.scenario.companion_flight import CompanionFlight, FlightFence

FBWA, GUIDED = 5, 15
SPEED = 20.0
SCENARIO, PARAMETERS = 0x1234ABCD, 0x99887766
PERIOD_S = 0.04
LIMITS = EngagementLimits(
    CompanionFlight(fence=FlightFence(radius_m=5000, floor_m=30, ceiling_m=200)),
    leader="leader",
    used=("leader", "uav1"),
    same_parameters=("uav1",),
    parameters={"ROLL_LIMIT_DEG": 60.0},
)
GOOD_PARAMETERS = {
    "ROLL_LIMIT_DEG": 60.0,
    "PTCH_LIM_MAX_DEG": 20.0,
    "PTCH_LIM_MIN_DEG": -25.0,
    "TRIM_THROTTLE": 45.0,
    "AIRSPEED_MIN": 14.0,
    "AIRSPEED_MAX": 30.0,
}


def peer(now_s, east_m, **changes):
    """An aircraft that flies north beside the own one."""
    known = {
        "age_s": 0.02,
        "stamp_s": now_s,
        "position_ned": (SPEED * now_s, east_m, -100.0),
        "velocity_ned": (SPEED, 0.0, 0.0),
        "height_m": 300.0,
        "digests": join_digests(SCENARIO, PARAMETERS),
        "offset_s": -0.01,
    }
    return PeerObservation(**(known | changes))


def observe(now_s, mode=FBWA, **changes):
    """Return what a companion knows in straight flight, where all is well, with changes."""
    known = {
        "now_s": 1000.0 + now_s,
        "boot_s": now_s,
        "ages_s": dict.fromkeys((*STATE_MESSAGES, *STATUS_MESSAGES, STICKS), 0.02),
        "mode": mode,
        "armed": True,
        "ekf_flags": 1 | 2 | 4 | 16 | 32,
        "ekf_variances": (0.1, 0.2, 0.0),
        "fix_type": 3,
        "airspeed_mps": SPEED,
        "position_ned": (SPEED * now_s, 0.0, -100.0),
        "velocity_ned": (SPEED, 0.0, 0.0),
        "height_m": 300.0,
        "base_ms": 1_900_000_000_000,
        "sticks_us": (1500.0, 1500.0, 1500.0),
        "parameters": GOOD_PARAMETERS,
        "digests": join_digests(SCENARIO, PARAMETERS),
        "peers": {"leader": peer(now_s, 10.0), "uav1": peer(now_s, -10.0)},
    }
    return Observation(**(known | changes))


def changed(seen, **changes):
    return dataclasses.replace(seen, **changes)


def old(*messages, age_s=math.inf):
    """Return the break by which messages are old."""
    return lambda seen: changed(seen, ages_s={**seen.ages_s, **dict.fromkeys(messages, age_s)})


def other(name, **changes):
    """Return the break by which another aircraft is different."""
    return lambda seen: changed(
        seen, peers={**seen.peers, name: dataclasses.replace(seen.peers[name], **changes)}
    )


def own(**changes):
    """Return the break by which the own state is different."""
    return lambda seen: changed(seen, **changes)


def parameters(**changes):
    return lambda seen: changed(seen, parameters={**seen.parameters, **changes})


def moved(seen, north_m):
    north, east, down = seen.position_ned
    return changed(seen, position_ned=(north + north_m, east, down))


def moved_leader(seen):
    place = seen.peers["leader"].position_ned
    return other("leader", position_ned=(place[0], place[1] + 25.0, place[2]))(seen)


def frozen(now_s):
    """The position at the last whole second."""
    return SPEED * math.floor(now_s), 0.0, -100.0


# By reason: what is done to a good observation. Those with a memory act by their first one.
BREAKS = {
    Reason.PILOT_MODE: [own(mode=FBWA), own(mode=11)],
    Reason.STOPPING: [own(stopping=True)],
    Reason.PAUSED: [lambda seen: changed(seen, now_s=seen.now_s + 0.9)],
    Reason.HEARTBEAT: [old("HEARTBEAT"), old("HEARTBEAT", age_s=3.1)],
    Reason.STICK: [own(sticks_us=(1700.0, 1500.0, 1500.0)), own(sticks_us=(1500, 1500, 1340))],
    Reason.RESTARTED: [own(boot_s=0.5)],
    Reason.STATE_AGE: [old(name, age_s=1.1) for name in STATE_MESSAGES],
    Reason.STATE_INVALID: [
        own(position_ned=(math.nan, 0.0, 0.0)),
        own(airspeed_mps=math.nan),
        own(velocity_ned=(200.0, 0.0, 0.0)),
        own(height_m=20_000.0),
    ],
    Reason.STATE_FROZEN: [lambda seen: changed(seen, position_ned=frozen(seen.boot_s))],
    Reason.STATE_JUMP: [lambda seen: moved(seen, 12.0), lambda seen: moved(seen, -12.0)],
    Reason.STATUS_AGE: [old(name, age_s=3.1) for name in STATUS_MESSAGES[1:]],
    Reason.DISARMED: [own(armed=False)],
    Reason.NO_FIX: [own(fix_type=2)],
    Reason.EKF_FLAGS: [own(ekf_flags=1 | 2 | 4 | 32), own(ekf_flags=55 | 32768)],
    Reason.EKF_VARIANCE: [own(ekf_variances=(0.1, 0.8)), own(ekf_variances=(math.nan,))],
    Reason.AIRSPEED: [own(airspeed_mps=13.9)],
    Reason.NO_FENCE: [],  # of the scenario
    Reason.FENCE: [
        own(position_ned=(0.0, 5001.0, -100.0)),
        own(position_ned=(0.0, 0.0, -201.0)),
        own(position_ned=(0.0, 0.0, -29.0)),
    ],
    Reason.NO_RECEIVER: [own(sticks_us=None), old(STICKS, age_s=3.1)],
    Reason.NO_PARAMETERS: [own(parameters={}), own(digests=join_digests(SCENARIO, UNREAD))],
    Reason.PARAMETERS: [parameters(TRIM_THROTTLE=0.0), parameters(ROLL_LIMIT_DEG=45.0)],
    Reason.LEADER_AGE: [other("leader", age_s=1.1), other("leader", age_s=math.inf)],
    Reason.LEADER_JUMP: [moved_leader, other("leader", position_ned=(math.nan, 0.0, 0.0))],
    Reason.LEADER_SPEED: [
        other("leader", velocity_ned=(2.0, 0.0, 0.0)),
        other("leader", velocity_ned=(0.0, 61.0, 0.0)),
        other("leader", velocity_ned=(math.nan, 0.0, 0.0)),
    ],
    Reason.PEER_AGE: [other("uav1", age_s=1.1)],
    Reason.SCENARIO_DIFFERS: [
        other("uav1", digests=join_digests(SCENARIO + 1, PARAMETERS)),
        other("leader", digests=join_digests(SCENARIO + 1, PARAMETERS)),
    ],
    Reason.PARAMETERS_DIFFER: [other("uav1", digests=join_digests(SCENARIO, PARAMETERS + 1))],
    Reason.PEER_UNREAD: [other("uav1", digests=join_digests(SCENARIO, UNREAD))],
    Reason.NO_TIME: [own(base_ms=None), own(base_ms=1_000_000_000_000)],
    Reason.TIME_JUMP: [own(base_ms=1_900_000_000_150), own(base_ms=1_899_999_999_850)],
    Reason.CLOCKS_APART: [other("uav1", offset_s=0.25), other("leader", offset_s=-1.0)],
    Reason.HEIGHTS_DIFFER: [],  # on the ground
}
