"""An autopilot, a pilot's switch and two other aircraft, for a companion that is a process."""

import math
import os
import re
import signal
import socket
import time

from commands import environment
from forked import Forked
from waiting import TIMEOUT_S

from testbed.companion.scenario_digest import AGREED_PARAMETERS
from testbed.core.records import NedOrigin
from testbed.mavlink.codec import Codec
from testbed.mavlink.signing import signing_time
from testbed.plan.measured_fleet import resolve
from testbed.scenario import load_scenario

SCENARIO, NAME, ROW = "simulation-3", "uav2", 2
FBWA, LOITER, GUIDED = 5, 12, 15
RATE_HZ, SPEED, HEIGHT_M = 25, 22.0, 104.0
SET_MODE, ARM = 176, 400  # MAV_CMD
START_UNIX_MS = int(1000 * time.time())
EARTH_M = 6_371_000.0
SLOTS = {"leader": (0.0, 0.0, -100.0), "uav1": (-5.0, 5.0, -100.0)}


def free_ports(count):
    """Return ports of this computer that no program uses."""
    opened = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for each in opened:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in opened]
    for each in opened:
        each.close()
    return ports


class StandIn:
    """The world of one companion, in straight flight to the north; `fly` makes its time pass.

    Attributes: those of the first group are what a test breaks.
        silent: the autopilot sends nothing.
        frozen: the own position stays.
        jump_m: added to the own position.
        mute: names of aircraft that send nothing.
        digests: turned in the bits of the messages of others.
        leader_ms: added to the leader's time.
        leader_m: added to the leader's position.
        noise: datagrams of noise at each sample and port.
        again: whether all messages of others are sent again a second later.
        forged: a codec that also sends messages as the leader, 500 m beside it.
        obeys: whether a mode that is asked for is entered.
        mode: of the autopilot.
        attitudes: times of commands, s since boot.
        modes, arms: that were asked for.
        texts: of the companion.
        folder: of the companion and of its output.
    """

    def __init__(self, folder, *options, key=None, signers=None, log=False):
        self.silent = self.frozen = self.again = False
        self.mute, self.noise, self.digests = set(), 0, 0
        self.jump_m = self.leader_m = 0.0
        self.leader_ms, self.forged, self.obeys = 0, None, True
        self.mode, self.attitudes, self.modes, self.arms, self.texts = FBWA, [], [], [], []
        self._signers = signers or {}
        self._codecs = {
            name: Codec(row + 1, 1 if name == NAME else 191, self._signers.get(name))
            for row, name in enumerate(("leader", "uav1", NAME))
        }
        self._reader = Codec(255, 190)
        self.folder, self._options, self._key, self._log = folder, options, key, log
        scenario = load_scenario(SCENARIO)
        own = resolve(scenario).aircraft[ROW]
        self.parameters = {
            name: float(value)
            for name in AGREED_PARAMETERS
            if (value := getattr(own.params, name.lower(), None)) is not None
        }
        self.origin = NedOrigin(**scenario.scenario.origin.model_dump())
        self.ports = free_ports(5)
        self._companion_digests = 0
        self._sockets = {
            name: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for name in self._codecs
        }
        for port, each in zip((*self.ports[1:3], 0), self._sockets.values(), strict=True):
            each.bind(("127.0.0.1", port))
            each.setblocking(False)
        self._k, self._begun_s = 0, None
        self._sent = []  # messages of others: sample, frame
        self._held = None
        self.process = self.output = None
        self.start()

    def start(self):
        """Start the companion."""
        peers = ",".join(f"127.0.0.1:{port}" for port in self.ports[1:])
        command = ["companion", SCENARIO, "--as", NAME]
        command += ["--autopilot", f"udpin:127.0.0.1:{self.ports[0]}"]
        command += ["--formation", f"peers:{peers}", *self._options]
        command += [] if self._log else ["--no-log"]
        command += ["--mavlink-key", str(self._key)] if self._key else []
        if self.output is not None:
            self.output.close()
        self.output = open(self.folder / f"companion-{time.monotonic_ns()}.txt", "w+")  # noqa: SIM115
        self.process = Forked(
            "testbed.cli.main:main",
            *command,
            cwd=self.folder,
            env=environment(100),
            stdout=self.output,
            stderr=self.output,
        )

    def printed(self):
        """What the companion has printed."""
        with open(self.output.name, encoding="utf-8") as file:
            return file.read()

    def close(self):
        """End the companion and close the sockets."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
        self.process.wait(TIMEOUT_S)
        self.output.close()
        for each in self._sockets.values():
            each.close()

    @property
    def now_s(self):
        """Boot time of the newest sample, s."""
        return self._k / RATE_HZ

    def fly(self, duration_s, until=None):
        """Let time pass, or as much of it as it takes; return whether `until` became true."""
        end = self._k + round(duration_s * RATE_HZ)
        while self._k < end:
            self._wait()
            self._sample()
            self._read()
            if until is not None and until():
                return True
        return until is None

    def engage(self):
        """Switch until the companion commands."""
        for _ in range(20):
            self.mode, heard = FBWA, len(self.texts)
            self.fly(1, lambda: "formation ready" in "".join(self.texts[heard:]))  # noqa: B023
            before = len(self.attitudes)
            self.mode = GUIDED
            if self.fly(0.7, lambda: len(self.attitudes) > before + 5):  # noqa: B023
                self.modes.clear()
                return
        raise AssertionError((self.texts[-3:], self.printed()))

    def _wait(self):
        """Keep to the rate; a test that was late does not catch up."""
        self._k += 1
        now = time.monotonic()
        if self._begun_s is None or now - self._begun_s - self.now_s > 0.1:
            self._begun_s = now - self.now_s
        time.sleep(max(self._begun_s + self.now_s - now, 0.0))

    def _sample(self):
        for each in self._signers.values():
            each.advance(signing_time(time.time()))
        north = SPEED * self.now_s
        boot_ms = 1000 * self._k // RATE_HZ
        if not self.silent:
            self._send_own(north, boot_ms)
        for name, (ahead, right, down) in SLOTS.items():
            if name not in self.mute:
                leads = name == "leader"
                place = (north + ahead + leads * self.leader_m, right, down)
                self._send_peer(name, self._codecs[name], place, boot_ms)
                if leads and self.forged is not None:
                    place = (north + ahead, right + 500.0, down)
                    self._send_peer(name, self.forged, place, boot_ms + 1)
        if self.again:
            for k, frame in self._sent:
                if k == self._k - RATE_HZ:
                    self._sockets["uav1"].sendto(frame, ("127.0.0.1", self.ports[1 + ROW]))
        self._sent = [each for each in self._sent if each[0] >= self._k - RATE_HZ]
        for _ in range(self.noise):
            noise = os.urandom(200)
            broken = b"\xfd" + noise
            for port in (self.ports[0], self.ports[1 + ROW]):
                self._sockets["uav1"].sendto(broken, ("127.0.0.1", port))

    def _place(self, north, east, down):
        """Latitude and longitude, 1e-7 deg, and height, m, on a sphere that is flat here."""
        latitude = self.origin.latitude_deg + math.degrees(north / EARTH_M)
        across = EARTH_M * math.cos(math.radians(self.origin.latitude_deg))
        longitude = self.origin.longitude_deg + math.degrees(east / across)
        height = self.origin.elevation_m - down
        return round(latitude * 1e7), round(longitude * 1e7), height

    def _send_own(self, north, boot_ms):
        pack = self._codecs[NAME].pack
        if self._held is None or not self.frozen:
            self._held = north
        north = self._held + self.jump_m
        latitude, longitude, height = self._place(north - 5.0, -5.0, -HEIGHT_M)
        frames = []
        if self._k % 5 == 1:
            frames.append(
                pack(
                    "HEARTBEAT",
                    type=1,
                    autopilot=3,
                    base_mode=128 | 1,
                    custom_mode=self.mode,
                    system_status=4,
                    mavlink_version=3,
                )
            )  # noqa: E501
        if self._k % 10 == 1:
            frames.append(
                pack(
                    "SYSTEM_TIME",
                    time_unix_usec=1000 * (START_UNIX_MS + boot_ms),
                    time_boot_ms=boot_ms,
                )
            )  # noqa: E501
            frames.append(
                pack(
                    "EKF_STATUS_REPORT",
                    flags=831,
                    velocity_variance=0.1,
                    pos_horiz_variance=0.1,
                    pos_vert_variance=0.1,
                    compass_variance=0.1,
                    terrain_alt_variance=0.0,
                )
            )  # noqa: E501
            frames.append(
                pack(
                    "GPS_RAW_INT",
                    time_usec=1000 * boot_ms,
                    fix_type=3,
                    lat=latitude,
                    lon=longitude,
                    alt=0,
                    eph=100,
                    epv=100,
                    vel=2200,
                    cog=0,
                    satellites_visible=12,
                )
            )  # noqa: E501
        alt = round(1000 * height)
        frames += [
            pack(
                "GLOBAL_POSITION_INT",
                time_boot_ms=boot_ms,
                lat=latitude,
                lon=longitude,
                alt=alt,
                relative_alt=0,
                vx=2200,
                vy=0,
                vz=0,
                hdg=0,
            ),  # noqa: E501
            pack(
                "LOCAL_POSITION_NED",
                time_boot_ms=boot_ms,
                x=0.0,
                y=0.0,
                z=0.0,
                vx=SPEED,
                vy=0.0,
                vz=0.0,
            ),  # noqa: E501
            pack(
                "VFR_HUD",
                airspeed=SPEED,
                groundspeed=SPEED,
                heading=0,
                throttle=50,
                alt=height,
                climb=0.0,
            ),  # noqa: E501
            pack(
                "ATTITUDE",
                time_boot_ms=boot_ms,
                roll=0.001 * math.sin(self._k),
                pitch=0.05,
                yaw=0.0,
                rollspeed=0.0,
                pitchspeed=0.0,
                yawspeed=0.0,
            ),  # noqa: E501
        ]
        self._sockets[NAME].sendto(b"".join(frames), ("127.0.0.1", self.ports[0]))

    def _send_peer(self, name, codec, place, boot_ms):
        latitude, longitude, height = self._place(*place)
        shift_ms = self.leader_ms if name == "leader" else 0
        frame = codec.pack(
            "FOLLOW_TARGET",
            timestamp=START_UNIX_MS + boot_ms + shift_ms,
            est_capabilities=15,
            lat=latitude,
            lon=longitude,
            alt=height,
            vel=(SPEED, 0.0, 0.0),
            acc=(0.0, 0.0, 0.0),
            attitude_q=(1.0, 0.0, 0.0, 0.0),
            rates=(0.0, 0.0, 0.0),
            position_cov=(0.0, 0.0, 0.0),
            custom_state=self._companion_digests ^ self.digests,
        )
        self._sent.append((self._k, frame))
        self._sockets[name].sendto(frame, ("127.0.0.1", self.ports[1 + ROW]))

    def _read(self):
        for name, each in self._sockets.items():
            while True:
                try:
                    data = each.recv(4096)
                except BlockingIOError:
                    break
                for message in self._reader.feed(data, datagram=True):
                    self._take(name, message)

    def _take(self, name, message):
        fields = message.fields
        if message.name == "FOLLOW_TARGET" and message.system == ROW + 1:
            self._companion_digests = fields["custom_state"]
        elif message.name == "SET_ATTITUDE_TARGET":
            self.attitudes.append(self.now_s)
        elif message.name == "STATUSTEXT":
            self.texts.append(re.sub(r"\0.*", "", fields["text"]))
        elif message.name == "PARAM_REQUEST_READ" and not self.silent:
            self._send_parameters()
        elif message.name == "COMMAND_LONG" and fields["command"] == SET_MODE:
            self.modes.append(int(fields["param2"]))
            if self.obeys:
                self.mode = self.modes[-1]
        elif message.name in ("COMMAND_LONG", "COMMAND_INT") and fields["command"] == ARM:
            self.arms.append(fields["param1"])
        elif message.name == "SET_MODE":
            self.modes.append(fields["custom_mode"])

    def _send_parameters(self):
        """Send all, as where a ground station reads them too: asked one by one they take 2 s."""
        for name, value in self.parameters.items():
            frame = self._codecs[NAME].pack(
                "PARAM_VALUE",
                param_id=name,
                param_value=value,
                param_type=9,
                param_count=len(self.parameters),
                param_index=0,
            )
            self._sockets[NAME].sendto(frame, ("127.0.0.1", self.ports[0]))
