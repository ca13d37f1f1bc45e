"""Measure Simulation 3 with four ArduPlanes, played by stand-ins of a stated processor time.

Prints the real-time factor of the flight, and the processor time of the testbed and of the
stand-ins. A stand-in is a process of its own that exchanges ArduPlane's packets, sends telemetry
once a second as ArduPlane does, and computes for a stated time per frame. With --against the
flights of two source trees take turns.

usage: python benchmarks/arduplane.py [--seconds S] [--plane-s S] [--repeats N] [--against TREE]
[--program FILE] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

TREE = Path(__file__).resolve().parents[1]
FULL_S = 1080.0  # of Simulation 3
PLANE_S = 13.0  # processor time of one ArduPlane 4.8.0-dev in it, measured
FIRST_INSTANCE = 247  # of four, the last allowed, far from those of other runs
FRAME_HZ, LOOP_FRAMES = 200, 4  # physics, and frames per step of the control law
COST_VARIABLE = "ARDUPLANE_FRAME_US"
GRAVITY, FBWA = 9.81, 5
# Telemetry that ArduPlane sends by default on every link, once a second.
STREAMS = (
    *("RAW_IMU", "SCALED_IMU2", "SCALED_PRESSURE", "SCALED_PRESSURE2", "SYS_STATUS"),
    *("POWER_STATUS", "MEMINFO", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT"),
    *("FENCE_STATUS", "POSITION_TARGET_GLOBAL_INT", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    *("SERVO_OUTPUT_RAW", "ATTITUDE", "SIMSTATE", "AHRS2", "AOA_SSA", "VFR_HUD", "AHRS", "WIND"),
    *("SYSTEM_TIME", "TERRAIN_REPORT", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION"),
)
PARAMETERS = {
    **{"RCMAP_ROLL": 1, "RCMAP_PITCH": 2, "RCMAP_THROTTLE": 3, "RCMAP_YAW": 4},
    **{"SERVO1_FUNCTION": 4, "SERVO2_FUNCTION": 19, "SERVO3_FUNCTION": 70, "SERVO4_FUNCTION": 21},
    **{"ROLL_LIMIT_DEG": 50, "PTCH_LIM_MAX_DEG": 20, "PTCH_LIM_MIN_DEG": -25, "MIXING_GAIN": 0.5},
}
ENDS = {"MIN": 1000, "TRIM": 1500, "MAX": 2000}


class StandIn:
    """The program: ArduPlane's links, and a simple fly-by-wire A for a Rascal.

    It has no misbehaviour: the tests have another stand-in for that.
    """

    def __init__(self, words: Sequence[str]) -> None:
        """Listen, wait for the ground station, and open the physics link."""
        from testbed.mavlink.codec import Codec

        (instance,) = (int(word[2:]) for word in words if word.startswith("-I"))
        defaults = Path(words[words.index("--defaults") + 1]).read_text(encoding="utf-8")
        own = (line.split() for line in defaults.splitlines() if not line.startswith("#"))
        self.parameters = PARAMETERS | {name: float(value) for name, value in own}
        self.codec, self.armed, self.mode = Codec(1, 1), False, FBWA
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", 5760 + 10 * instance))
        listener.listen(1)
        self.link, _ = listener.accept()
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.link.setblocking(False)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.connect(("127.0.0.1", 9002 + 10 * instance))
        self.telemetry = b"".join(map(self.pack_empty, STREAMS))
        self.elevator = 0.0  # integral, µs
        self.rc = [1500, 1500, 1000, 1500]
        self.pulses = [1500, 1500, 1000, 1500]

    def pack_empty(self, name: str) -> bytes:
        """Pack a message of zeros."""
        from testbed.mavlink import codec

        layout = codec._layout_of_name(name)
        values = {each.name: each.count * [0] if each.count else 0 for each in layout.fields}
        texts = {each.name: "" for each in layout.fields if each.is_text}
        return self.codec.pack(name, **(values | texts))

    def send(self, name: str, **fields: Any) -> None:  # noqa: ANN401
        """Send a message."""
        self.link.sendall(self.codec.pack(name, **fields))

    def send_heartbeat(self) -> None:
        """Send mode and arming."""
        self.send(
            "HEARTBEAT",
            type=1,
            autopilot=3,
            base_mode=1 + 128 * self.armed,
            custom_mode=self.mode,
            system_status=4,
            mavlink_version=3,
        )

    def value(self, name: str) -> float:
        """Return a parameter; ranges that the file does not have are 1000 to 2000 µs."""
        return self.parameters.get(name, ENDS.get(name.rpartition("_")[2], 0))

    def receive_messages(self) -> None:
        """Answer what the ground station has sent, if anything."""
        try:
            data = self.link.recv(65536)
        except BlockingIOError:
            return
        if not data:
            sys.exit(0)
        for message in self.codec.feed(data):
            if message.name == "PARAM_REQUEST_READ":
                name = str(message.fields["param_id"])
                self.send(
                    "PARAM_VALUE",
                    param_id=name,
                    param_value=self.value(name),
                    param_type=9,
                    param_count=1,
                    param_index=0,
                )
            elif message.name == "COMMAND_LONG":
                self.execute(message.fields)

    def execute(self, fields: Mapping[str, Any]) -> None:
        """Arm, change the mode, or send a requested message."""
        command, wanted = fields["command"], fields["param1"]
        if command == 400:
            self.armed = bool(wanted)
        elif command == 176:
            self.mode = int(fields["param2"])
        elif command == 512 and wanted == 65:
            rc = dict.fromkeys((f"chan{n}_raw" for n in range(1, 19)), 0)
            rc |= {f"chan{n}_raw": pulse for n, pulse in enumerate(self.rc, start=1)}
            self.send("RC_CHANNELS", time_boot_ms=0, chancount=16, rssi=255, **rc)
        elif command == 512 and wanted == 148:
            self.link.sendall(self.pack_empty("AUTOPILOT_VERSION"))
        self.send_heartbeat()

    def control(self, line: Mapping[str, Any]) -> None:
        """Compute servo pulses from attitude, rates and sticks."""
        phi, theta, _ = line["attitude"]
        p, q, _ = line["imu"]["gyro"]
        roll = (self.rc[0] - 1500) / 500 * 0.0174533 * self.value("ROLL_LIMIT_DEG")
        side = "PTCH_LIM_MAX_DEG" if self.rc[1] > 1500 else "PTCH_LIM_MIN_DEG"
        pitch = abs(self.rc[1] - 1500) / 500 * 0.0174533 * self.value(side)
        error = pitch - theta
        self.elevator = max(-250.0, min(self.elevator + 6.0 * error, 250.0))
        aileron = 400.0 * (roll - phi) - 60.0 * p
        elevator = 500.0 * error - 100.0 * q + self.elevator
        self.pulses[0] = 1500 + round(max(-500.0, min(aileron, 500.0)))
        self.pulses[1] = 1500 + round(max(-500.0, min(elevator, 500.0)))
        self.pulses[2] = self.rc[2]

    def run(self) -> None:
        """Exchange frames; from arming on each costs the stated processor time on average."""
        cost_s = 1e-6 * float(os.environ[COST_VARIABLE])
        pack, udp, clock = struct.Struct("<HHI16H").pack, self.udp, time.process_time
        self.send_heartbeat()
        frame, due = 0, 0.0
        while True:
            udp.send(pack(18458, FRAME_HZ, frame, *self.pulses, *[0] * 12))
            line = json.loads(udp.recv(65536))
            frame += 1
            if frame % LOOP_FRAMES == 0:
                self.rc = [int(line["rc"][f"rc_{n}"]) for n in range(1, 5)]
                self.receive_messages()
                self.control(line)
            if frame % FRAME_HZ == 0:
                self.send_heartbeat()
                self.link.sendall(self.telemetry)
            due = due + cost_s if self.armed and due else clock()
            while clock() < due:
                pass


def write_program(file: Path, plane_s: float) -> None:
    """Write the stand-in as an executable file in place of `arduplane`.

    Args:
        file: to write.
        plane_s: processor time per stand-in and FULL_S of flight, s.
    """
    frame_us = 1e6 * plane_s / (FULL_S * FRAME_HZ)
    file.write_text(
        f'#!/bin/sh\nexport {COST_VARIABLE}="{frame_us:.6g}"\nexport PYTHONPATH="{TREE}"\n'
        f'exec "{sys.executable}" "{Path(__file__).resolve()}" stand-in "$@"\n'
    )
    file.chmod(0o755)


def processor_s(process: str = "self") -> float:
    """Return the processor time of all threads of a process on Linux, s."""
    threads = Path(f"/proc/{process}/task").iterdir()
    return sum(int((each / "schedstat").read_text().split()[0]) for each in threads) * 1e-9


def flight(program: Path, seconds: float) -> dict[str, float]:
    """Fly, and return the factor and the processor times from the first to the last sample."""
    from testbed.core.records import Observer
    from testbed.runs.external_options import ExternalOptions
    from testbed.runs.run import run

    class Stopwatch(Observer):
        zero_copy = True  # keeps no array of a sample

        def begin(self, info: object) -> None:
            self.first: dict[str, float] = {}

        def observe(self, sample: Any) -> None:  # noqa: ANN401
            if not self.first:
                self.stand_ins = find_descendants()
                self.first = self.read(sample.time_s)
            elif sample.time_s >= seconds:
                self.last = self.read(sample.time_s)

        def read(self, time_s: float) -> dict[str, float]:
            return {
                "simulated_s": time_s,
                "wall_s": time.perf_counter(),
                "own_s": processor_s(),
                "stand_ins_s": sum(map(processor_s, self.stand_ins)),
            }

        def end(self, summary: object, events: object) -> None:
            pass

    autopilot = "{{kind: ardupilot, instance: {}}}"
    names = ("leader", "fleet.uav1", "fleet.uav2", "fleet.uav3")
    overrides = [
        f"{name}.autopilot={autopilot.format(FIRST_INSTANCE + n)}" for n, name in enumerate(names)
    ]
    # overrides alone, which older source trees understand too
    overrides += [f"scenario.duration_s={seconds}", "scenario.windows=null"]
    overrides += ["scenario.published=null"]
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        external = ExternalOptions(arduplane=program)
        result = run(
            "simulation-3",
            overrides,
            out=Path(folder) / "run",
            observers=[watch],
            external=external,
        )
    if result.outcome != "completed":
        raise SystemExit(f"{result.outcome}: a lost aircraft costs nothing")
    spent = {name: last - watch.first[name] for name, last in watch.last.items()}
    return {**spent, "factor": spent["simulated_s"] / spent["wall_s"]}


def find_descendants(process: str = "self") -> list[str]:
    """Return the numbers of a process's children, and of theirs."""
    tasks = Path(f"/proc/{process}/task").iterdir()
    children = [each for task in tasks for each in (task / "children").read_text().split()]
    return children + [each for child in children for each in find_descendants(child)]


def fly_tree(tree: Path, program: Path, seconds: float) -> dict[str, float]:
    """Fly with the sources of a tree in a process of their own."""
    command = [sys.executable, __file__, "flight", str(program), str(seconds)]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    output = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE).stdout
    result: dict[str, float] = json.loads(output)
    return result


def describe(name: str, flights: Sequence[Mapping[str, float]]) -> str:
    """Describe the medians of a tree's flights, and the range of the factor."""
    medians = {key: statistics.median(each[key] for each in flights) for key in flights[0]}
    factors = [each["factor"] for each in flights]
    to_full = FULL_S / medians["simulated_s"]
    return (
        f"{name}: {medians['factor']:.1f} ({min(factors):.1f}-{max(factors):.1f}) x real time; "
        f"processor s per {FULL_S:g} s: testbed {medians['own_s'] * to_full:.1f}, "
        f"stand-ins {medians['stand_ins_s'] * to_full:.1f}"
    )


def main() -> None:
    """Fly in turns, and print and write the requested numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of each flight")
    parser.add_argument(
        "--plane-s", type=float, default=PLANE_S, help=f"of each stand-in in {FULL_S:g} s of flight"
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--against", type=Path, help="another source tree")
    parser.add_argument("--program", type=Path, help="write the stand-in there, and fly nothing")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.program:
        write_program(options.program, options.plane_s)
        return
    trees = {"this": TREE}
    if options.against:
        trees["other"] = options.against.resolve()
    flights: dict[str, list[dict[str, float]]] = {name: [] for name in trees}
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "arduplane"
        write_program(program, options.plane_s)
        for _ in range(options.repeats):
            for name, tree in trees.items():
                flights[name].append(fly_tree(tree, program, options.seconds))
                print(describe(name, flights[name][-1:]), file=sys.stderr, flush=True)
    for name in trees:
        print(describe(name, flights[name]))
    if options.against:
        pairs = zip(flights["this"], flights["other"], strict=True)
        ratios = [one["factor"] / other["factor"] for one, other in pairs]
        print(
            f"this / other: {statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
        )
    if options.json:
        options.json.write_text(json.dumps(flights, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["stand-in"]:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        StandIn(sys.argv[2:]).run()
    elif sys.argv[1:2] == ["flight"]:
        print(json.dumps(flight(Path(sys.argv[2]), float(sys.argv[3]))))
    else:
        main()
