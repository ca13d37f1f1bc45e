"""A companion in this process, with an autopilot and a formation that the test plays."""

import math
import socket
import time
from contextlib import ExitStack, contextmanager, suppress

from link_loop import free_port

from testbed.companion.engagement import LeaveMode
from testbed.companion.follower_control import FollowerControl
from testbed.companion.formation_link import parse_formation
from testbed.companion.formation_messages import FormationMessages
from testbed.companion.scenario_digest import AGREED_PARAMETERS
from testbed.companion.start import CompanionOptions, digest_of, open_companion
from testbed.core.geodetic import geodetic_from_ned
from testbed.link.ends import parse_end
from testbed.mavlink.codec import Codec

EPOCH_MS = 1_800_000_000_000  # GPS time at the boot of all autopilots
GUIDED, FBWA = 15, 5


class Listening:
    """What a companion has told."""

    def __init__(self):
        self.texts, self.samples = [], 0

    def sample(self, loop):
        self.samples += 1

    def text(self, boot_s, text):
        self.texts.append(text.text)

    def alive(self, now_s):
        pass


class CompanionBench:
    """An autopilot of uav2 at one socket, and the leader and uav1 at others.

    Args:
        scenario: a formation whose uav2 uses the leader and uav1.
        folder: of its file.
        control: of uav2, which may be used again.
        key: of all; None: unsigned.
        listeners: of the loop.
        place: address at which the companion listens to its autopilot.
        options: of CompanionOptions.
    """

    def __init__(
        self, scenario, folder, control, key=None, listeners=(), place="127.0.0.1", **options
    ):
        self.control, self.plan = control, control.plan
        self.listening = Listening()
        self._autopilot_port = free_port()
        self._sockets = [self._socket(free_port()) for _ in self.plan.names]
        places = [f"127.0.0.1:{each.getsockname()[1]}" for each in self._sockets]
        self._sockets[control.row].close()  # the companion has it
        self.autopilot = self._socket(0)
        self.codec = Codec(control.row + 1, 1)
        self.peers = {row: Codec(row + 1, 191) for row in (0, 1)}
        self.scenario = digest_of(scenario, folder)
        self.received = []
        self._waits = False
        self._closing = ExitStack()
        self._place = "127.0.0.1", int(places[control.row].rpartition(":")[2])
        self.loop = self._closing.enter_context(
            open_companion(
                scenario,
                folder,
                control,
                CompanionOptions(
                    parse_end(f"udpin:{place}:{self._autopilot_port}"),
                    parse_formation("peers:" + ",".join(places), self.plan.names),
                    key,
                    **{"leave": LeaveMode.LOITER, **options},
                ),
                [self.listening, *listeners],
            )
        )
        self.mode, self.boot_ms = FBWA, 0
        self._messages = FormationMessages(self.plan.origin, len(self.plan.names))

    def _socket(self, port):
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.bind(("127.0.0.1", port))
        made.setblocking(False)
        return made

    def close(self):
        self._closing.close()
        for each in (*self._sockets, self.autopilot):
            each.close()

    def send(self, name, **fields):
        """Send a message of the autopilot."""
        frame = self.codec.pack(name, **fields)
        self.autopilot.sendto(frame, ("127.0.0.1", self._autopilot_port))

    def send_formation(self, frame):
        """Send bytes to the companion's place in the formation."""
        self._sockets[0].sendto(frame, self._place)

    def position_ned(self, row):
        """Where an aircraft is: all fly north at 20 m/s, in their slots."""
        north = 0.02 * self.boot_ms
        offset = self.plan.offsets[row]
        return (north + offset[0], offset[1], -100.0 + offset[2])

    def peer_frame(self, row, **changes):
        """Return a message of another aircraft, of now."""
        message = self.control.message(0.0).copy()
        message["position_ned"] = self.position_ned(row)
        message["velocity_ned"] = 20.0, 0.0, 0.0
        message["acceleration_ned"] = message["euler"] = message["euler_rates"] = 0.0
        digests = self.loop._digests()
        fields = self._messages.fields(message, EPOCH_MS + self.boot_ms, digests)
        return self.peers[row].pack("FOLLOW_TARGET", **{**fields, **changes})

    def sample(self, *, with_peers=True, step_ms=40, **changes):
        """Send a sample of the autopilot, and messages of the others; let the companion answer.

        Args:
            with_peers: the others are heard.
            step_ms: since the sample before.
            changes: fields of messages, by the name of the message.
        """
        self.boot_ms += step_ms
        if with_peers:
            for row in self.peers:
                self.send_formation(self.peer_frame(row))
        for name, fields in self._state(changes).items():
            self.send(name, **fields)
        before = self.listening.samples
        if not self._waits:
            self.turn(lambda: self.listening.samples > before, 0.5)

    @contextmanager
    def waiting(self):
        """Send samples in the block while the companion does not run."""
        self._waits = True
        yield
        self._waits = False

    def heard(self):
        """Return the datagrams that the leader has heard since the last call."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found.append(self._sockets[0].recv(4096))
        return found

    def turn(self, done=lambda: False, longest_s=0.1):
        """Let the loop run until something has happened, or for a while."""
        end_s = time.monotonic() + longest_s
        while not done() and time.monotonic() < end_s:
            self.loop.turn()
        with suppress(BlockingIOError):
            while True:
                data = self.autopilot.recv(4096)
                self.received += Codec(255, 1).feed(data, datagram=True)

    def commands(self):
        """Return the attitude targets since the last call, and forget all messages."""
        found = [each for each in self.received if each.name == "SET_ATTITUDE_TARGET"]
        self.received = []
        return found

    def _state(self, changes):
        north, east, down = self.position_ned(self.control.row)
        place = geodetic_from_ned([north, east, down], self.plan.origin)
        ms, ms_of = self.boot_ms, {"time_boot_ms": self.boot_ms}
        velocity = {"vx": 20.0, "vy": 0.0, "vz": 0.0}
        state = {
            "HEARTBEAT": {
                "type": 1,
                "autopilot": 3,
                "base_mode": 128 | 1,
                "custom_mode": self.mode,
                "system_status": 4,
                "mavlink_version": 3,
            },
            "SYSTEM_TIME": {"time_unix_usec": 1000 * (EPOCH_MS + ms), **ms_of},
            "EKF_STATUS_REPORT": {
                "flags": 0b1100111111,
                **dict.fromkeys(
                    (
                        *("velocity_variance", "pos_horiz_variance", "pos_vert_variance"),
                        *("compass_variance", "terrain_alt_variance"),
                    ),
                    0.1,
                ),
            },
            "GPS_RAW_INT": {
                **dict.fromkeys(("lat", "lon", "alt", "eph", "epv", "vel", "cog"), 0),
                "time_usec": 1000 * ms,
                "fix_type": 3,
                "satellites_visible": 12,
            },
            "GLOBAL_POSITION_INT": {
                **ms_of,
                "lat": round(place[0] * 1e7),
                "lon": round(place[1] * 1e7),
                "alt": round(place[2] * 1e3),
                **dict.fromkeys(("relative_alt", "vy", "vz", "hdg"), 0),
                "vx": 2000,
            },
            "LOCAL_POSITION_NED": {**ms_of, "x": 1e3, "y": 1e3, "z": 0.0, **velocity},
            "VFR_HUD": {
                "airspeed": 19.8,
                **dict.fromkeys(("groundspeed", "alt", "climb"), 0.0),
                **dict.fromkeys(("heading", "throttle"), 0),
            },
            "ATTITUDE": {
                **ms_of,
                "roll": 0.0,
                "pitch": 0.03,
                **dict.fromkeys(("yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0),
            },
        }
        return {
            name: {**fields, **changes.get(name, {})}
            for name, fields in state.items()
            if changes.get(name, {}) is not None
        }

    def give_parameters(self, **changes):
        """Answer all requests for parameters by those of the scenario."""
        params = self.plan.aircraft[self.control.row].params
        for index, name in enumerate(AGREED_PARAMETERS):
            value = changes.get(name, getattr(params, name.lower(), 1.0))
            self.send(
                "PARAM_VALUE",
                param_id=name,
                param_value=float(value),
                param_type=9,
                param_count=len(AGREED_PARAMETERS),
                param_index=index,
            )

    def engage(self):
        """Fly until it is ready, and switch into GUIDED."""
        self.give_parameters()
        for _ in range(5):
            self.sample()
        self.mode = GUIDED
        self.received = []
        self.sample()


def angles(message):
    """Return roll and pitch of an attitude target, rad."""
    w, x, y, z = message.fields["q"]
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, math.asin(2 * (w * y - z * x))


def make_control(scenario, name="uav2"):
    """Return the control of an aircraft of a scenario."""
    return FollowerControl(scenario, name)
