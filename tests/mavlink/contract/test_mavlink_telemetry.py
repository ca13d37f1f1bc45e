"""Telemetry: each field by independent arithmetic, the rate of each message, no exceptions."""

import math
from collections import Counter

import numpy as np
import pytest
from mavlink_control import ORIGIN, TO, RecordingControl, VehicleClient, fields_of, item, sample
from scipy.spatial.transform import Rotation

from testbed.core.frames import rotation_ned_body
from testbed.mavlink.codec import constant
from testbed.mavlink.telemetry_messages import TELEMETRY_MESSAGES
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.telemetry_status import firmware
from testbed.mavlink.vehicle_control import FlightMode, NavigationTarget

TICK = 40  # 1.6 s, when every message but HOME_POSITION has been sent


def everything(client, tick=TICK, **changes):
    """Request every telemetry message at a tick."""
    client.update(tick, **changes)
    found = {}
    for name in TELEMETRY_MESSAGES:
        asked = float(constant(f"MAVLINK_MSG_ID_{name}"))
        messages = [each for each in client.command(512, asked) if each.name == name]
        found |= {each.name: each.fields for each in messages}
    return found


@pytest.fixture(scope="module")
def current():
    return sample(TICK, 3)


@pytest.fixture(scope="module")
def messages():
    """Request every message of the second follower."""
    client = VehicleClient(RecordingControl("uav2"), count=3, row=2)
    client.vehicle.system = 1  # the target of `command`
    return everything(client)


def test_attitude_is_the_estimate(messages, current):
    roll, pitch, yaw = current.estimate.euler[2]
    fields = messages["ATTITUDE"]
    assert fields["time_boot_ms"] == 1600
    assert (fields["roll"], fields["pitch"]) == pytest.approx((roll, pitch), abs=1e-6)
    assert -math.pi <= fields["yaw"] <= math.pi
    assert math.cos(fields["yaw"] - yaw) == pytest.approx(1.0, abs=1e-12)
    rates = [fields[name] for name in ("rollspeed", "pitchspeed", "yawspeed")]
    assert rates == pytest.approx([0.1, 0.2, 0.3], abs=1e-6)


def test_quaternion_agrees_with_euler_angles(messages, current):
    w, *xyz = (messages["ATTITUDE_QUATERNION"][f"q{n}"] for n in range(1, 5))
    rotation = Rotation.from_quat([*xyz, w]).as_matrix()
    # single precision
    assert rotation == pytest.approx(rotation_ned_body(current.estimate.euler[2]), abs=1e-6)


def test_position_is_the_estimate(messages, current):
    north, east, down = current.estimate.position_ned[2]
    local, place = messages["LOCAL_POSITION_NED"], messages["GLOBAL_POSITION_INT"]
    assert [local[axis] for axis in "xyz"] == pytest.approx([north, east, down], abs=1e-4)
    assert place["relative_alt"] == round(-down * 1e3)
    assert place["alt"] == round((300.0 - down) * 1e3)
    # the earth as a sphere: its radius is within 1 % of the ellipsoid's radii of curvature
    back = math.radians(place["lat"] * 1e-7 - ORIGIN.latitude_deg) * 6_371_000.0
    right = math.radians(place["lon"] * 1e-7 - ORIGIN.longitude_deg) * 6_371_000.0
    right *= math.cos(math.radians(ORIGIN.latitude_deg))
    assert (back, right) == pytest.approx((north, east), rel=0.01, abs=0.02)
    for axis, speed in zip("xyz", current.estimate.velocity_ned[2], strict=True):
        assert place[f"v{axis}"] == round(100 * speed)
        assert local[f"v{axis}"] == pytest.approx(speed, abs=1e-5)
    assert place["hdg"] / 100 == pytest.approx(
        math.degrees(current.estimate.euler[2, 2]) % 360, abs=0.01
    )


def test_gps_fix_is_at_the_estimate(messages):
    fix, place = messages["GPS_RAW_INT"], messages["GLOBAL_POSITION_INT"]
    assert [fix[name] for name in ("lat", "lon", "alt")] == [
        place[n] for n in ("lat", "lon", "alt")
    ]
    assert fix["fix_type"] == constant("GPS_FIX_TYPE_3D_FIX")
    assert fix["vel"] == 2200
    # on this circle course equals heading
    assert fix["cog"] == place["hdg"]


def test_vfr_hud_has_speeds_height_and_throttle(messages):
    hud = messages["VFR_HUD"]
    assert (hud["airspeed"], hud["throttle"]) == (22.0, 30)
    assert hud["groundspeed"] == pytest.approx(22.0, abs=1e-5)
    assert hud["climb"] == pytest.approx(-0.22, abs=1e-6)
    assert hud["alt"] == pytest.approx(500.0)
    assert hud["heading"] == pytest.approx(messages["GLOBAL_POSITION_INT"]["hdg"] / 100, abs=0.51)


def test_wind_direction_is_where_it_comes_from(messages):
    # 3 m/s to the north and 4 m/s to the west: from 126.9°
    wind = messages["WIND"]
    assert wind["direction"] == pytest.approx(180.0 - math.degrees(math.atan2(4, 3)), abs=1e-4)
    assert (wind["speed"], wind["speed_z"]) == (5.0, 0.5)


@pytest.mark.parametrize(
    ("wind", "degrees"),
    [((0.0, -5.0, 0.0), 90.0), ((0.0, 5.0, 0.0), -90.0), ((-5.0, 0.0, 0.0), 0.0)]
    + [((0.0, 0.0, 0.0), 0.0), ((1e-9, -1e-9, 0.0), 0.0), ((0.0, -0.0, -3.0), 0.0)],
)
def test_wind_direction_range_and_still_air(wind, degrees):
    client = VehicleClient()
    current = sample(0)
    air = current.air._replace(wind_ned=np.array([wind]))
    client.vehicle.update(TelemetrySnapshot(current._replace(air=air), ORIGIN), 0.0)
    (messages,) = fields_of(client.command(512, 168.0), "WIND")
    assert messages["direction"] == pytest.approx(degrees, abs=1e-5)


def test_aoa_ssa_is_sent_on_request(messages):
    assert messages["AOA_SSA"]["AOA"] == pytest.approx(math.degrees(0.05), abs=1e-5)
    assert messages["AOA_SSA"]["SSA"] == 0.0


def test_servo_outputs_are_those_of_recordings(messages):
    # aileron +0.2, elevator −0.4, throttle 0.3, rudder +0.1
    servos = [messages["SERVO_OUTPUT_RAW"][f"servo{n}_raw"] for n in range(1, 6)]
    assert servos == [1600, 1700, 1300, 1450, 0]


def test_rc_channels_correspond_to_the_command(messages):
    # roll −0.5 rad of 50°, pitch 0.1 rad of 20°, throttle 0.25
    channels = messages["RC_CHANNELS"]
    roll = 1500 - 500 * 0.5 / math.radians(50)
    pitch = 1500 + 500 * 0.1 / math.radians(20)
    assert [channels[f"chan{n}_raw"] for n in range(1, 6)] == [
        round(roll),
        round(pitch),
        1250,
        1500,
        65535,
    ]


def test_nav_output_of_follower_is_way_to_slot(messages):
    nav = messages["NAV_CONTROLLER_OUTPUT"]
    # the limit of roll, and with it the demand, shrinks with the pitch
    assert nav["nav_roll"] == pytest.approx(math.degrees(-0.5) * math.cos(0.05), abs=1e-4)
    assert nav["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-4)
    # it is 3 m north, 4 m east and 12 m below its slot
    assert (nav["wp_dist"], nav["alt_error"]) == (5, 12.0)
    assert nav["target_bearing"] == round(math.degrees(math.atan2(-4, -3)))
    assert messages["NAMED_VALUE_FLOAT"]["name"] == "err_m"
    assert messages["NAMED_VALUE_FLOAT"]["value"] == 13.0


def way_of(control, *, row=0, tick=TICK):
    """Return NAV_CONTROLLER_OUTPUT of an aircraft."""
    client = VehicleClient(control, count=2, row=row)
    client.vehicle.system = 1
    return everything(client, tick)["NAV_CONTROLLER_OUTPUT"]


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("mode", FlightMode)
def test_nav_output_is_way_to_guidance_target(mode, row):
    north, east, down = sample(TICK, 2).estimate.position_ned[row]
    control = RecordingControl()
    control.mode = mode
    control.target = NavigationTarget(
        north - 300.0, east + 400.0, -down + 20.0, 24.0, math.pi, -7.0
    )
    nav = way_of(control, row=row)
    assert nav["wp_dist"] == 500
    assert nav["target_bearing"] == round(math.degrees(math.atan2(400, -300)))
    assert abs(nav["nav_bearing"]) == 180
    # it flies at 22.5 m/s; single precision resolves positions to a third of a millimetre
    errors = [nav[name] for name in ("alt_error", "aspd_error", "xtrack_error")]
    assert errors == pytest.approx([20.0, 1.5, -7.0], abs=1e-4)


@pytest.mark.parametrize(
    ("row", "mode"), [(0, FlightMode.FBWA), (1, FlightMode.GUIDED), (1, FlightMode.LOITER)]
)
def test_nav_output_without_target_is_zero(row, mode):
    control = RecordingControl()
    control.mode = mode
    nav = way_of(control, row=row)
    assert {value for name, value in nav.items() if name not in ("nav_roll", "nav_pitch")} == {0}


def test_nav_pitch_excludes_stab_pitch_down():
    control = RecordingControl()
    control.parameters |= {"STAB_PITCH_DOWN": 2.0, "TRIM_THROTTLE": 40.0}
    # throttle 0.3 of a trim of 0.4: a quarter of the 2°
    assert way_of(control)["nav_pitch"] == pytest.approx(math.degrees(0.1) - 0.5, abs=1e-5)
    control.parameters["TRIM_THROTTLE"] = 10.0
    assert way_of(control)["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-5)
    control.parameters["TRIM_THROTTLE"] = 0.0
    assert way_of(control)["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-5)


def test_nav_pitch_down_shrinks_with_bank():
    client = VehicleClient()
    current = sample(0)
    command = current.command._replace(pitch=np.array([-0.1]))
    client.vehicle.update(TelemetrySnapshot(current._replace(command=command), ORIGIN), 0.0)
    (nav,) = fields_of(client.command(512, 62.0), "NAV_CONTROLLER_OUTPUT")
    assert nav["nav_pitch"] == pytest.approx(math.degrees(-0.1) * math.cos(0.4), abs=1e-5)


def test_crosstrack_error_is_positive_to_the_left():
    client = VehicleClient(count=2, row=1)
    client.vehicle.system = 1
    current = sample(0, 2)
    for course, error, across in ((0.0, (0, 2, 0), -2.0), (math.pi / 2, (2, 0, 0), 2.0)):
        formation = current.formation._replace(
            course_desired=np.array([course]), estimated_error_ned=np.array([error], dtype=float)
        )
        changed = TelemetrySnapshot(current._replace(formation=formation), ORIGIN)
        client.transfer(client.vehicle.update(changed, 0.0))
        nav = fields_of(client.command(512, 62.0), "NAV_CONTROLLER_OUTPUT")[0]
        assert nav["xtrack_error"] == pytest.approx(across)


def test_leader_reports_no_slot_error():
    messages = everything(VehicleClient(count=2))
    assert messages["NAV_CONTROLLER_OUTPUT"]["wp_dist"] == 0
    assert "NAMED_VALUE_FLOAT" not in messages


def test_healthy_vehicle_has_all_health_bits():
    status = everything(VehicleClient())["SYS_STATUS"]
    present, health = (status[f"onboard_control_sensors_{name}"] for name in ("present", "health"))
    assert present & health == present
    assert present == status["onboard_control_sensors_enabled"]
    names = ("SENSOR_3D_GYRO", "SENSOR_3D_ACCEL", "SENSOR_3D_MAG", "SENSOR_GPS", "PREARM_CHECK")
    for name in (*names, "AHRS", "SENSOR_RC_RECEIVER"):
        assert present & constant(f"MAV_SYS_STATUS_{name}"), name
    assert not present & constant("MAV_SYS_STATUS_SENSOR_BATTERY")
    assert (status["voltage_battery"], status["battery_remaining"]) == (65535, -1)


@pytest.mark.parametrize(
    ("state", "heartbeat", "landed"),
    [("flying", "ACTIVE", "IN_AIR"), ("failsafe", "CRITICAL", "IN_AIR")]
    + [("lost", "EMERGENCY", "ON_GROUND")],
)
def test_heartbeat_and_status_show_the_state(state, heartbeat, landed):
    client = VehicleClient()
    client.control.failsafe = state == "failsafe"
    messages = everything(client, lost=(0,) if state == "lost" else ())
    assert messages["HEARTBEAT"]["system_status"] == constant(f"MAV_STATE_{heartbeat}")
    landed_state = messages["EXTENDED_SYS_STATE"]["landed_state"]
    assert landed_state == constant(f"MAV_LANDED_STATE_{landed}")
    health = messages["SYS_STATUS"]["onboard_control_sensors_health"]
    armable = bool(health & constant("MAV_SYS_STATUS_PREARM_CHECK"))
    receiver_works = bool(health & constant("MAV_SYS_STATUS_SENSOR_RC_RECEIVER"))
    assert (armable, receiver_works) == (state != "lost", state != "failsafe")


def test_battery_is_reported_unhealthy_when_empty():
    client = VehicleClient()
    bit = constant("MAV_SYS_STATUS_SENSOR_BATTERY")
    for charge, left in ((0.8, 80), (0.0, 0)):
        messages = everything(client, charge=charge)
        status, battery = messages["SYS_STATUS"], messages["BATTERY_STATUS"]
        assert status["battery_remaining"] == battery["battery_remaining"] == left
        assert status["voltage_battery"] == battery["voltages"][0] == round(charge * 24e3)
        assert bool(status["onboard_control_sensors_health"] & bit) == (left > 0)
    none = everything(client)["BATTERY_STATUS"]
    assert (none["battery_remaining"], none["voltages"][0]) == (-1, 65535)


@pytest.mark.parametrize("mode", FlightMode)
@pytest.mark.parametrize("armed", [False, True])
def test_heartbeat_has_arduplane_mode_bits(mode, armed):
    client = VehicleClient()
    client.control.mode, client.control.armed = mode, armed
    heartbeat = everything(client)["HEARTBEAT"]
    assert heartbeat["type"] == constant("MAV_TYPE_FIXED_WING")
    assert heartbeat["autopilot"] == constant("MAV_AUTOPILOT_ARDUPILOTMEGA")
    flags = {"CUSTOM_MODE", "STABILIZE", "MANUAL_INPUT" if mode is FlightMode.FBWA else "GUIDED"}
    flags |= {"SAFETY"} if armed else set()
    names = {
        "CUSTOM_MODE": "CUSTOM_MODE_ENABLED",
        "STABILIZE": "STABILIZE_ENABLED",
        "MANUAL_INPUT": "MANUAL_INPUT_ENABLED",
        "GUIDED": "GUIDED_ENABLED",
        "SAFETY": "SAFETY_ARMED",
    }
    assert heartbeat["base_mode"] == sum(constant(f"MAV_MODE_FLAG_{names[flag]}") for flag in flags)


def test_home_and_origin_are_those_of_scenario():
    messages = everything(VehicleClient())
    for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
        place = [messages[name][axis] for axis in ("latitude", "longitude", "altitude")]
        assert place == [380000000, -35000000, 300000]


def test_mission_total_excludes_home():
    client = VehicleClient()
    none = everything(client)["MISSION_CURRENT"]["mission_state"]
    assert none == constant("MISSION_STATE_NO_MISSION")
    client.control.mission = (item(),) * 5
    assert everything(client)["MISSION_CURRENT"]["mission_state"] == constant(
        "MISSION_STATE_PAUSED"
    )
    client.control.mode = FlightMode.AUTO
    current = everything(client)["MISSION_CURRENT"]
    assert (current["seq"], current["total"]) == (1, 4)
    assert current["mission_state"] == constant("MISSION_STATE_ACTIVE")


def test_version_and_capabilities():
    messages = everything(VehicleClient())["AUTOPILOT_VERSION"]
    assert messages["flight_sw_version"] == firmware("1.12.3") == 0x010C03FF
    assert firmware("0.7") == 0x000700FF
    assert firmware("1.2.3.dev4+g12") == 0x01020300
    assert firmware("?") == 0
    for name in ("MISSION_INT", "PARAM_FLOAT", "MAVLINK2", "COMMAND_INT", "SET_ATTITUDE_TARGET"):
        assert messages["capabilities"] & constant(f"MAV_PROTOCOL_CAPABILITY_{name}")
    assert not messages["capabilities"] & constant("MAV_PROTOCOL_CAPABILITY_FTP")


def test_uid_is_unique_and_reproducible():
    def uid(name, row):
        client = VehicleClient(RecordingControl(name), count=3, row=row)
        client.vehicle.system = 1
        return everything(client)["AUTOPILOT_VERSION"]["uid"]

    uids = [uid("leader", 0), uid("uav1", 1), uid("uav2", 2)]
    assert len(set(uids)) == 3
    assert uids == [uid("leader", 0), uid("uav1", 1), uid("uav2", 2)]


def test_system_time_counts_from_the_epoch():
    clock = everything(VehicleClient())["SYSTEM_TIME"]
    assert clock == {"time_unix_usec": 10**15 + 1_600_000, "time_boot_ms": 1600}


@pytest.mark.parametrize("rate_hz", [50, 25, 30])
def test_messages_have_their_default_rates(rate_hz):
    client = VehicleClient(count=2, row=1, update=False, rate_hz=rate_hz)
    counts = Counter(m.name for tick in range(10 * rate_hz) for m in client.update(tick))
    for name, entry in TELEMETRY_MESSAGES.items():
        # the first at 0 s; one less where samples are not at multiples of the interval
        assert counts[name] in {math.ceil(10 * entry.rate_hz), round(10 * entry.rate_hz)}, name


def test_rates_are_limited_to_the_sample_rate():
    client = VehicleClient(update=False, rate_hz=5)
    counts = Counter(m.name for tick in range(50) for m in client.update(tick))
    assert max(counts.values()) == counts["ATTITUDE"] == 50


def test_intervals_and_streams_change_rates():
    client = VehicleClient()
    client.command(511, 30.0, 50_000.0)
    client.command(511, 1.0, -1.0)
    stream = {**TO, "req_stream_id": 11, "req_message_rate": 2, "start_stop": 1}
    client.send("REQUEST_DATA_STREAM", **stream)
    client.send("REQUEST_DATA_STREAM", **(stream | {"req_stream_id": 3, "start_stop": 0}))
    client.send("REQUEST_DATA_STREAM", **(stream | {"req_stream_id": 99}))
    counts = Counter(m.name for tick in range(1, 251) for m in client.update(tick))
    # a requested rate starts at once
    assert (counts["ATTITUDE"], counts["VFR_HUD"]) == (201, 21)
    assert counts["SYS_STATUS"] == counts["RC_CHANNELS"] == counts["SERVO_OUTPUT_RAW"] == 0
    assert counts["LOCAL_POSITION_NED"] == 100
    assert counts["HEARTBEAT"] == 10


def test_disabling_all_streams_keeps_heartbeat():
    client = VehicleClient()
    client.send("REQUEST_DATA_STREAM", **TO, req_stream_id=0, req_message_rate=0, start_stop=0)
    for number_ in (245, 242, 251, 0):
        client.command(511, float(number_), -1.0)
    assert {m.name for tick in range(1, 51) for m in client.update(tick)} == {"HEARTBEAT"}


def test_lockstep_sends_state_with_every_sample():
    client = VehicleClient(RecordingControl(lockstep=True))
    client.command(511, 30.0, -1.0)
    client.send("REQUEST_DATA_STREAM", **TO, req_stream_id=0, req_message_rate=1, start_stop=1)
    for tick in range(1, 26):
        names = [m.name for m in client.update(tick)]
        assert names.count("LOCAL_POSITION_NED") == 1
        assert names[-1] == "ATTITUDE"
    reported = fields_of(client.command(510, 30.0), "MESSAGE_INTERVAL")[0]
    assert reported["interval_us"] == 40_000


def test_waiting_run_sends_heartbeats():
    client = VehicleClient()
    beats = sum(len(fields_of(client.poll(0.1), "HEARTBEAT")) for _ in range(60))
    assert beats == 4  # in 6 s, every 1.5 s
    client.update(25)
    assert fields_of(client.poll(0.1), "HEARTBEAT") == []


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e300, -1e300])
def test_state_that_is_not_finite_is_sent(wrong):
    client = VehicleClient(count=2, row=1, update=False)
    current = sample(0, 2)
    broken = current.estimate._make(np.full_like(each, wrong) for each in current.estimate)
    formation = current.formation._replace(
        estimated_error_ned=np.full((1, 3), wrong),
        error_ned=np.full((1, 3), wrong),
        course_desired=np.full(1, wrong),
        speed=np.full(1, wrong),
    )
    command = current.command._make(np.full(2, wrong) for _ in current.command)
    surfaces = current.surfaces._make(np.full(2, wrong) for _ in current.surfaces)
    air = current.air._replace(
        wind_ned=np.full((2, 3), wrong),
        state_of_charge=np.full(2, wrong),
        battery_voltage=np.full(2, wrong),
    )
    changed = current._replace(
        estimate=broken, formation=formation, command=command, surfaces=surfaces, air=air
    )
    with np.errstate(all="ignore"):
        messages = client.transfer(client.vehicle.update(TelemetrySnapshot(changed, ORIGIN), 0.0))
    always = {name for name, entry in TELEMETRY_MESSAGES.items() if entry.rate_hz}
    assert {m.name for m in messages} == always
