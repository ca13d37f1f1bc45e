"""A stand-in for ArduPlane: the same packets, and the testbed's own fly-by-wire A.

It tests our side of the links, not ArduPlane's control law. Packets and pulses are implemented
independently of `testbed.autopilot`, so that the two do not share an error. The environment
variable ARDUPLANE_STAND_IN lists misbehaviours and the packets, counted from its start, at which
they happen: "resend@450 exit@900".
"""

import json
import math
import os
import re
import select
import signal
import socket
import struct
import sys
import time
import warnings
from types import SimpleNamespace

import numpy as np

from testbed.autopilot.fbwa import fbwa, initial_autopilots
from testbed.autopilot.parameters import AutopilotTiming, FbwaParams, make_gains, read_params
from testbed.mavlink.codec import Codec, constant

FBWA, RTL = 5, 11
ARMING_PERIOD = 200  # packets, so that a command that comes a little later changes nothing
OVERRIDES = 8


def arguments():
    words = re.sub(r"-I *(\d+)", r"--instance \1", " ".join(sys.argv[1:])).split()
    return dict(zip(words[::2], words[1::2], strict=True))


def misbehaviours():
    words = os.environ.get("ARDUPLANE_STAND_IN", "").split()
    return {name: int(at or 0) for name, _, at in (word.partition("@") for word in words)}


def read_parameters(path):
    """Return ArduPlane's defaults of the parameters used here, and those of the file."""
    parameters = {name.upper(): getattr(FbwaParams(), name) for name in FbwaParams.__slots__}
    parameters |= {"RCMAP_ROLL": 1, "RCMAP_PITCH": 2, "RCMAP_THROTTLE": 3, "RCMAP_YAW": 4}
    parameters |= {"MIXING_GAIN": 0.5, "SIM_RATE_HZ": 1200, "INITIAL_MODE": 0}
    functions = {1: 4, 2: 19, 3: 70, 4: 21}
    for n in range(1, 17):
        for kind in ("RC", "SERVO"):
            parameters |= {f"{kind}{n}_MIN": 1100, f"{kind}{n}_MAX": 1900}
            parameters |= {f"{kind}{n}_TRIM": 1500, f"{kind}{n}_REVERSED": 0}
        parameters[f"SERVO{n}_FUNCTION"] = functions.get(n, 0)
    for line in open(path, encoding="utf-8"):
        if not line.startswith("#"):
            name, value = line.split()
            parameters[name] = float(value)
    return parameters


def plain(record):
    """Return a record as attributes: numbers and lists, which Python reads ten times faster.

    An array of two axes is a dict of its pairs of indices.
    """
    found = SimpleNamespace()
    for name in record.dtype.names:
        value = record[name]
        if value.dtype.names:
            value = plain(value)
        elif value.ndim == 2:
            value = {(i, j): value[i, j].item() for i, j in np.ndindex(value.shape)}
        else:
            value = value.tolist()
        setattr(found, name, value)
    return found


class StandIn:
    def __init__(self):
        options = arguments()
        assert options["--model"] == "JSON:127.0.0.1"
        assert len(options["--home"].split(",")) == 4
        self.instance = int(options["--instance"])
        self.parameters = read_parameters(options["--defaults"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.tune = read_params(options["--defaults"])
        self.period = round(self.parameters["SIM_RATE_HZ"] / self.parameters["SCHED_LOOP_RATE"])
        sitl = AutopilotTiming(sitl_physics_hz=self.parameters["SIM_RATE_HZ"])
        self.gains = make_gains([self.tune], 1.0 / self.parameters["SCHED_LOOP_RATE"], sitl)
        self.start_autopilot()
        self.misbehaviours = misbehaviours()
        self.count = 0
        self.armed, self.arming = False, False
        self.mode = int(self.parameters["INITIAL_MODE"])
        self.receiver, self.overridden = [0] * 16, [0] * OVERRIDES
        self.pulses = [0] * 16
        self.link = None
        self.codec = Codec(self.instance % 250 + 1, 1)

    def start_autopilot(self):
        gains, memory, self.delay_line = initial_autopilots(self.gains)
        self.of_gains, self.memory = plain(gains[0]), plain(memory[0])

    def now(self, name):
        return self.misbehaviours.get(name) == self.count

    # MAVLink

    def send_message(self, name, **fields):
        self.link.sendall(self.codec.pack(name, **fields))

    def send_text(self, text, severity=6):
        self.send_message("STATUSTEXT", severity=severity, text=text)

    def send_heartbeat(self):
        self.send_message(
            "HEARTBEAT",
            type=constant("MAV_TYPE_FIXED_WING"),
            autopilot=constant("MAV_AUTOPILOT_ARDUPILOTMEGA"),
            base_mode=1 + 128 * self.armed,
            custom_mode=self.mode,
            system_status=4,
            mavlink_version=3,
        )

    def receive_messages(self):
        data = self.link.recv(65536)
        if not data:
            sys.exit("stand-in: the ground station has closed the connection")
        for message in self.codec.feed(data):
            fields = message.fields
            if message.name == "PARAM_REQUEST_READ":
                name = fields["param_id"]
                if name in self.parameters:
                    self.send_message(
                        "PARAM_VALUE",
                        param_id=name,
                        param_value=self.parameters[name],
                        param_type=9,
                        param_count=len(self.parameters),
                        param_index=0,
                    )
            elif message.name == "COMMAND_LONG":
                self.execute(fields)
            elif message.name == "RC_CHANNELS_OVERRIDE":
                self.overridden = [fields[f"chan{n}_raw"] for n in range(1, OVERRIDES + 1)]

    def execute(self, fields):
        command = fields["command"]
        if command == 400 and fields["param2"] == 21196 and "never-arms" not in self.misbehaviours:
            self.arming = bool(fields["param1"])
        elif command == 176:
            self.mode = int(fields["param2"])
        elif command == 512 and fields["param1"] == 65:
            channels = {f"chan{n}_raw": self.receiver[n - 1] for n in range(1, 17)}
            self.send_message(
                "RC_CHANNELS",
                time_boot_ms=0,
                chancount=16,
                rssi=255,
                chan17_raw=0,
                chan18_raw=0,
                **channels,
            )
        elif command == 512 and fields["param1"] == 148:
            version = {"flight_sw_version": 4 << 24 | 7 << 16 | 1 << 8, "uid": 0}
            version |= {f"{part}_sw_version": 0 for part in ("middleware", "os")}
            version |= {"capabilities": 0, "board_version": 0, "vendor_id": 0, "product_id": 0}
            version |= {f"{part}_custom_version": b"" for part in ("middleware", "os")}
            self.send_message("AUTOPILOT_VERSION", flight_custom_version=b"stand-in", **version)
        self.send_message("COMMAND_ACK", command=command, result=0)

    # physics

    def send_servos(self):
        outputs = 32 if "outputs32" in self.misbehaviours else 16
        magic = {16: 18458, 32: 29569}[outputs]
        if self.now("wrong-magic"):
            magic = 12345
        rate = round(self.parameters["SIM_RATE_HZ"])
        pulses = self.pulses + [0] * (outputs - 16)
        packet = struct.pack(f"<HHI{outputs}H", magic, rate, self.count, *pulses)
        self.udp.send(b"garbage" if self.now("garbage") else packet)

    def receive_line(self):
        """Wait for the next line, handle MAVLink, and repeat the servo packet after 10 s."""
        last = time.monotonic()
        drop = self.now("resend")
        timeout = 0.2 if drop else 10.0
        while True:
            ready, _, _ = select.select([self.udp, self.link], [], [], 0.05)
            if self.link in ready:
                self.receive_messages()
            if self.udp in ready:
                line = self.udp.recv(65536)
                if not drop:
                    return json.loads(line)
            if time.monotonic() - last > timeout:
                last, drop = time.monotonic(), False
                print("No JSON sensor message received, resending servos", flush=True)
                self.send_servos()

    def stick_input(self):
        """Return roll, pitch in degrees and throttle in whole percent, as older versions do."""
        parameters = self.parameters

        def share(stick):
            n = int(parameters[f"RCMAP_{stick}"])
            low, trim, high, reversed_ = (
                parameters[f"RC{n}_{end}"] for end in ("MIN", "TRIM", "MAX", "REVERSED")
            )
            pulse = self.receiver[n - 1]
            if stick == "THROTTLE":
                pulse = high - (pulse - low) if reversed_ else pulse
                return int(100 * max(0.0, min((pulse - low) / (high - low), 1.0)))
            side = trim - low if pulse < trim else high - trim
            norm = max(-1.0, min((pulse - trim) / side, 1.0))
            return -norm if reversed_ else norm

        pitch = share("PITCH")
        limit = parameters["PTCH_LIM_MAX_DEG"] if pitch > 0 else -parameters["PTCH_LIM_MIN_DEG"]
        return share("ROLL") * parameters["ROLL_LIMIT_DEG"], pitch * limit, share("THROTTLE")

    def control(self, line):
        low, high = self.parameters["SERVO3_MIN"], self.parameters["SERVO3_MAX"]
        if not self.armed:
            self.pulses[:4] = 1500, 1500, int(low), 1500
            return
        roll, pitch, throttle = self.stick_input()
        state = SimpleNamespace(
            airspeed=math.dist(line["velocity"], line["velocity_wind"]),
            equivalent_airspeed=line["airspeed"],
            euler=line["attitude"],
            rates_body=line["imu"]["gyro"],
        )
        command = SimpleNamespace(
            pitch=math.radians(pitch), roll=math.radians(roll), throttle=throttle / 100.0
        )
        *deflections, throttle = fbwa(
            self.of_gains, self.memory, self.delay_line[0], state, command, False
        )
        ail, ele, rud = (round(1500 + 500 * each) for each in deflections)
        self.pulses[:4] = ail, ele, round(low + throttle * (high - low)), rud

    def step(self, line):
        rc = [int(line["rc"][f"rc_{n}"]) for n in range(1, len(line["rc"]) + 1)]
        if "ignores-rc" not in self.misbehaviours:
            self.receiver[: len(rc)] = rc
        for n, pulse in enumerate(self.overridden):
            if 0 < pulse < 65535:
                self.receiver[n] = pulse
        if self.arming and not self.armed and self.count % ARMING_PERIOD == 0:
            self.armed = True
            self.start_autopilot()
            self.send_text("Throttle armed")
        in_flight = self.count - 400  # packets since about the end of the boot
        if in_flight in (20, 40, 60) and self.parameters.get("EK3_ENABLE", 1):
            self.send_text("EKF3 IMU0 is using GPS")
        if self.count % self.period == 0:
            self.control(line)
        if self.count % round(self.parameters["SIM_RATE_HZ"]) == 0:
            self.send_heartbeat()

    def misbehave(self):
        if self.now("exit"):
            print("stand-in: PANIC: internal error", flush=True)
            sys.exit(3)
        if self.now("crash"):
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.now("hang"):
            print("stand-in: frozen", flush=True)
            time.sleep(600)
        if self.now("restart"):
            self.count = 0
        if self.now("disarm"):
            self.arming = self.armed = False
            self.send_text("Crash:\tDisarming", 1)
            self.send_heartbeat()
        if self.now("mode"):
            self.mode = RTL
            self.send_heartbeat()

    def run(self):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if "never-listens" in self.misbehaviours:
            print("stand-in: frozen", flush=True)
            time.sleep(600)
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("", 5760 + 10 * self.instance))
        listener.listen(1)
        self.rc_in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # as stock builds open it
        self.rc_in.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.rc_in.bind(("", 5501 + 10 * self.instance))
        print("Waiting for connection ....", flush=True)
        self.link, _ = listener.accept()
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.connect(("127.0.0.1", 9002 + 10 * self.instance))
        self.send_text("ArduPlane stand-in")
        self.send_heartbeat()
        stamp = -math.inf
        while True:
            self.misbehave()
            self.send_servos()
            line = self.receive_line()
            if self.count == 0:
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
                for _ in range(12):
                    print(f"Loaded defaults from {arguments()['--defaults']}", flush=True)
                print("\nJSON received:", *line, sep="\n\t", flush=True)
            assert line["timestamp"] > stamp, "time does not increase"
            stamp = line["timestamp"]
            self.count += 1
            self.step(line)


if __name__ == "__main__":
    StandIn().run()
