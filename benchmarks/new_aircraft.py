"""All aircraft that come with JSBSim through `testbed new aircraft`, in one table.

    python benchmarks/new_aircraft.py [--only NAME,...] [--keep FOLDER] [--into PAGE]

Each is a process of its own, and is ended after LONGEST_S. An aircraft flies if the command writes
its folder; it trims if it flies, or if the reason of the refusal begins after its trim.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from inputs import Inputs
from tables import add_output_arguments, publish

import testbed.cli.main
import testbed.commissioning.aircraft_files  # once for all, before the first fork
from testbed.vehicle.jsbsim_adapter import SHARED_FILES

LONGEST_S = 300.0
MARK = "python benchmarks/new_aircraft.py"
INPUTS = {MARK: Inputs()}  # the aircraft come with JSBSim
_TRIMS = ": trims at "
_TIMES = {1: "once", 2: "twice"}


def aircraft_files() -> list[Path]:
    """Return the main file of each aircraft that comes with JSBSim."""
    folders = sorted((SHARED_FILES / "aircraft").iterdir(), key=lambda each: each.name.lower())
    files = (each / f"{each.name}.xml" for each in folders)
    return [each for each in files if each.is_file()]


def try_aircraft(file: Path, into: Path) -> dict[str, Any]:
    """Return the document of the command, or the reason of its refusal, and the time it took."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        document, errors = Path(scratch, "found.json"), Path(scratch, "errors.txt")
        arguments = "new", "aircraft", str(file), "--into", str(into), "--json", str(document)
        process = multiprocessing.get_context("fork").Process(
            target=_run_command, args=(arguments, errors)
        )
        process.start()
        process.join(LONGEST_S)
        if process.exitcode is None:
            process.kill()
            process.join()
        found = {
            "name": file.stem,
            "code": process.exitcode,
            "seconds": time.monotonic() - began,
        }
        if process.exitcode == 0:
            return found | json.loads(document.read_text(encoding="utf-8"))
        text = errors.read_text(encoding="utf-8")
    reason = text.partition("error: ")[2] or text.strip().rpartition("\n")[2]
    for folder in {file.parent, file.resolve().parent}:
        reason = reason.replace(f"{folder}/", "")
    return found | {"reason": reason.strip()}


def _run_command(arguments: tuple[str, ...], errors: Path) -> None:
    sys.argv = ["testbed", *arguments]
    with (
        errors.open("w", encoding="utf-8") as file,
        Path(os.devnull).open("w", encoding="utf-8") as nothing,
        contextlib.redirect_stderr(file),
        contextlib.redirect_stdout(nothing),
    ):
        testbed.cli.main.main()


def row(found: dict[str, Any]) -> str:
    """Return a row of the table."""
    if "reason" in found:
        lines = found["reason"].splitlines()
        more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        result = "trims" if _TRIMS in lines[0] else "refused"
        if found["code"] != 2:
            result = f"exit code {found['code']}"
        text = lines[0].replace("|", "/")
        return f"| {found['name']} | {result} | | | | {text}{more} |"
    last, level = found["flights"][-1], found["level_flight"]
    count = last["softenings"]
    softened = f"gains softened {_TIMES.get(count, f'{count} times')}" if count else ""
    names = len(found["declared"])
    declared = f"{names} propert{'y' if names == 1 else 'ies'} declared" if names else ""
    cells = (
        found["name"],
        "flies",
        f"{level['airspeed']:g}",
        f"{last['roll_rise_s']:.2f} s / {100.0 * last['roll_overshoot']:.0f} %",
        f"{last['pitch_rise_s']:.2f} s / {100.0 * last['pitch_overshoot']:.0f} %",
        "; ".join(filter(None, (softened, declared))),
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Try all, and print or insert the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="names, separated by commas")
    parser.add_argument("--keep", type=Path, help="folder for the aircraft that fly")
    add_output_arguments(parser)
    options = parser.parse_args()
    if options.into and options.only:
        parser.error("--into writes all aircraft: leave out --only")
    only = set(filter(None, options.only.split(",")))
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        for file in aircraft_files():
            if only and file.stem not in only:
                continue
            results.append(try_aircraft(file, folder / file.stem))
            print(f"{file.stem}: {results[-1]['seconds']:.0f} s", file=sys.stderr, flush=True)
    flies = sum("reason" not in each for each in results)
    trims = flies + sum(_TRIMS in each.get("reason", "") for each in results)
    slowest = max(each["seconds"] for each in results)
    print(f"At most {slowest:.0f} s for one aircraft", file=sys.stderr)
    lines = [
        "| aircraft | result | m/s | bank: 63 %, overshoot | pitch | |",
        "|---|---|--:|---|---|---|",
        *map(row, results),
        "",
        f"{len(results)} aircraft: {trims} trim, {flies} fly the minute without ringing.",
    ]
    sys.exit(0 if publish(options, {MARK: "\n".join(lines)}, INPUTS) else 1)


if __name__ == "__main__":
    main()
