"""A cockpit that does as it is told and remembers it, and frames of aircraft that circle."""

import math

import numpy as np

from testbed.links.cockpit import Item, Mode, Refusal
from testbed.links.scene import Scene
from testbed.links.vehicle import Vehicle
from testbed.mavlink.door import Codec
from testbed.state import (
    AirData,
    FbwaCommand,
    FormationState,
    Frame,
    LinkCounts,
    Origin,
    RunInfo,
    Surfaces,
    VehicleState,
)

ORIGIN = Origin(38.0, -3.5, 300.0)
WAYPOINT = 16


def item(command=WAYPOINT, *, x=38.001, y=-3.501, z=100.0, frame=3, parameters=(0.0,) * 4):
    return Item(command, frame, parameters, x, y, z)


class Notebook:
    """Implements `testbed.links.cockpit.Cockpit`."""

    def __init__(self, name="leader", *, external=True, lockstep=False):
        self.name, self.external, self.lockstep = name, external, lockstep
        self.mode, self.armed, self.failsafe, self.item = Mode.FBWA, True, False, 1
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
        self.refuses = {}

    def _note(self, name, *given):
        self.calls.append((name, *given))
        return self.refuses.get(name)

    def change_mode(self, mode):
        if refusal := self._note("change_mode", mode):
            return refusal
        self.mode = mode
        return None

    def arm(self, armed, *, force):
        if refusal := self._note("arm", armed, force):
            return refusal
        if not armed and not force:
            return Refusal("in flight")
        self.armed = armed
        return None

    def change_parameter(self, name, value):
        if refusal := self._note("change_parameter", name, value):
            return refusal
        if name not in self.parameters:
            return Refusal("no such parameter", supported=False)
        if not abs(value) <= 90.0:
            return Refusal("write -90 to 90")
        self.parameters[name] = value
        return None

    def change_mission(self, items):
        if refusal := self._note("change_mission", tuple(items)):
            return refusal
        self.mission = tuple(items)
        return None

    def go_on_at(self, item):
        if refusal := self._note("go_on_at", item):
            return refusal
        if not 0 < item < len(self.mission):
            return Refusal("no such item")
        self.item = item
        return None

    def fly_to(self, latitude_deg, longitude_deg, altitude, radius):
        return self._note("fly_to", latitude_deg, longitude_deg, altitude, radius)

    def change_airspeed(self, airspeed):
        return self._note("change_airspeed", airspeed)

    def sticks(self, roll, pitch, throttle, *, attitude=False, answers_s=None):
        return self._note("sticks", roll, pitch, throttle, attitude, answers_s)


def info(count=1, *, rate_hz=25):
    names = ("leader", *(f"uav{n}" for n in range(1, count)))
    return RunInfo(
        scenario_name="links",
        scenario_yaml="",
        names=names,
        aircraft=("rascal110",) * count,
        wingspan_m=(2.8,) * count,
        origin=ORIGIN,
        base_rate_hz=200,
        frame_rate_hz=rate_hz,
        duration_s=60.0,
        seed=1,
        speed_bounds_mps=((15.0, 30.0),) * (count - 1),
        kappa_mps=(1.0,) * (count - 1),
        roll_limit_rad=(0.8,) * (count - 1),
        leader_path_ned=np.zeros((0, 3)),
        portions={},
        versions={"testbed": "1.12.3"},
    )


def frame(tick=0, count=1, *, rate_hz=25, events=(), lost=(), charge=math.nan):
    """Aircraft in a circle of 120 m at 22 m/s, 50 m apart in height."""
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
        rates_body=np.zeros((count, 3)),
        roll_coefficient=0.0 * one,
        state_of_charge=charge * one,
        battery_voltage=charge * 24.0 * one,
    )
    error = np.tile((3.0, 4.0, 12.0), (rows, 1))
    formation = FormationState(
        *([np.zeros((rows, 3)), error] + [np.full(rows, 20.0)] * 7),
        guards=np.zeros(rows, dtype=np.uint8),
        saturations=np.zeros(rows, dtype=np.uint8),
        place=np.arange(1, count, dtype=np.uint32),
        age_s=np.zeros((rows, count)),
        believed_ned=error,
    )
    gone = np.zeros(count, dtype=bool)
    gone[list(lost)] = True
    counts = np.zeros((rows, count), dtype=np.uint32)
    return Frame(
        tick=tick * 200 // rate_hz,
        time_s=now,
        truth=state,
        estimate=state,
        air=air,
        command=FbwaCommand(pitch=0.1 * one, roll=-0.5 * one, throttle=0.25 * one),
        surfaces=Surfaces(0.2 * one, -0.4 * one, 0.1 * one, 0.3 * one),
        formation=formation,
        links=LinkCounts(counts, counts),
        lost=gone,
        events=tuple(events),
    )


class Talk:
    """A ground station's words with one vehicle; every answer goes over the wire and back."""

    def __init__(self, notebook=None, *, count=1, row=0, look=True, rate_hz=25):
        self.cockpit = notebook or Notebook()
        self.count, self.rate_hz, self.at_s = count, rate_hz, 1000.0
        self.vehicle = Vehicle(self.cockpit, row + 1, row, info(count, rate_hz=rate_hz), 10**15)
        self.codec, self.ears = Codec(row + 1, 1), Codec(255, 190)
        if look:
            self.look(0)

    def ask(self, name, /, *, system=255, component=190, **fields):
        """Answers to a message."""
        return self.over(self.vehicle.hear(message(name, system, component, **fields), self.at_s))

    def order(self, command, *numbers, **fields):
        """Answers to a COMMAND_LONG."""
        values = {f"param{n}": 0.0 for n in range(1, 8)}
        values |= {f"param{n}": value for n, value in enumerate(numbers, 1)}
        given = {**TO, "command": command, "confirmation": 0, **values, **fields}
        return self.ask("COMMAND_LONG", **given)

    def look(self, tick, **changes):
        """What is said with a frame."""
        seen = frame(tick, self.count, rate_hz=self.rate_hz, **changes)
        return self.over(self.vehicle.look(Scene(seen, ORIGIN), self.at_s))

    def due(self, after_s=0.0):
        """What is said some time later, without a frame."""
        self.at_s += after_s
        return self.over(self.vehicle.due(self.at_s))

    def over(self, replies):
        """Replies as somebody hears them."""
        frames = [self.codec.pack(reply.name, **reply.fields) for reply in replies]
        return [heard for each in frames for heard in self.ears.feed(each, whole=True)]


TO = {"target_system": 1, "target_component": 1}


def message(name, system=255, component=190, /, **fields):
    """A message as a vehicle hears it."""
    (heard,) = Codec(1, 1).feed(Codec(system, component).pack(name, **fields), whole=True)
    return heard


def named(messages, name):
    return [each.fields for each in messages if each.name == name]


def texts(messages):
    return [each["text"] for each in named(messages, "STATUSTEXT")]
