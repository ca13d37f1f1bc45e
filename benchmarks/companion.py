"""Measure four companions that fly the product's vehicles: latency, ages, processor, memory.

A run of Simulation 3 in real time, whose followers a companion each commands, and one more that
broadcasts the leader's state; beside it, the same flight in one process. It exchanges nothing with
other machines. On a machine that does other work the times are those of that work, too: the load is
printed.

usage: make bench  (or: python benchmarks/companion.py [--duration S] [--cold] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

NAMES = ("leader", "uav1", "uav2", "uav3")
SCENARIO = "simulation-3"
READY_S = 300.0  # kernels may have to be compiled first
# What they should keep to on a quiet machine.
BARS = {
    "state to command p50, ms": 3.0,
    "state to command p99, ms": 10.0,
    "memory with log, MB": 200.0,
    "processor, % of a core": 6.0,
    "processor time to the first command, s": 1.5,
    "memory while compiling, MB": 300.0,
    "processor time with nothing compiled, s": 9.0,
}
PROGRAM = [sys.executable, "-m", "testbed"]


def free_port() -> int:
    """Return a UDP port of this computer that no program has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def start(name: str, port: int, peers: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start a companion that commands at once, and wait until it listens."""
    errors = folder / f"{name}.txt"
    command = [*PROGRAM, "companion", SCENARIO, "--as", name, "--at-once"]
    command += ["--autopilot", f"udpin:127.0.0.1:{port}", "--formation", peers]
    command += ["--out", str(folder / name), "--json", str(folder / f"{name}.json"), "--quiet"]
    with errors.open("wb") as output:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=output)
    end_s = time.monotonic() + READY_S
    while b"companion of" not in errors.read_bytes():
        if process.poll() is not None or time.monotonic() > end_s:
            raise SystemExit(f"{name} does not start: {errors.read_text()}")
        time.sleep(0.02)
    return process


def fly(duration_s: float, folder: Path) -> dict[str, Any]:
    """Fly with four companions; return their statistics by name, and the metrics of the run."""
    first = free_port()  # those after it are mostly free, too
    ports = [first + k for k in range(len(NAMES))]
    peers = "peers:" + ",".join(f"127.0.0.1:{free_port()}" for _ in NAMES)
    with ExitStack() as closing:
        processes = []
        for name, port in zip(NAMES, ports, strict=True):
            process = start(name, port, peers, folder)
            closing.callback(process.kill)
            processes.append(process)
        command = [*PROGRAM, "run", SCENARIO, "--duration", f"{duration_s:g}", "--pace", "1"]
        for name in NAMES[1:]:
            command += ["--set", f"fleet.{name}.commanded_by=external"]
        command += ["--mavlink", f"udpout:127.0.0.1:{first}+1"]
        subprocess.run([*command, "--out", str(folder / "run"), "--quiet"], check=True)
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            process.wait(60.0)
    found = {name: json.loads((folder / f"{name}.json").read_text()) for name in NAMES}
    return {"companions": found, "run": json.loads((folder / "run/metrics.json").read_text())}


def fly_alone(duration_s: float, folder: Path) -> dict[str, Any]:
    """Fly the same in one process, with commands that act a tick of the autopilots later."""
    command = [*PROGRAM, "run", SCENARIO, "--duration", f"{duration_s:g}", "--quiet"]
    command += ["--set", "controller.companion.command_latency_s=0.02"]
    subprocess.run([*command, "--out", str(folder / "alone")], check=True)
    found: dict[str, Any] = json.loads((folder / "alone/metrics.json").read_text())
    return found


def cold_start(folder: Path) -> dict[str, float]:
    """Start a companion from a copy of the program that has nothing compiled yet."""
    copy = folder / "program"
    here = Path(__file__).resolve().parents[1]
    for name in ("testbed", "aircraft", "scenarios"):
        skipped = shutil.ignore_patterns("__pycache__")
        shutil.copytree(here / name, copy / name, ignore=skipped)
    code = (
        "import json, resource, time, testbed\n"
        "from testbed.companion.follower_control import FollowerControl\n"
        f"FollowerControl(testbed.load_scenario('{SCENARIO}'), 'uav2')\n"
        "peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024\n"
        "print(json.dumps([time.process_time(), peak]))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=copy, env=environment, capture_output=True, check=True
    )
    used_s, peak_mb = json.loads(done.stdout)
    return {"processor_s": used_s, "memory_mb": peak_mb}


def rms_of(metrics: dict[str, Any]) -> dict[str, float]:
    """Return the RMS errors of the second half of a flight, m, by follower."""
    windows = metrics["windows"]
    found: dict[str, float] = windows.get("second_half", next(iter(windows.values())))["rms_m"]
    return found


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--duration", type=float, default=60.0, metavar="S")
    parser.add_argument("--cold", action="store_true", help="also start with nothing compiled")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        flown = fly(options.duration, Path(folder))
        alone = fly_alone(options.duration, Path(folder))
        cold = cold_start(Path(folder)) if options.cold else None
    print(f"four companions, {options.duration:g} s in real time; load {os.getloadavg()[0]:.1f}")
    rows: dict[str, list[float | None]] = {name: [] for name in BARS}
    for name in NAMES:
        each = flown["companions"][name]
        latency = each["state_to_command_s"]
        rows["state to command p50, ms"].append(latency and 1e3 * latency["p50"])
        rows["state to command p99, ms"].append(latency and 1e3 * latency["p99"])
        rows["memory with log, MB"].append(each["peak_memory_mb"])
        rows["processor, % of a core"].append(100 * each["processor_share"])
        first_s = each["first_command_cpu_s"]
        rows["processor time to the first command, s"].append(first_s)
    if cold is not None:
        rows["memory while compiling, MB"].append(cold["memory_mb"])
        rows["processor time with nothing compiled, s"].append(cold["processor_s"])
    print(f"{'':42}" + "".join(f"{name:>9}" for name in NAMES) + f"{'bar':>9}")
    for name, values in rows.items():
        if values:
            cells = "".join("        –" if v is None else f"{v:9.2f}" for v in values)
            print(f"{name:42}{cells:36}{BARS[name]:9g}")
    print(f"{'RMS error of the second half, m':42}{'':9}" + _cells(rms_of(flown["run"])))
    print(f"{'the same in one process, 20 ms later, m':42}{'':9}" + _cells(rms_of(alone)))
    late = flown["run"]["pace"]["late_s"] if "late_s" in flown["run"].get("pace", {}) else None
    print(f"ticks of the run late: {late}")
    if options.json:
        document = {"flown": flown, "alone": alone, "cold": cold}
        options.json.write_text(json.dumps(document, indent=1), "utf-8")


def _cells(values: dict[str, float]) -> str:
    return "".join(f"{values[name]:9.3f}" for name in NAMES[1:])


if __name__ == "__main__":
    main()
