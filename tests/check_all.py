"""Run the tests on their large samples, and write the results into the page of development.

usage: python tests/check_all.py [--list] [--only PART ...] [--jobs N] [--no-write]

`make check-all` runs every part. Each row of the table in docs/contributing/development.md says
when its part was last run, on which commit, and how it ended; a part that fails does not stop the
others.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import time
from datetime import date
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "contributing" / "development.md"
BEGIN, END = "<!-- results of make check-all -->", "<!-- end of the results -->"
HEADINGS = ("part", "sample", "result", "time", "commit", "date")
LONGEST_H = 4.0  # of one part


class Part(NamedTuple):
    """Tests that have a larger sample than that of `make test`."""

    name: str
    sample: str
    command: str  # pytest with variables before it, or another program
    parallel: bool = True  # its tests may run at once


PARTS = (
    Part("all tests", "that of `make test`", "make test"),
    Part(
        "cases that `make test` draws from",
        "all of them",
        "TESTBED_CASES=all pytest tests paper/tests",
    ),
    Part("release", "built and flown from a new environment", "make release"),
    Part(
        "theorem",
        "1,000 random starts",
        "TESTBED_STARTS=1000 pytest tests/formation/theorems/test_theorem_many_starts.py",
        parallel=False,
    ),
    Part(
        "statistics of turbulence",
        "60 samples per case",
        "TESTBED_AIR_SAMPLES=60 pytest tests/atmosphere/equations/test_atmosphere_dryden.py "
        "tests/atmosphere/equations/test_atmosphere_von_karman.py "
        "tests/atmosphere/equations/test_atmosphere_field.py",
    ),
    Part(
        "compiled flight models against JSBSim",
        "1,000 random states, 3 steps each",
        "TESTBED_STATES=1000 pytest tests/compiled/equations/test_compiled_states.py",
        parallel=False,
    ),
    Part(
        "margins of a linear system, as printed",
        "two scenarios",
        "TESTBED_CASES=all TESTBED_MARGINS=1 pytest tests/linear/equations/test_linear_system.py",
    ),
    Part(
        "assessments of Simulation 3 beside fresh seeds, and weaknesses in their rows",
        "3 times 59 seeds",
        "TESTBED_ASSESSMENT=1 pytest tests/assessment/truth/test_assessed_formations.py",
        parallel=False,
    ),
    Part(
        "encounters with the separation filter",
        "10,000 of ideal aircraft, 1,000 of Rascals",
        "TESTBED_SEPARATION=10000 pytest tests/formation/theorems/test_separation.py",
        parallel=False,
    ),
    Part(
        "laws that are FMUs beside the class",
        "all of Simulation 3",
        "TESTBED_FMU_FLIGHT_S=1080 pytest tests/fmi/contract/test_law_fmu.py",
    ),
    Part(
        "false claims of a benchmark between equal laws",
        "4,000 pages",
        "TESTBED_BENCHMARK_PAGES=4000 pytest tests/benchmark/equations/test_score.py",
    ),
    Part(
        "claims of the benchmark on a second set of seeds",
        "two whole benchmarks",
        "TESTBED_BENCHMARK=1 pytest tests/benchmark/truth/test_second_seeds.py",
        parallel=False,
    ),
    Part(
        "functions and components of compiled models against JSBSim",
        "all, 100,000 arguments each",
        "TESTBED_LITERALS=100000 pytest tests/compiled/equations/test_compiled_literals.py",
        parallel=False,
    ),
    Part(
        "statistics of the network",
        "1,000,000 packets",
        "TESTBED_PACKETS=1000000 pytest tests/network/equations/test_network_loss.py "
        "tests/network/equations/test_network_delay.py "
        "tests/network/equations/test_network_queue.py "
        "tests/network/equations/test_network_keys.py",
    ),
    Part(
        "statistics of links with several faults",
        "10,000 packets per case",
        "TESTBED_PACKETS=10000 pytest tests/network/equations/test_network_statistics.py",
    ),
    Part(
        "broken MAVLink frames and flight logs",
        "600,000",
        "TESTBED_FRAMES=600000 pytest tests/mavlink/contract/test_mavlink_codec_noise.py "
        "tests/mavlink/contract/test_mavlink_vehicle_noise.py "
        "tests/flight_logs/contract/test_dataflash.py "
        "tests/flight_logs/truth/test_import_flight.py "
        "tests/flight_logs/truth/test_px4_logs.py "
        "tests/mavlink/equations/test_follow_target.py",
    ),
    Part(
        "MAVLink frames from many clients at once",
        "10,000",
        "TESTBED_FRAMES=10000 pytest tests/clients/test_storm.py",
        parallel=False,
    ),
    Part(
        "flight logs with several vehicles, clocks or sensors",
        "1,000",
        "TESTBED_IMPORTS=1000 pytest tests/flight_logs/truth/test_import_identity.py",
        parallel=False,
    ),
    Part(
        "fits of an aircraft to recordings with sensor errors, whose values are known",
        "20",
        "TESTBED_FITS=20 pytest tests/commissioning/truth/test_airframe_fit.py",
        parallel=False,
    ),
    Part(
        "broken input files",
        "20,000",
        "TESTBED_MUTATIONS=20000 pytest tests/whole/contract/test_mutations.py",
    ),
    Part(
        "aircraft drawn from JSBSim's grammar, most of which try to act",
        "2,000",
        "TESTBED_AIRCRAFT=2000 pytest tests/airframes/contract/test_airframe_files.py",
        parallel=False,
    ),
    Part(
        "run directories with files of the user, links, pipes, absurd numbers; writes that fail",
        "500; 300",
        "TESTBED_RUN_DIRECTORIES=500 TESTBED_WRITE_ERRORS=300 pytest "
        "tests/logs/contract/test_run_files_fuzz.py tests/logs/contract/test_write_errors.py",
    ),
    Part(
        "calls from Python with any arguments",
        "2,000",
        "TESTBED_ARGUMENTS=2000 pytest tests/whole/contract/test_arguments.py",
        parallel=False,
    ),
    Part(
        "numbers of a scenario at and beyond their bounds",
        "all",
        "TESTBED_NUMBERS=1 pytest tests/scenario/contract/test_scenario_schema.py",
        parallel=False,
    ),
    Part(
        "keys of the shipped scenarios, flown with drawn values and at their bounds: a key that "
        "changes no number must be reported",
        "200",
        "TESTBED_KEYS=200 pytest tests/scenario/contract/test_set_keys.py",
        parallel=False,
    ),
    Part(
        "real time with nothing else running",
        "",
        "TESTBED_QUIET=1 pytest tests/clients/test_real_time.py",
        parallel=False,
    ),
    Part(
        "flights by companions in processes of their own against the same in one process",
        "160 s of Simulation 3",
        "TESTBED_COMPANIONS=1 pytest tests/runs/contract/test_run_companions.py",
        parallel=False,
    ),
    Part(
        "sequences of observations of a companion; failures of its process and of others",
        "1,000 sequences, all failures",
        "TESTBED_ENGAGEMENTS=1000 TESTBED_FAILURES=1 pytest "
        "tests/companion/equations/test_engagement.py "
        "tests/companion/contract/test_companion_failures.py",
        parallel=False,
    ),
    Part(
        "a link between programs: packets as in a channel and a flight, noise, ground stations",
        "10,000 packets",
        "TESTBED_LINK_PACKETS=10000 TESTBED_LINK_NOISE=10000 TESTBED_BAD_LINKS=1 pytest tests/link "
        "tests/clients/test_bad_link.py",
        parallel=False,
    ),
    Part(
        "bounds of the golden scenarios, pages of the paper, saved and restored flights",
        "whole flights",
        "TESTBED_WHOLE=1 pytest tests/whole/bounds paper/tests "
        "tests/flight/contract/test_saved_flights.py",
    ),
    Part(
        "flights begun later against whole flights",
        "1,000 pairs of scenario and begin",
        "TESTBED_BEGUN=1000 pytest tests/plan/contract/test_begun_flights.py",
    ),
    Part(
        "golden scenarios that compile or load nothing in flight",
        "all, also with nothing cached",
        "TESTBED_PREPARED=1 pytest tests/flight/contract/test_prepare.py",
    ),
    Part(
        "both engines, every number of 60 s; powers for 120 s",
        "all scenarios",
        "TESTBED_ENGINES=1 pytest tests/compiled/contract/test_engine.py "
        "tests/compiled/contract/test_engine_powers.py",
    ),
    Part(
        "studies and workers that are killed",
        "whole studies",
        "TESTBED_STUDIES=1 pytest tests/studies/contract/test_sweep.py "
        "tests/studies/equations/test_study_plan.py tests/runs/contract/test_stuck_law.py",
        parallel=False,
    ),
    Part(
        "flights with damaged files of machine code, proofs and locks",
        "26 kinds of damage",
        "TESTBED_KEPT_FILES=1 pytest tests/core/contract/test_kept_files.py",
    ),
    Part(
        "runs killed at random moments, stopped by two signals; logs that are cut",
        "200, 200; 40",
        "TESTBED_KILLS=200 TESTBED_CUTS=40 pytest tests/runs/contract/test_endings.py "
        "tests/logs/contract/test_recover.py",
    ),
    Part(
        "snippets of the docs; laws of large formations",
        "every page",
        "TESTBED_DOCS=1 TESTBED_LAWS=1 pytest tests/whole/contract/test_readme.py "
        "tests/formation/contract/test_own_law.py",
    ),
    Part(
        "margins of laws of users beside flights",
        "all commands of two laws, straight and at 30°",
        "TESTBED_CASES=all TESTBED_LAW_MARGINS=1 pytest tests/linear/equations/test_user_laws.py",
    ),
    Part(
        "four stand-ins of ArduPlane; virtual autopilots against recordings of real ones",
        "the whole of Simulation 3; four seeds of turns",
        "TESTBED_ARDUPLANE_WHOLE=1 pytest tests/ardupilot/contract/test_arduplane.py "
        "tests/ardupilot/truth/test_four_arduplanes.py "
        "tests/commissioning/truth/test_recorded_arduplane.py",
        parallel=False,
    ),
    Part(
        "aircraft as FMUs beside testbed.Aircraft; libraries for other platforms",
        "60 s of the Rascal and the X8, calm and in turbulence",
        "TESTBED_FMUS=1 pytest tests/fmi",
        parallel=False,
    ),
    Part("golden tables", "all, flown again", "testbed check --jobs {jobs}"),
    Part("a policy trained to hold a slot", "better than the trim", "make train ARGS="),
    Part(
        "numbers of the docs",
        "all but times, compared digit by digit",
        "make numbers ARGS=--check",
    ),
)


def run(part, jobs):
    """Return how the part ended, as text, and its wall-clock time in s."""
    words = shlex.split(part.command.format(jobs=jobs))
    given = {}
    while "=" in words[0]:
        name, _, value = words.pop(0).partition("=")
        given[name] = value
    if words[0] == "pytest":
        words += ["-q", *(["-n", str(jobs)] if part.parallel else ["-n", "0"])]
    if words[0] in ("pytest", "testbed"):
        words[0] = str(Path(sys.executable).parent / words[0])
    inherited = {k: v for k, v in os.environ.items() if k not in ("ARGS", "MAKEFLAGS", "MFLAGS")}
    began = time.monotonic()
    process = subprocess.Popen(
        words, cwd=ROOT, env=inherited | given, stdout=subprocess.PIPE, text=True
    )
    lines = []
    try:
        for line in process.stdout:
            print(line, end="", flush=True)
            lines = [*lines[-200:], line]
        code = process.wait(LONGEST_H * 3600.0)
    finally:
        process.kill()
    counted = re.findall(r"(\d+ (?:passed|failed|skipped|errors?))\b", "".join(lines[-3:]))
    result = ", ".join(counted)
    if code and "failed" not in result:
        result = f"exit code {code}"
    return result or "passed", time.monotonic() - began


def commit():
    """Return the short name of the commit; with a star if files differ from it."""
    git = ["git", "-C", str(ROOT)]
    try:
        name = subprocess.check_output([*git, "rev-parse", "--short", "HEAD"], text=True).strip()
        changed = subprocess.check_output([*git, "status", "--porcelain"], text=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    changed = [each for each in changed.splitlines() if not each.endswith(str(PAGE.name))]
    return name + ("*" if changed else "")


def table(rows):
    """Return the lines of the table, in the order of PARTS.

    Args:
        rows: cells after the sample, by the name of the part.
    """
    lines = [f"| {' | '.join(HEADINGS)} |", "|---" * len(HEADINGS) + "|"]
    for part in PARTS:
        cells = rows.get(part.name, ["", "", "", ""])
        lines.append(f"| {' | '.join([part.name, part.sample, *cells])} |")
    return "\n".join(lines)


def read_rows(page):
    """Return the cells after the sample, by the name of the part."""
    inside = page[page.index(BEGIN) + len(BEGIN) : page.index(END)].strip().splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in inside]
    return {each[0]: each[2:] for each in cells}


def write_rows(rows):
    """Write the table into the page."""
    page = PAGE.read_text("utf-8")
    begin, end = page.index(BEGIN) + len(BEGIN), page.index(END)
    PAGE.write_text(f"{page[:begin]}\n\n{table(rows)}\n\n{page[end:]}", "utf-8")


def main():
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="print parts and commands; run nothing")
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="PART")
    parser.add_argument("--jobs", type=int, default=2, help="tests at once")
    parser.add_argument("--no-write", action="store_true", help="leave the page as it is")
    args = parser.parse_args()
    failed = []
    for part in PARTS:
        if args.list:
            print(f"{part.name}: {part.command.format(jobs=args.jobs)}")
        elif part.name in args.only:
            print(f"{part.name}:", flush=True)
            at = commit()
            result, wall_s = run(part, args.jobs)
            failed += [part.name] if "failed" in result or "code" in result else []
            if not args.no_write:
                rows = read_rows(PAGE.read_text("utf-8"))
                minutes = f"{wall_s / 60.0:.1f} min"
                rows[part.name] = [result, minutes, at, date.today().isoformat()]
                write_rows(rows)
    if failed:
        sys.exit(f"failed: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
