"""A stand-in for ArduPlane: it speaks the same packets and flies the testbed's own law.

It shows that our side of the links works, not that ArduPlane flies so. Written apart from
`testbed.ardupilot`, so that the two do not share a mistake. STAND_IN in the environment names
misbehaviours, as in "resend@450 exit@900": at these packets, counted from its start.
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

import numpy as np

from testbed.mavlink.door import Codec, number
from testbed.state import FbwaCommand, VehicleState
from testbed.vehicle.fbwa import fbwa, fresh
from testbed.vehicle.params import FbwaParams, read_params, stack

FBWA, RTL = 5, 11
ARMS_EVERY = 200  # packets; so that a command that comes a little later changes nothing
OVERRIDES = 8


def arguments():
    words = re.sub(r"-I *(\d+)", r"--instance \1", " ".join(sys.argv[1:])).split()
    return dict(zip(words[::2], words[1::2], strict=True))


def trouble():
    told = dict(word.partition("@")[::2] for word in os.environ.get("STAND_IN", "").split())
    return {name: int(at or 0) for name, at in told.items()}


def parameters(path):
    """ArduPlane's defaults where they matter here, and what the file says."""
    known = {name.upper(): getattr(FbwaParams(), name) for name in FbwaParams.__slots__}
    known |= {"RCMAP_ROLL": 1, "RCMAP_PITCH": 2, "RCMAP_THROTTLE": 3, "RCMAP_YAW": 4}
    known |= {"MIXING_GAIN": 0.5, "SIM_RATE_HZ": 1200, "INITIAL_MODE": 0}
    functions = {1: 4, 2: 19, 3: 70, 4: 21}
    for n in range(1, 17):
        for kind in ("RC", "SERVO"):
            known |= {f"{kind}{n}_MIN": 1100, f"{kind}{n}_MAX": 1900}
            known |= {f"{kind}{n}_TRIM": 1500, f"{kind}{n}_REVERSED": 0}
        known[f"SERVO{n}_FUNCTION"] = functions.get(n, 0)
    for line in open(path, encoding="utf-8"):
        if not line.startswith("#"):
            name, value = line.split()
            known[name] = float(value)
    return known


class StandIn:
    def __init__(self):
        asked = arguments()
        assert asked["--model"] == "JSON:127.0.0.1"
        assert len(asked["--home"].split(",")) == 4
        self.instance = int(asked["--instance"])
        self.known = parameters(asked["--defaults"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.tune = read_params(asked["--defaults"])
        self.every = round(self.known["SIM_RATE_HZ"] / self.known["SCHED_LOOP_RATE"])
        self.gains = stack([self.tune], 1.0 / self.known["SCHED_LOOP_RATE"])
        self.memory = fresh(1)
        self.trouble = trouble()
        self.count = 0
        self.armed, self.arming = False, False
        self.mode = int(self.known["INITIAL_MODE"])
        self.receiver, self.overridden = [0] * 16, [0] * OVERRIDES
        self.pulses = [0] * 16
        self.link = None
        self.codec = Codec(self.instance % 250 + 1, 1)

    def now(self, name):
        return self.trouble.get(name) == self.count

    # MAVLink

    def say(self, name, **fields):
        self.link.sendall(self.codec.pack(name, **fields))

    def text(self, words, severity=6):
        self.say("STATUSTEXT", severity=severity, text=words)

    def heartbeat(self):
        self.say(
            "HEARTBEAT",
            type=number("MAV_TYPE_FIXED_WING"),
            autopilot=number("MAV_AUTOPILOT_ARDUPILOTMEGA"),
            base_mode=1 + 128 * self.armed,
            custom_mode=self.mode,
            system_status=4,
            mavlink_version=3,
        )

    def hear(self):
        data = self.link.recv(65536)
        if not data:
            sys.exit("stand-in: the ground station has hung up")
        for message in self.codec.feed(data):
            fields = message.fields
            if message.name == "PARAM_REQUEST_READ":
                name = fields["param_id"]
                if name in self.known:
                    self.say(
                        "PARAM_VALUE",
                        param_id=name,
                        param_value=self.known[name],
                        param_type=9,
                        param_count=len(self.known),
                        param_index=0,
                    )
            elif message.name == "COMMAND_LONG":
                self.obey(fields)
            elif message.name == "RC_CHANNELS_OVERRIDE":
                self.overridden = [fields[f"chan{n}_raw"] for n in range(1, OVERRIDES + 1)]

    def obey(self, fields):
        command = fields["command"]
        if command == 400 and fields["param2"] == 21196 and "never-arms" not in self.trouble:
            self.arming = bool(fields["param1"])
        elif command == 176:
            self.mode = int(fields["param2"])
        elif command == 512 and fields["param1"] == 65:
            heard = {f"chan{n}_raw": self.receiver[n - 1] for n in range(1, 17)}
            self.say(
                "RC_CHANNELS",
                time_boot_ms=0,
                chancount=16,
                rssi=255,
                chan17_raw=0,
                chan18_raw=0,
                **heard,
            )
        elif command == 512 and fields["param1"] == 148:
            version = {"flight_sw_version": 4 << 24 | 7 << 16 | 1 << 8, "uid": 0}
            version |= {f"{part}_sw_version": 0 for part in ("middleware", "os")}
            version |= {"capabilities": 0, "board_version": 0, "vendor_id": 0, "product_id": 0}
            version |= {f"{part}_custom_version": b"" for part in ("middleware", "os")}
            self.say("AUTOPILOT_VERSION", flight_custom_version=b"stand-in", **version)
        self.say("COMMAND_ACK", command=command, result=0)

    # physics

    def send(self):
        outputs = 32 if "outputs32" in self.trouble else 16
        magic = {16: 18458, 32: 29569}[outputs]
        if self.now("wrong-magic"):
            magic = 12345
        rate = round(self.known["SIM_RATE_HZ"])
        pulses = self.pulses + [0] * (outputs - 16)
        packet = struct.pack(f"<HHI{outputs}H", magic, rate, self.count, *pulses)
        self.udp.send(b"garbage" if self.now("garbage") else packet)

    def receive(self):
        """The next line; MAVLink is heard meanwhile, and pulses sent again after 10 s."""
        last = time.monotonic()
        drop = self.now("resend")
        patience = 0.2 if drop else 10.0
        while True:
            ready, _, _ = select.select([self.udp, self.link], [], [], 0.05)
            if self.link in ready:
                self.hear()
            if self.udp in ready:
                line = self.udp.recv(65536)
                if not drop:
                    return json.loads(line)
            if time.monotonic() - last > patience:
                last, drop = time.monotonic(), False
                print("No JSON sensor message received, resending servos", flush=True)
                self.send()

    def sticks(self):
        """Roll, pitch in degrees and throttle in whole percent, as older versions take it."""
        known = self.known

        def part(stick):
            n = int(known[f"RCMAP_{stick}"])
            least, trim, most, turned = (
                known[f"RC{n}_{end}"] for end in ("MIN", "TRIM", "MAX", "REVERSED")
            )
            pulse = self.receiver[n - 1]
            if stick == "THROTTLE":
                pulse = most - (pulse - least) if turned else pulse
                return int(100 * max(0.0, min((pulse - least) / (most - least), 1.0)))
            side = trim - least if pulse < trim else most - trim
            norm = max(-1.0, min((pulse - trim) / side, 1.0))
            return -norm if turned else norm

        pitch = part("PITCH")
        top = known["PTCH_LIM_MAX_DEG"] if pitch > 0 else -known["PTCH_LIM_MIN_DEG"]
        return part("ROLL") * known["ROLL_LIMIT_DEG"], pitch * top, part("THROTTLE")

    def control(self, line):
        roll, pitch, throttle = self.sticks()
        velocity = np.array([line["velocity"]])
        state = VehicleState(
            np.array([line["position"]]),
            velocity,
            np.zeros((1, 3)),
            np.array([line["attitude"]]),
            np.array([line["imu"]["gyro"]]),
            np.linalg.norm(velocity - line["velocity_wind"], axis=1),
            np.array([line["airspeed"]]),
        )
        told = FbwaCommand(np.radians([pitch]), np.radians([roll]), np.array([throttle / 100.0]))
        if not self.armed:
            self.pulses[:4] = 1500, 1500, int(self.known["SERVO3_MIN"]), 1500
            return
        surfaces, self.memory = fbwa(state, told, self.memory, self.gains)
        least, most = self.known["SERVO3_MIN"], self.known["SERVO3_MAX"]
        levers = (surfaces.aileron, surfaces.elevator, surfaces.rudder)
        ail, ele, rud = (round(1500 + 500 * float(each[0])) for each in levers)
        thr = round(least + float(surfaces.throttle[0]) * (most - least))
        self.pulses[:4] = ail, ele, thr, rud

    def step(self, line):
        rc = [int(line["rc"][f"rc_{n}"]) for n in range(1, len(line["rc"]) + 1)]
        if "deaf" not in self.trouble:
            self.receiver[: len(rc)] = rc
        for n, pulse in enumerate(self.overridden):
            if 0 < pulse < 65535:
                self.receiver[n] = pulse
        if self.arming and not self.armed and self.count % ARMS_EVERY == 0:
            self.armed, self.memory = True, fresh(1)
            self.text("Throttle armed")
        if self.count % self.every == 0:
            self.control(line)
        if self.count % round(self.known["SIM_RATE_HZ"]) == 0:
            self.heartbeat()

    def misbehave(self):
        if self.now("exit"):
            print("stand-in: PANIC: out of cheese", flush=True)
            sys.exit(3)
        if self.now("crash"):
            os.kill(os.getpid(), signal.SIGSEGV)
        if self.now("hang"):
            print("stand-in: thinking", flush=True)
            time.sleep(600)
        if self.now("restart"):
            self.count = 0
        if self.now("disarm"):
            self.arming = self.armed = False
            self.text("Crash: Disarming", 1)
            self.heartbeat()
        if self.now("mode"):
            self.mode = RTL
            self.heartbeat()

    def run(self):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if "never-listens" in self.trouble:
            print("stand-in: thinking", flush=True)
            time.sleep(600)
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", 5760 + 10 * self.instance))
        listener.listen(1)
        print("Waiting for connection ....", flush=True)
        self.link, _ = listener.accept()
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.connect(("127.0.0.1", 9002 + 10 * self.instance))
        self.text("ArduPlane stand-in")
        self.heartbeat()
        stamp = -math.inf
        while True:
            self.misbehave()
            self.send()
            line = self.receive()
            if self.count == 0:
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
                print("JSON received:", *line, flush=True)
            assert line["timestamp"] > stamp, "time does not grow"
            stamp = line["timestamp"]
            self.count += 1
            self.step(line)


if __name__ == "__main__":
    StandIn().run()
