"""A control that records commands, samples of circling aircraft, and a client of one vehicle."""

import math

import numpy as np

from testbed.core.records import (
    ActuatorCommand,
    AirData,
    FbwaCommand,
    FormationState,
    LinkCounters,
    NedOrigin,
    RunInfo,
    Sample,
    VehicleState,
)
from testbed.mavlink.codec import Codec
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.vehicle import MavlinkVehicle
from testbed.mavlink.vehicle_control import FlightMode, MissionItem, Rejection, VehicleControl

ORIGIN = NedOrigin(38.0, -3.5, 300.0)
WAYPOINT = 16


def item(command=WAYPOINT, *, x=38.001, y=-3.501, z=100.0, frame=3, parameters=(0.0,) * 4):
    return MissionItem(command, frame, parameters, x, y, z)


class RecordingControl(VehicleControl):
    """Executes and records every command."""

    parameters = mission = current_item = target = None  # plain attributes here

    def __init__(self, name="leader", *, external=True, lockstep=False):
        self.name, self.external, self.lockstep = name, external, lockstep
        self.mode, self.armed, self.failsafe, self.current_item = FlightMode.FBWA, True, False, 1
        self.parameters = {
            "ROLL_LIMIT_DEG": 50.0,
            "PTCH_LIM_MAX_DEG": 20.0,
            "PTCH_LIM_MIN_DEG": -15.0,
            "TRIM_THROTTLE": 22.0,
            "AIRSPEED_CRUISE": 22.0,
            **{f"NUMBER_{n}": float(n) for n in range(30)},
        }
        self.mission = ()
        self.target = None
        self.calls = []
        self.rejections = {}

    def _record(self, name, *given):
        self.calls.append((name, *given))
        return self.rejections.get(name)

    def set_mode(self, mode):
        if rejection := self._record("set_mode", mode):
            return rejection
        self.mode = mode
        return None

    def set_armed(self, armed, *, force):
        if rejection := self._record("set_armed", armed, force):
            return rejection
        if not armed and not force:
            return Rejection("in flight")
        self.armed = armed
        return None

    def set_parameter(self, name, value):
        if rejection := self._record("set_parameter", name, value):
            return rejection
        if name not in self.parameters:
            return Rejection("no such parameter", supported=False)
        if not abs(value) <= 90.0:
            return Rejection("write -90 to 90")
        self.parameters[name] = value
        return None

    def set_mission(self, items):
        if rejection := self._record("set_mission", tuple(items)):
            return rejection
        self.mission = tuple(items)
        return None

    def set_current_item(self, item):
        if rejection := self._record("set_current_item", item):
            return rejection
        if not 0 < item < len(self.mission):
            return Rejection("no such item")
        self.current_item = item
        return None

    def set_loiter_point(self, latitude_deg, longitude_deg, altitude, radius):
        return self._record("set_loiter_point", latitude_deg, longitude_deg, altitude, radius)

    def set_airspeed(self, airspeed):
        return self._record("set_airspeed", airspeed)

    def set_manual_command(self, command, *, attitude=False, answers_s=None):
        return self._record("set_manual_command", command, attitude, answers_s)


def info(count=1, *, rate_hz=25):
    names = ("leader", *(f"uav{n}" for n in range(1, count)))
    return RunInfo(
        scenario_name="links",
        make_yaml=str,
        names=names,
        aircraft=("rascal110",) * count,
        wingspan_m=(2.8,) * count,
        origin=ORIGIN,
        base_rate_hz=200,
        sample_rate_hz=rate_hz,
        duration_s=60.0,
        seed=1,
        speed_bounds_mps=((15.0, 30.0),) * (count - 1),
        kappa_mps=(1.0,) * (count - 1),
        roll_limit_rad=(0.8,) * (count - 1),
        leader_path_ned=np.zeros((0, 3)),
        windows={},
        versions={"testbed": "1.12.3"},
    )


def sample(tick=0, count=1, *, rate_hz=25, events=(), lost=(), charge=math.nan):
    """Make a sample of aircraft in a circle of 120 m at 22 m/s, 50 m apart in altitude."""
    now, speed, radius = tick / rate_hz, 22.0, 120.0
    turn = now * speed / radius + 0.3 * np.arange(count)
    velocity = speed * np.stack((-np.sin(turn), np.cos(turn), 0.01 + 0 * turn), axis=1)
    position = radius * np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1)
    position[:, 2] = -100.0 - 50.0 * np.arange(count)
    euler = np.stack((0.4 + 0 * turn, 0.05 + 0 * turn, turn + np.pi / 2), axis=1)
    state = VehicleState(
        position_ned=position,
        velocity_ned=velocity,
        acceleration_ned=np.zeros((count, 3)),
        euler=euler,
        rates_body=np.full((count, 3), 0.1) * (1.0, 2.0, 3.0),
        airspeed=np.full(count, 22.5),
        equivalent_airspeed=np.full(count, 22.0),
    )
    one, rows = np.ones(count), max(count - 1, 0)
    air = AirData(
        alpha=0.05 * one,
        beta=0.0 * one,
        propeller_rps=80.0 * one,
        wind_ned=np.tile((3.0, -4.0, 0.5), (count, 1)),
        wind_gradient_rates=np.zeros((count, 3)),
        wake_delta_cl=0.0 * one,
        state_of_charge=charge * one,
        battery_voltage=charge * 24.0 * one,
    )
    error = np.tile((3.0, 4.0, 12.0), (rows, 1))
    formation = FormationState(
        *([np.zeros((rows, 3)), error] + [np.full(rows, 20.0)] * 7),
        limiter_flags=np.zeros(rows, dtype=np.uint8),
        saturations=np.zeros(rows, dtype=np.uint8),
        slot_index=np.arange(1, count, dtype=np.uint32),
        age_s=np.zeros((rows, count)),
        estimated_error_ned=error,
    )
    gone = np.zeros(count, dtype=bool)
    gone[list(lost)] = True
    counts = np.zeros((rows, count), dtype=np.uint32)
    return Sample(
        tick=tick * 200 // rate_hz,
        time_s=now,
        truth=state,
        estimate=state,
        air=air,
        command=FbwaCommand(pitch=0.1 * one, roll=-0.5 * one, throttle=0.25 * one),
        surfaces=ActuatorCommand(0.2 * one, -0.4 * one, 0.1 * one, 0.3 * one),
        formation=formation,
        links=LinkCounters(counts, counts),
        lost=gone,
        events=tuple(events),
    )


class VehicleClient:
    """A ground station of one vehicle; every answer is packed and parsed."""

    def __init__(self, control=None, *, count=1, row=0, update=True, rate_hz=25):
        self.control = control or RecordingControl()
        self.count, self.rate_hz, self.wall_s = count, rate_hz, 1000.0
        self.vehicle = MavlinkVehicle(
            self.control, row + 1, row, info(count, rate_hz=rate_hz), 10**15
        )
        self.codec, self.receiver = Codec(row + 1, 1), Codec(255, 190)
        if update:
            self.update(0)

    def send(self, name, /, *, system=255, component=190, **fields):
        """Send a message and return the answers."""
        sent = message(name, system, component, **fields)
        return self.transfer(self.vehicle.handle(sent, self.wall_s))

    def command(self, command, *numbers, **fields):
        """Send a COMMAND_LONG and return the answers."""
        values = {f"param{n}": 0.0 for n in range(1, 8)}
        values |= {f"param{n}": value for n, value in enumerate(numbers, 1)}
        given = {**TO, "command": command, "confirmation": 0, **values, **fields}
        return self.send("COMMAND_LONG", **given)

    def update(self, tick, **changes):
        """Give the vehicle a sample and return its messages."""
        snapshot = TelemetrySnapshot(
            sample(tick, self.count, rate_hz=self.rate_hz, **changes), ORIGIN
        )
        return self.transfer(self.vehicle.update(snapshot, self.wall_s))

    def poll(self, after_s=0.0):
        """Return the messages some time later, without a sample."""
        self.wall_s += after_s
        return self.transfer(self.vehicle.poll(self.wall_s))

    def transfer(self, replies):
        """Pack and parse messages."""
        frames = [self.codec.pack(reply.name, **reply.fields) for reply in replies]
        return [each for frame in frames for each in self.receiver.feed(frame, datagram=True)]


TO = {"target_system": 1, "target_component": 1}


def message(name, system=255, component=190, /, **fields):
    """Make a message as a vehicle receives it."""
    (received,) = Codec(1, 1).feed(Codec(system, component).pack(name, **fields), datagram=True)
    return received


def fields_of(messages, name):
    return [each.fields for each in messages if each.name == name]


def texts(messages):
    return [each["text"] for each in fields_of(messages, "STATUSTEXT")]
