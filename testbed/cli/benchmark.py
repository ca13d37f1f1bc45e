"""The commands that fly, verify and rank entries of the benchmark."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import Jobs, JsonFile, Quiet, output_option, require_positive, value_option
from testbed.cli.output import (
    PipeSafeConsole,
    describe_file,
    find_folder,
    message_console,
    result_console,
    write_json_output,
)

if TYPE_CHECKING:
    from testbed.benchmark.cell import CellKey
    from testbed.benchmark.result import EntryResult

PAGE, DOCUMENT = "benchmark.html", "benchmark.json"
RESULTS = "results"


def benchmark_command() -> None:
    """Fly formation laws on ten frozen tasks, and rank them: `testbed benchmark LAW.py:function`.

    `benchmark verify` repeats flights of a result, `benchmark table` ranks results.
    """


def benchmark_fly_command(
    laws: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[LAW]...",
            help="LAW.py:function, or an entry that comes with the testbed; may be repeated.",
            show_default=False,
        ),
    ] = None,
    entry: Annotated[
        list[Path] | None,
        value_option(
            "FILE", "Name, settings and bounds of tuning of a LAW.py; one for each, in their order."
        ),
    ] = None,
    all_entries: Annotated[
        bool, typer.Option("--all", help="Fly all entries that come with the testbed, too.")
    ] = False,
    pulse: Annotated[
        str | None,
        value_option(
            "HEX",
            "Public number for the seeds of ranks, published after the entries' digests.  "
            "\\[default: practice seeds]",
        ),
    ] = None,
    task: Annotated[
        list[str] | None,
        value_option("TASK", "Fly this task only, without ranks; may be repeated."),
    ] = None,
    out: Annotated[
        Path | None,
        value_option(
            "DIR", "Folder to create.  \\[default: logs/benchmarks/formation-bench-1.0/UTC-ID]"
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue in the folder of --out, or in the latest: what is there is kept unless "
            "something that it depends on has changed.",
        ),
    ] = False,
    jobs: Jobs = None,
    json: JsonFile = None,
    quiet: Quiet = False,
) -> None:
    """Tune entries, fly them on the benchmark, and write results and a page with ranks.

    The law is a stranger's program as any other: its file and SHA-256 are printed before it runs,
    each flight in a process with limits of time and memory, with the rights of your account.
    """
    from testbed.benchmark.campaign import (
        Campaign,
        fly_campaign,
        practice_seeds,
        pulse_seeds,
    )
    from testbed.benchmark.entry import open_entries, shipped_names
    from testbed.benchmark.ranking import ranking
    from testbed.benchmark.result import to_document
    from testbed.benchmark.seeds import read_pulse
    from testbed.benchmark.task import BENCHMARK, load_benchmark
    from testbed.cli.progress import progress_counter
    from testbed.core.errors import InputError
    from testbed.logs.file_record import check_folder_output, record_files

    words = [*(laws or ()), *(each for each in shipped_names() if all_entries)]
    if not words:
        raise InputError("there is no entry (write LAW.py:function, or --all)")
    entries = open_entries(dict.fromkeys(words), entry or ())
    benchmark = load_benchmark()
    for name in task or ():
        if name not in benchmark.tasks:
            raise InputError(f"--task {name}: write one of {', '.join(benchmark.tasks)}")
    if pulse is None:
        seeds = practice_seeds()
    else:
        seeds = pulse_seeds(benchmark, entries, read_pulse(pulse))
    messages = message_console()
    name = BENCHMARK.replace(" ", "-")
    folder = find_folder("benchmark", name, out, resume=resume, holds="kept")
    check_folder_output(folder, (PAGE, DOCUMENT), "benchmark")
    messages.write_line(f" {benchmark.name}, SHA-256 {benchmark.digest}")
    for each in entries:
        messages.write_line(f" {each.name}: {each.law.describe()}")
        messages.write_line(f" {each.name}: entry {each.digest}")
    campaign = Campaign(entries, seeds, folder, jobs=jobs, only=tuple(task or ()))
    try:
        with progress_counter("flights", rate="flights", hidden=quiet) as progress:
            results = fly_campaign(
                campaign,
                report=lambda line: None if quiet else messages.write_line(f" {line}"),
                progress=progress,
            )
    except KeyboardInterrupt:
        messages.write_line(f" interrupted: what was found is in {folder}; write --resume")
        raise
    (folder / RESULTS).mkdir(exist_ok=True)
    files = []
    for result in results:
        files.append(folder / RESULTS / f"{result.entry.name}.json")
        write_json_output(files[-1], to_document(result))
    found = ranking(results, benchmark)
    write_json_output(folder / DOCUMENT, found)
    _write_page(found, folder / PAGE)
    record_files(folder, PAGE, DOCUMENT, RESULTS, "kept")
    write_json_output(json, found)
    if not quiet:
        _print_ranking(found, folder / PAGE, files, result_console(json))


def benchmark_verify_command(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Result file of an entry.")],
    law: Annotated[
        str | None,
        typer.Argument(
            metavar="[LAW]",
            help="LAW.py:function that was entered; nothing for a law of the testbed.",
            show_default=False,
        ),
    ] = None,
    cells: Annotated[
        int | None,
        value_option(
            "N", "Number of flights that are drawn.  \\[default: 6]", check=require_positive
        ),
    ] = None,
    cell: Annotated[
        list[str] | None,
        value_option("CELL", "Repeat this flight, task/level/seed; may be repeated."),
    ] = None,
    sample: Annotated[
        int | None,
        value_option("N", "Seed of the drawn flights.  \\[default: random, and printed]"),
    ] = None,
    log: Annotated[
        Path | None,
        value_option(
            "DIR",
            "Keep the logs of these flights in folders in DIR: DIR/wind-2-7, for `testbed view`.",
        ),
    ] = None,
    jobs: Jobs = None,
    json: JsonFile = None,
) -> None:
    """Repeat drawn flights of a result, and compare their numbers to the last bit.

    Only the law named here runs, and only if its SHA-256 is that of the result. The exit code is 3
    if a number differs.
    """
    from testbed.benchmark.result import read_result
    from testbed.benchmark.task import load_benchmark
    from testbed.benchmark.verify import (
        SAMPLE,
        check_law,
        check_present,
        draw_sample,
        repeat_cells,
    )
    from testbed.cli.progress import progress_counter

    found, benchmark = read_result(result), load_benchmark()
    messages = message_console()
    named = _law_of(found, law)
    messages.write_line(f" {found.entry.name}: {named.describe()}")
    check_law(found, named)
    check_present(found, benchmark)
    seed = secrets.randbits(32) if sample is None else sample
    if cell:
        keys = [_read_cell(each) for each in cell]
    else:
        keys = draw_sample(found, SAMPLE if cells is None else cells, seed)
        messages.write_line(f" {len(keys)} of {len(found.cells)} flights, --sample {seed}")
    with progress_counter("flights", rate="flights") as progress:
        repeated = repeat_cells(
            found, named, keys, benchmark=benchmark, jobs=jobs, log=log, progress=progress
        )
    console = result_console(json)
    for each in repeated:
        same = not each.different
        text = "equal to the bit" if same else f"differs in {', '.join(each.different)}"
        was = f"{each.result.number_m:.4f} m" + ("" if same else f", now {each.now.number_m:.4f} m")
        console.write_line(f" {each.key!s:<40} {was}: {text}", "" if same else "red")
    different = [each for each in repeated if each.different]
    write_json_output(
        json,
        {
            "entry": found.entry.name,
            "sample": None if cell else seed,
            "cells": [
                {"cell": str(each.key), "different": list(each.different)} for each in repeated
            ],
        },
    )
    raise typer.Exit(ExitCode.DIFFERENT if different else ExitCode.OK)


def benchmark_table_command(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULT...", help="Result files of entries.")
    ],
    out: Annotated[
        Path | None,
        output_option("--out", metavar="FILE.html", help="Write the page.", suffixes=(".html",)),
    ] = None,
    json: JsonFile = None,
) -> None:
    """Rank results that were flown with the same tasks, seeds, code and versions.

    Nothing is flown, and no code of an entry runs.
    """
    from testbed.benchmark.ranking import ranking
    from testbed.benchmark.result import read_result
    from testbed.benchmark.task import load_benchmark

    found = ranking([read_result(each) for each in results], load_benchmark())
    if out is not None:
        _write_page(found, out)
    write_json_output(json, found)
    _print_ranking(found, out, (), result_console(json))


def _law_of(result: EntryResult, law: str | None) -> Any:  # noqa: ANN401 - a law
    """Return the law that the command names, or one of the testbed."""
    from testbed.benchmark.entry import open_entries, open_law, shipped_names
    from testbed.core.errors import InputError

    if law is not None:
        return open_law(law)
    for each in open_entries(shipped_names()):
        if each.law.reference == result.entry.law:
            return each.law
    raise InputError(
        f"{result.entry.name}: its law is {result.entry.law[:80]}, which does not come with the "
        "testbed (name the file: LAW.py:function)"
    )


def _read_cell(text: str) -> CellKey:
    from testbed.benchmark.cell import CellKey
    from testbed.core.errors import InputError
    from testbed.core.numbers import parse_whole

    name, _, rest = text.partition("/")
    level, seed = (parse_whole(each) for each in (*rest.split("/"), "", "")[:2])
    if level is None or seed is None or rest.count("/") != 1:
        raise InputError(f"--cell {text[:40]}: write task/level/seed, such as wind/2/7")
    return CellKey(name, level, seed)


def _write_page(found: dict[str, Any], page: Path) -> None:
    from testbed.core.files import report_write_errors
    from testbed.reports import write_page
    from testbed.reports.benchmark_page import benchmark_page

    with report_write_errors(page):
        write_page(benchmark_page(found), page)


def _print_ranking(
    found: dict[str, Any], page: Path | None, files: Sequence[Path], console: PipeSafeConsole
) -> None:
    from testbed.reports.benchmark_page import row_lines

    seeds = found["conditions"]["seeds"]
    console.write_heading(found["conditions"]["benchmark"], f" · {seeds['kind']} seeds")
    for line in row_lines(found):
        console.write_line(f" {line}")
    console.write_line()
    for each in files:
        console.write_line(f" result  {describe_file(each)}")
    if page is not None:
        console.write_line(f" page    {describe_file(page)}")
