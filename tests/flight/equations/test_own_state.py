"""Own state and command of companions against the frames of a vehicle, and by hand."""

import math

import numpy as np
import pytest
from mavlink_control import RecordingControl, VehicleClient, sample

from testbed.core.frames import (
    GRAVITY,
    angles_from_quaternion,
    euler_from_quaternion,
    rotation_ned_body,
)
from testbed.core.geodetic import local_frame
from testbed.core.records import (
    AIRCRAFT,
    FbwaCommand,
    NedOrigin,
    VehicleState,
    allocate,
    write_fields,
)
from testbed.flight.own_state import (
    ATTITUDE_TARGET,
    IMU,
    OWN_STATE,
    VELOCITY,
    AttitudeLimits,
    decode_attitude_target,
    decode_own_states,
    encode_attitude_targets,
    encode_own_states,
)
from testbed.mavlink.codec import Codec, constant
from testbed.mavlink.telemetry_messages import TELEMETRY_MESSAGES
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot

COUNT = 40
DATE_LINE = NedOrigin(-52.0, 179.9999, 12.0)
# Field of OWN_STATE: its message, and the fields of that.
FIELDS = {
    "time_boot_ms": ("ATTITUDE", ["time_boot_ms"]),
    "lat": ("GLOBAL_POSITION_INT", ["lat"]),
    "lon": ("GLOBAL_POSITION_INT", ["lon"]),
    "alt": ("GLOBAL_POSITION_INT", ["alt"]),
    "velocity_ned": ("LOCAL_POSITION_NED", ["vx", "vy", "vz"]),
    "euler": ("ATTITUDE", ["roll", "pitch", "yaw"]),
    "rates_body": ("ATTITUDE", ["rollspeed", "pitchspeed", "yawspeed"]),
    "airspeed": ("VFR_HUD", ["airspeed"]),
    "specific_force": ("SCALED_IMU", ["xacc", "yacc", "zacc"]),
}


@pytest.fixture(scope="module")
def aircraft():
    """Aircraft in any attitude, the last one with values that are none."""
    random = np.random.default_rng(5)
    records = allocate(AIRCRAFT, COUNT)
    state = VehicleState(
        position_ned=random.normal(0.0, 3000.0, (COUNT, 3)),
        velocity_ned=random.normal(0.0, 20.0, (COUNT, 3)),
        acceleration_ned=random.normal(0.0, 40.0, (COUNT, 3)),
        euler=random.uniform(-2.0, 2.0, (COUNT, 3)) * (0.7, 0.7, 6.0),
        rates_body=random.normal(0.0, 1.0, (COUNT, 3)),
        airspeed=random.uniform(10.0, 30.0, COUNT),
        equivalent_airspeed=random.uniform(10.0, 30.0, COUNT),
    )
    for each in state:
        each[-1] = np.nan
    state.position_ned[-2], state.acceleration_ned[-3] = np.inf, 1e30
    write_fields(records["estimate"], state)
    return records


def encoded(aircraft, now=2.36, origin=DATE_LINE):
    messages = allocate(OWN_STATE, len(aircraft))
    encode_own_states(aircraft, local_frame(origin), messages, now)
    return messages


def vehicle_fields(aircraft, now, origin):
    """Return the fields of OWN_STATE (N,) as programs parse them from a vehicle's frames."""
    state = VehicleState(*(np.asarray(aircraft["estimate"][n]) for n in VehicleState._fields))
    told = sample(0, COUNT)._replace(time_s=now, estimate=state)
    found = {name: [] for name in FIELDS}
    for row in range(COUNT):
        client = VehicleClient(RecordingControl(), count=COUNT, row=row, update=False)
        client.vehicle.update(TelemetrySnapshot(told, origin), 0.0)
        client.vehicle.system = 1  # the target of `command`
        messages = {}
        for name in {message for message, _ in FIELDS.values()}:
            asked = float(constant(f"MAVLINK_MSG_ID_{name}"))
            messages |= {each.name: each.fields for each in client.command(512, asked)}
        for name, (message, fields) in FIELDS.items():
            found[name].append([messages[message][each] for each in fields])
    return {name: np.array(each) for name, each in found.items()}


@pytest.fixture(scope="module")
def parsed(aircraft):
    return vehicle_fields(aircraft, 2.36, DATE_LINE)


@pytest.mark.parametrize("name", FIELDS)
def test_own_state_is_that_of_the_frames(aircraft, parsed, name):
    found = encoded(aircraft)[name].astype(float).reshape(COUNT, -1)
    np.testing.assert_array_equal(found, parsed[name])
    # by a bit another estimate gives another field
    changed = aircraft.copy()
    for field in VehicleState._fields:
        changed["estimate"][field] *= 1.001
    found = encoded(changed, 2.38)[name].astype(float).reshape(COUNT, -1)
    assert np.any(found != parsed[name])


def test_messages_of_own_state_are_telemetry():
    assert {message for message, _ in FIELDS.values()} <= set(TELEMETRY_MESSAGES)


def decoded(aircraft, source=VELOCITY, *, times=(2.32, 2.36), step=None):
    """Return the motion that a companion knows after two samples."""
    frame, rows = local_frame(DATE_LINE), np.arange(len(aircraft), dtype=np.intp)
    before, own = allocate(OWN_STATE, len(aircraft)), allocate(AIRCRAFT, len(aircraft))
    first = aircraft.copy()
    if step is not None:
        first["estimate"]["velocity_ned"] -= step
    for each, now in zip((first, aircraft), times, strict=True):
        decode_own_states(rows, encoded(each, now), before, frame, source, own)
    return own["estimate"]


def test_decoded_state_is_the_estimate_rounded(aircraft):
    good, own = aircraft["estimate"][:-3], decoded(aircraft)[:-3]
    # 1e-7 degrees, and mm
    assert np.abs(own["position_ned"] - good["position_ned"]).max() < 0.006
    assert np.abs(own["position_ned"] - good["position_ned"]).max() > 0.0
    for name in ("velocity_ned", "rates_body", "equivalent_airspeed"):
        np.testing.assert_array_equal(own[name], good[name].astype("f4"))
    turned = rotation_ned_body(own["euler"]) - rotation_ned_body(good["euler"])
    assert np.abs(turned).max() < 1e-6
    # ISO 2533 by its temperature and pressure
    height = DATE_LINE.elevation_m - good["position_ned"][:, 2]
    theta = 1.0 - 0.0065 * height / 288.15
    true = good["equivalent_airspeed"] / np.sqrt(theta**4.2558797)
    np.testing.assert_allclose(own["airspeed"], true, rtol=2e-5)


def test_acceleration_is_difference_of_velocities(aircraft):
    step = np.array([0.4, -0.2, 0.1])
    good = aircraft[:-3]
    own = decoded(good, step=step)
    np.testing.assert_allclose(own["acceleration_ned"], np.tile(step / 0.04, (37, 1)), rtol=1e-4)
    # after a gap, and at first, none is known
    assert not decoded(good, times=(1.0, 2.36), step=step)["acceleration_ned"].any()
    assert not decoded(good, times=(2.36, 2.36), step=step)["acceleration_ned"].any()
    # where the time since boot begins again
    late = (2**32 - 20) * 1e-3
    own = decoded(good, times=(late, late + 0.04), step=step)
    np.testing.assert_allclose(own["acceleration_ned"], np.tile(step / 0.04, (37, 1)), rtol=1e-4)


def test_repeated_sample_changes_no_acceleration(aircraft):
    good = aircraft[:-3]
    frame, rows = local_frame(DATE_LINE), np.arange(len(good), dtype=np.intp)
    before, own = allocate(OWN_STATE, len(good)), allocate(AIRCRAFT, len(good))
    moved = good.copy()
    moved["estimate"]["velocity_ned"] += 1.0
    for each, now in ((good, 0.0), (moved, 0.04), (moved, 0.04)):
        decode_own_states(rows, encoded(each, now), before, frame, VELOCITY, own)
    np.testing.assert_allclose(own["estimate"]["acceleration_ned"], 25.0, rtol=1e-4)


def test_acceleration_of_the_imu(aircraft):
    weak = aircraft[:-3].copy()
    weak["estimate"]["acceleration_ned"] *= 0.1  # within the range of the message
    force = encoded(weak)["specific_force"] * 1e-3
    up = rotation_ned_body(weak["estimate"]["euler"]).swapaxes(1, 2)
    wanted = weak["estimate"]["acceleration_ned"] - (0.0, 0.0, GRAVITY)
    by_hand = np.einsum("nij,nj->ni", up, wanted) / GRAVITY
    assert np.abs(force - by_hand).max() <= 0.5001e-3
    own = decoded(weak, IMU)["acceleration_ned"]
    assert np.abs(own - weak["estimate"]["acceleration_ned"]).max() < 0.01
    # level and unaccelerated: 1 g upwards
    level = allocate(AIRCRAFT, 1)
    assert encoded(level)["specific_force"].tolist() == [[0, 0, -1000]]


LIMITS = AttitudeLimits(*(np.radians([each]) for each in (50.0, 20.0, -15.0)))


@pytest.mark.parametrize(
    "command",
    [
        FbwaCommand(pitch=0.1, roll=-0.5, throttle=0.3),
        FbwaCommand(pitch=-0.2617, roll=0.8, throttle=1.0),
        FbwaCommand(pitch=1.0, roll=1.3, throttle=1.2),
        FbwaCommand(pitch=-1.0, roll=-1.3, throttle=-0.1),
        FbwaCommand(pitch=0.0, roll=0.0, throttle=0.0),
    ],
)
def test_command_is_what_a_vehicle_takes(command):
    """By a frame of SET_ATTITUDE_TARGET to a vehicle with these limits, to the bit."""
    aircraft, targets = allocate(AIRCRAFT, 1), allocate(ATTITUDE_TARGET, 1)
    for name, value in command._asdict().items():
        aircraft["control"][name] = value
    encode_attitude_targets(np.arange(1), aircraft, targets)
    control = RecordingControl()
    VehicleClient(control).send(
        "SET_ATTITUDE_TARGET",
        time_boot_ms=0,
        target_system=1,
        target_component=1,
        type_mask=7,
        q=targets["q"][0].tolist(),
        body_roll_rate=0.0,
        body_pitch_rate=0.0,
        body_yaw_rate=0.0,
        thrust=float(targets["thrust"][0]),
    )
    ((_, taken, attitude, _),) = control.calls
    assert attitude
    assert FbwaCommand(*decode_attitude_target(targets[0], LIMITS, 0)) == taken
    limits = (20.0 if command.pitch > 0.0 else 15.0), 50.0
    for found, given, limit in zip(taken, command[:2], np.radians(limits), strict=False):
        assert found == pytest.approx(math.copysign(min(abs(given), limit), given), abs=1e-7)
        assert found != given or given in (0.0, *np.radians([20.0]))


def test_angles_are_the_same_in_kernels():
    """A vehicle takes them in Python, and a flight in a kernel."""
    random = np.random.default_rng(7)
    targets = allocate(ATTITUDE_TARGET, 300)
    quaternion = random.normal(size=(300, 4))
    targets["q"] = quaternion / np.linalg.norm(quaternion, axis=1)[:, None]
    wide = AttitudeLimits(np.array([4.0]), np.array([4.0]), np.array([-4.0]))
    for target in targets:
        w, x, y, z = (float(each) for each in target["q"])
        roll, pitch, _ = angles_from_quaternion(x, y, z, w)
        assert decode_attitude_target(target, wide, 0)[:2] == (pitch, roll)
        euler = euler_from_quaternion(np.array([x, y, z, w]))
        assert angles_from_quaternion(x, y, z, w) == pytest.approx(euler, abs=1e-14)


def test_codec_keeps_the_digits_of_a_target():
    """The numbers of a record are those of single precision that a frame has."""
    targets = allocate(ATTITUDE_TARGET, 1)
    aircraft = allocate(AIRCRAFT, 1)
    aircraft["control"]["roll"], aircraft["control"]["throttle"] = 0.3, 0.7
    encode_attitude_targets(np.arange(1), aircraft, targets)
    fields = {"time_boot_ms": 0, "target_system": 1, "target_component": 1, "type_mask": 7}
    fields |= dict.fromkeys(("body_roll_rate", "body_pitch_rate", "body_yaw_rate"), 0.0)
    sent = {"q": targets["q"][0].tolist(), "thrust": float(targets["thrust"][0])}
    frame = Codec(1, 191).pack("SET_ATTITUDE_TARGET", **fields, **sent)
    (found,) = Codec(2, 1).feed(frame, datagram=True)
    assert [*found.fields["q"], found.fields["thrust"]] == [*sent["q"], sent["thrust"]]
    exact = Codec(1, 191).pack("SET_ATTITUDE_TARGET", **fields, **sent | {"thrust": 0.7})
    (found,) = Codec(2, 1).feed(exact, datagram=True)
    assert found.fields["thrust"] != 0.7
