"""Telemetry: each field against arithmetic of its own, each rate counted, nothing that raises."""

import math
from collections import Counter

import numpy as np
import pytest
from links_cockpit import ORIGIN, TO, Notebook, Talk, frame, item, named

from testbed.frames import rotation_ned_body
from testbed.links.catalogue import CATALOGUE
from testbed.links.cockpit import Mode, Target
from testbed.links.scene import Scene
from testbed.links.status import firmware
from testbed.mavlink.door import number

TICK = 40  # 1.6 s, when every message but HOME_POSITION has been said


def everything(talk, tick=TICK, **changes):
    """Each message of the catalogue as it is at a tick."""
    talk.look(tick, **changes)
    found = {}
    for name in CATALOGUE:
        asked = float(number(f"MAVLINK_MSG_ID_{name}"))
        said = [each for each in talk.order(512, asked) if each.name == name]
        found |= {each.name: each.fields for each in said}
    return found


@pytest.fixture(scope="module")
def seen():
    return frame(TICK, 3)


@pytest.fixture(scope="module")
def said():
    """Of the second follower."""
    talk = Talk(Notebook("uav2"), count=3, row=2)
    talk.vehicle.system = 1  # as which `order` asks it
    return everything(talk)


def test_the_attitude_is_the_estimates(said, seen):
    roll, pitch, yaw = seen.estimate.euler[2]
    fields = said["ATTITUDE"]
    assert fields["time_boot_ms"] == 1600
    assert (fields["roll"], fields["pitch"]) == pytest.approx((roll, pitch), abs=1e-6)
    assert -math.pi <= fields["yaw"] <= math.pi
    assert math.cos(fields["yaw"] - yaw) == pytest.approx(1.0, abs=1e-12)
    rates = [fields[name] for name in ("rollspeed", "pitchspeed", "yawspeed")]
    assert rates == pytest.approx([0.1, 0.2, 0.3], abs=1e-6)


def test_the_quaternion_turns_as_the_angles_do(said, seen):
    w, x, y, z = (said["ATTITUDE_QUATERNION"][f"q{n}"] for n in range(1, 5))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    # single precision
    assert rotation == pytest.approx(rotation_ned_body(seen.estimate.euler[2]), abs=1e-6)


def test_the_place_is_the_estimates_in_degrees_and_in_metres(said, seen):
    north, east, down = seen.estimate.position_ned[2]
    local, place = said["LOCAL_POSITION_NED"], said["GLOBAL_POSITION_INT"]
    assert [local[axis] for axis in "xyz"] == pytest.approx([north, east, down], abs=1e-4)
    assert place["relative_alt"] == round(-down * 1e3)
    assert place["alt"] == round((300.0 - down) * 1e3)
    # the earth as a sphere of its radius of curvature: within 1 % of the ellipsoid's
    back = math.radians(place["lat"] * 1e-7 - ORIGIN.latitude_deg) * 6_371_000.0
    right = math.radians(place["lon"] * 1e-7 - ORIGIN.longitude_deg) * 6_371_000.0
    right *= math.cos(math.radians(ORIGIN.latitude_deg))
    assert (back, right) == pytest.approx((north, east), rel=0.01, abs=0.02)
    for axis, speed in zip("xyz", seen.estimate.velocity_ned[2], strict=True):
        assert place[f"v{axis}"] == round(100 * speed)
        assert local[f"v{axis}"] == pytest.approx(speed, abs=1e-5)
    assert place["hdg"] / 100 == pytest.approx(
        math.degrees(seen.estimate.euler[2, 2]) % 360, abs=0.01
    )


def test_the_fix_is_three_dimensional_and_where_the_autopilot_is(said):
    fix, place = said["GPS_RAW_INT"], said["GLOBAL_POSITION_INT"]
    assert [fix[name] for name in ("lat", "lon", "alt")] == [
        place[n] for n in ("lat", "lon", "alt")
    ]
    assert fix["fix_type"] == number("GPS_FIX_TYPE_3D_FIX")
    assert fix["vel"] == 2200
    # on this circle it flies as it looks
    assert fix["cog"] == place["hdg"]


def test_the_display_has_speeds_height_and_throttle(said):
    hud = said["VFR_HUD"]
    assert (hud["airspeed"], hud["throttle"]) == (22.0, 30)
    assert hud["groundspeed"] == pytest.approx(22.0, abs=1e-5)
    assert hud["climb"] == pytest.approx(-0.22, abs=1e-6)
    assert hud["alt"] == pytest.approx(500.0)
    assert hud["heading"] == pytest.approx(said["GLOBAL_POSITION_INT"]["hdg"] / 100, abs=0.51)


def test_the_wind_comes_from_where_it_comes_from(said):
    # 3 m/s to the north and 4 m/s to the west: from 126.9°
    wind = said["WIND"]
    assert wind["direction"] == pytest.approx(180.0 - math.degrees(math.atan2(4, 3)), abs=1e-4)
    assert (wind["speed"], wind["speed_z"]) == (5.0, 0.5)


@pytest.mark.parametrize(
    ("wind", "degrees"),
    [((0.0, -5.0, 0.0), 90.0), ((0.0, 5.0, 0.0), -90.0), ((-5.0, 0.0, 0.0), 0.0)]
    + [((0.0, 0.0, 0.0), 0.0), ((1e-9, -1e-9, 0.0), 0.0), ((0.0, -0.0, -3.0), 0.0)],
)
def test_the_wind_is_told_in_arduplanes_range_and_still_air_comes_from_nowhere(wind, degrees):
    talk = Talk()
    seen = frame(0)
    air = seen.air._replace(wind_ned=np.array([wind]))
    talk.vehicle.look(Scene(seen._replace(air=air), ORIGIN), 0.0)
    (said,) = named(talk.order(512, 168.0), "WIND")
    assert said["direction"] == pytest.approx(degrees, abs=1e-5)


def test_the_angles_of_the_air_are_told_on_request(said):
    assert said["AOA_SSA"]["AOA"] == pytest.approx(math.degrees(0.05), abs=1e-5)
    assert said["AOA_SSA"]["SSA"] == 0.0


def test_servos_are_shown_as_recordings_have_them(said):
    # aileron +0.2, elevator −0.4, throttle 0.3, rudder +0.1
    servos = [said["SERVO_OUTPUT_RAW"][f"servo{n}_raw"] for n in range(1, 6)]
    assert servos == [1600, 1700, 1300, 1450, 0]


def test_sticks_are_shown_as_they_would_ask_for_the_command(said):
    # roll −0.5 rad of 50°, pitch 0.1 rad of 20°, throttle 0.25
    channels = said["RC_CHANNELS"]
    roll = 1500 - 500 * 0.5 / math.radians(50)
    pitch = 1500 + 500 * 0.1 / math.radians(20)
    assert [channels[f"chan{n}_raw"] for n in range(1, 6)] == [
        round(roll),
        round(pitch),
        1250,
        1500,
        65535,
    ]


def test_a_follower_tells_its_command_and_its_way_to_its_slot(said):
    nav = said["NAV_CONTROLLER_OUTPUT"]
    assert nav["nav_roll"] == pytest.approx(math.degrees(-0.5), abs=1e-4)
    assert nav["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-4)
    # it is 3 m north, 4 m east and 12 m below its slot
    assert (nav["wp_dist"], nav["alt_error"]) == (5, 12.0)
    assert nav["target_bearing"] == round(math.degrees(math.atan2(-4, -3)))
    assert said["NAMED_VALUE_FLOAT"]["name"] == "err_m"
    assert said["NAMED_VALUE_FLOAT"]["value"] == 13.0


def way_of(cockpit, *, row=0, tick=TICK):
    """NAV_CONTROLLER_OUTPUT of an aircraft."""
    talk = Talk(cockpit, count=2, row=row)
    talk.vehicle.system = 1
    return everything(talk, tick)["NAV_CONTROLLER_OUTPUT"]


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("mode", Mode)
def test_the_way_to_where_guidance_goes_is_told_in_every_mode(mode, row):
    north, east, down = frame(TICK, 2).estimate.position_ned[row]
    cockpit = Notebook()
    cockpit.mode = mode
    cockpit.target = Target(north - 300.0, east + 400.0, -down + 20.0, 24.0, math.pi, -7.0)
    nav = way_of(cockpit, row=row)
    assert nav["wp_dist"] == 500
    assert nav["target_bearing"] == round(math.degrees(math.atan2(400, -300)))
    assert abs(nav["nav_bearing"]) == 180
    # it flies at 22.5 m/s; places are known to a third of a millimetre in single precision
    errors = [nav[name] for name in ("alt_error", "aspd_error", "xtrack_error")]
    assert errors == pytest.approx([20.0, 1.5, -7.0], abs=1e-4)


@pytest.mark.parametrize(("row", "mode"), [(0, Mode.FBWA), (1, Mode.GUIDED), (1, Mode.LOITER)])
def test_who_goes_nowhere_tells_no_way_and_no_slot_outside_the_formation(row, mode):
    cockpit = Notebook()
    cockpit.mode = mode
    nav = way_of(cockpit, row=row)
    assert {value for name, value in nav.items() if name not in ("nav_roll", "nav_pitch")} == {0}


def test_the_pitch_is_told_without_what_the_autopilot_takes_off_it():
    cockpit = Notebook()
    cockpit.parameters |= {"STAB_PITCH_DOWN": 2.0, "TRIM_THROTTLE": 40.0}
    # throttle 0.3 of a trim of 0.4: a quarter of the 2°
    assert way_of(cockpit)["nav_pitch"] == pytest.approx(math.degrees(0.1) - 0.5, abs=1e-5)
    cockpit.parameters["TRIM_THROTTLE"] = 10.0
    assert way_of(cockpit)["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-5)
    cockpit.parameters["TRIM_THROTTLE"] = 0.0
    assert way_of(cockpit)["nav_pitch"] == pytest.approx(math.degrees(0.1), abs=1e-5)


def test_an_error_across_the_course_is_left_of_it_when_positive():
    talk = Talk(count=2, row=1)
    talk.vehicle.system = 1
    seen = frame(0, 2)
    for course, error, across in ((0.0, (0, 2, 0), -2.0), (math.pi / 2, (2, 0, 0), 2.0)):
        formation = seen.formation._replace(
            course_desired=np.array([course]), believed_ned=np.array([error], dtype=float)
        )
        changed = Scene(seen._replace(formation=formation), ORIGIN)
        talk.over(talk.vehicle.look(changed, 0.0))
        nav = named(talk.order(512, 62.0), "NAV_CONTROLLER_OUTPUT")[0]
        assert nav["xtrack_error"] == pytest.approx(across)


def test_the_leader_has_no_slot():
    said = everything(Talk(count=2))
    assert said["NAV_CONTROLLER_OUTPUT"]["wp_dist"] == 0
    assert "NAMED_VALUE_FLOAT" not in said


def test_a_healthy_vehicle_is_healthy_in_every_bit():
    status = everything(Talk())["SYS_STATUS"]
    had, works = (status[f"onboard_control_sensors_{name}"] for name in ("present", "health"))
    assert had & works == had
    assert had == status["onboard_control_sensors_enabled"]
    names = ("SENSOR_3D_GYRO", "SENSOR_3D_ACCEL", "SENSOR_3D_MAG", "SENSOR_GPS", "PREARM_CHECK")
    for name in (*names, "AHRS", "SENSOR_RC_RECEIVER"):
        assert had & number(f"MAV_SYS_STATUS_{name}"), name
    assert not had & number("MAV_SYS_STATUS_SENSOR_BATTERY")
    assert (status["voltage_battery"], status["battery_remaining"]) == (65535, -1)


@pytest.mark.parametrize(
    ("state", "beat", "landed"),
    [("flying", "ACTIVE", "IN_AIR"), ("failsafe", "CRITICAL", "IN_AIR")]
    + [("lost", "EMERGENCY", "ON_GROUND")],
)
def test_how_it_is_can_be_told_from_heartbeat_and_status(state, beat, landed):
    talk = Talk()
    talk.cockpit.failsafe = state == "failsafe"
    said = everything(talk, lost=(0,) if state == "lost" else ())
    assert said["HEARTBEAT"]["system_status"] == number(f"MAV_STATE_{beat}")
    landed_state = said["EXTENDED_SYS_STATE"]["landed_state"]
    assert landed_state == number(f"MAV_LANDED_STATE_{landed}")
    works = said["SYS_STATUS"]["onboard_control_sensors_health"]
    armable = bool(works & number("MAV_SYS_STATUS_PREARM_CHECK"))
    heard = bool(works & number("MAV_SYS_STATUS_SENSOR_RC_RECEIVER"))
    assert (armable, heard) == (state != "lost", state != "failsafe")


def test_a_battery_is_told_where_there_is_one_and_is_unhealthy_when_empty():
    talk = Talk()
    bit = number("MAV_SYS_STATUS_SENSOR_BATTERY")
    for charge, left in ((0.8, 80), (0.0, 0)):
        said = everything(talk, charge=charge)
        status, battery = said["SYS_STATUS"], said["BATTERY_STATUS"]
        assert status["battery_remaining"] == battery["battery_remaining"] == left
        assert status["voltage_battery"] == battery["voltages"][0] == round(charge * 24e3)
        assert bool(status["onboard_control_sensors_health"] & bit) == (left > 0)
    none = everything(talk)["BATTERY_STATUS"]
    assert (none["battery_remaining"], none["voltages"][0]) == (-1, 65535)


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("armed", [False, True])
def test_a_heartbeat_has_arduplanes_bits(mode, armed):
    talk = Talk()
    talk.cockpit.mode, talk.cockpit.armed = mode, armed
    beat = everything(talk)["HEARTBEAT"]
    assert beat["type"] == number("MAV_TYPE_FIXED_WING")
    assert beat["autopilot"] == number("MAV_AUTOPILOT_ARDUPILOTMEGA")
    flags = {"CUSTOM_MODE", "STABILIZE", "MANUAL_INPUT" if mode is Mode.FBWA else "GUIDED"}
    flags |= {"SAFETY"} if armed else set()
    names = {
        "CUSTOM_MODE": "CUSTOM_MODE_ENABLED",
        "STABILIZE": "STABILIZE_ENABLED",
        "MANUAL_INPUT": "MANUAL_INPUT_ENABLED",
        "GUIDED": "GUIDED_ENABLED",
        "SAFETY": "SAFETY_ARMED",
    }
    assert beat["base_mode"] == sum(number(f"MAV_MODE_FLAG_{names[flag]}") for flag in flags)


def test_home_and_origin_are_the_scenarios():
    said = everything(Talk())
    for name in ("HOME_POSITION", "GPS_GLOBAL_ORIGIN"):
        place = [said[name][axis] for axis in ("latitude", "longitude", "altitude")]
        assert place == [380000000, -35000000, 300000]


def test_a_mission_is_counted_without_home():
    talk = Talk()
    assert everything(talk)["MISSION_CURRENT"]["mission_state"] == number(
        "MISSION_STATE_NO_MISSION"
    )
    talk.cockpit.mission = (item(),) * 5
    assert everything(talk)["MISSION_CURRENT"]["mission_state"] == number("MISSION_STATE_PAUSED")
    talk.cockpit.mode = Mode.AUTO
    current = everything(talk)["MISSION_CURRENT"]
    assert (current["seq"], current["total"]) == (1, 4)
    assert current["mission_state"] == number("MISSION_STATE_ACTIVE")


def test_the_version_is_the_testbeds_and_files_are_not_promised():
    said = everything(Talk())["AUTOPILOT_VERSION"]
    assert said["flight_sw_version"] == firmware("1.12.3") == 0x010C03FF
    assert firmware("0.7") == 0x000700FF
    assert firmware("1.2.3.dev4+g12") == 0x01020300
    assert firmware("?") == 0
    for name in ("MISSION_INT", "PARAM_FLOAT", "MAVLINK2", "COMMAND_INT", "SET_ATTITUDE_TARGET"):
        assert said["capabilities"] & number(f"MAV_PROTOCOL_CAPABILITY_{name}")
    assert not said["capabilities"] & number("MAV_PROTOCOL_CAPABILITY_FTP")


def test_every_aircraft_is_itself_in_every_run():
    def uid(name, row):
        talk = Talk(Notebook(name), count=3, row=row)
        talk.vehicle.system = 1
        return everything(talk)["AUTOPILOT_VERSION"]["uid"]

    uids = [uid("leader", 0), uid("uav1", 1), uid("uav2", 2)]
    assert len(set(uids)) == 3
    assert uids == [uid("leader", 0), uid("uav1", 1), uid("uav2", 2)]


def test_the_clock_counts_from_the_epoch():
    clock = everything(Talk())["SYSTEM_TIME"]
    assert clock == {"time_unix_usec": 10**15 + 1_600_000, "time_boot_ms": 1600}


@pytest.mark.parametrize("rate_hz", [50, 25, 30])
def test_in_ten_seconds_each_message_comes_as_often_as_it_should(rate_hz):
    talk = Talk(count=2, row=1, look=False, rate_hz=rate_hz)
    counts = Counter(m.name for tick in range(10 * rate_hz) for m in talk.look(tick))
    for name, entry in CATALOGUE.items():
        # the first at 0 s; where frames do not fall on multiples of the interval, one less
        assert counts[name] in {math.ceil(10 * entry.rate_hz), round(10 * entry.rate_hz)}, name


def test_no_rate_is_above_that_of_frames():
    talk = Talk(look=False, rate_hz=5)
    counts = Counter(m.name for tick in range(50) for m in talk.look(tick))
    assert max(counts.values()) == counts["ATTITUDE"] == 50


def test_intervals_and_streams_change_rates():
    talk = Talk()
    talk.order(511, 30.0, 50_000.0)
    talk.order(511, 1.0, -1.0)
    stream = {**TO, "req_stream_id": 11, "req_message_rate": 2, "start_stop": 1}
    talk.ask("REQUEST_DATA_STREAM", **stream)
    talk.ask("REQUEST_DATA_STREAM", **(stream | {"req_stream_id": 3, "start_stop": 0}))
    talk.ask("REQUEST_DATA_STREAM", **(stream | {"req_stream_id": 99}))
    counts = Counter(m.name for tick in range(1, 251) for m in talk.look(tick))
    # what is asked for begins at once
    assert (counts["ATTITUDE"], counts["VFR_HUD"]) == (201, 21)
    assert counts["SYS_STATUS"] == counts["RC_CHANNELS"] == counts["SERVO_OUTPUT_RAW"] == 0
    assert counts["LOCAL_POSITION_NED"] == 100
    assert counts["HEARTBEAT"] == 10


def test_all_streams_off_leave_the_heartbeat():
    talk = Talk()
    talk.ask("REQUEST_DATA_STREAM", **TO, req_stream_id=0, req_message_rate=0, start_stop=0)
    for number_ in (245, 242, 251, 0):
        talk.order(511, float(number_), -1.0)
    assert {m.name for tick in range(1, 51) for m in talk.look(tick)} == {"HEARTBEAT"}


def test_in_lockstep_every_frame_has_the_state_whatever_is_asked():
    talk = Talk(Notebook(lockstep=True))
    talk.order(511, 30.0, -1.0)
    talk.ask("REQUEST_DATA_STREAM", **TO, req_stream_id=0, req_message_rate=1, start_stop=1)
    for tick in range(1, 26):
        names = [m.name for m in talk.look(tick)]
        assert names.count("LOCAL_POSITION_NED") == 1
        assert names[-1] == "ATTITUDE"
    told = named(talk.order(510, 30.0), "MESSAGE_INTERVAL")[0]
    assert told["interval_us"] == 40_000


def test_a_run_that_stands_still_shows_signs_of_life():
    talk = Talk()
    beats = sum(len(named(talk.due(0.1), "HEARTBEAT")) for _ in range(60))
    assert beats == 4  # in 6 s, every 1.5 s
    talk.look(25)
    assert named(talk.due(0.1), "HEARTBEAT") == []


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e300, -1e300])
def test_a_state_that_is_none_is_said_without_breaking_the_link(wrong):
    talk = Talk(count=2, row=1, look=False)
    seen = frame(0, 2)
    broken = seen.estimate._make(np.full_like(each, wrong) for each in seen.estimate)
    formation = seen.formation._replace(
        believed_ned=np.full((1, 3), wrong),
        error_ned=np.full((1, 3), wrong),
        course_desired=np.full(1, wrong),
        speed=np.full(1, wrong),
    )
    command = seen.command._make(np.full(2, wrong) for _ in seen.command)
    surfaces = seen.surfaces._make(np.full(2, wrong) for _ in seen.surfaces)
    air = seen.air._replace(
        wind_ned=np.full((2, 3), wrong),
        state_of_charge=np.full(2, wrong),
        battery_voltage=np.full(2, wrong),
    )
    changed = seen._replace(
        estimate=broken, formation=formation, command=command, surfaces=surfaces, air=air
    )
    with np.errstate(all="ignore"):
        said = talk.over(talk.vehicle.look(Scene(changed, ORIGIN), 0.0))
    always = {name for name, entry in CATALOGUE.items() if entry.rate_hz}
    assert {m.name for m in said} == always
