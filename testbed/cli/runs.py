"""The command that deletes old runs, prune, and the table of `list --runs`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from testbed.cli.options import MAX_SHOWN, positive_option, value_option
from testbed.cli.output import MISSING, PipeSafeConsole, result_console
from testbed.core.errors import InputError
from testbed.core.files import format_bytes
from testbed.core.numbers import TIME_UNITS, parse_quantity

if TYPE_CHECKING:
    from testbed.logs.run_list import RunEntry

_BYTES = {"kB": 1e3, "MB": 1e6, "GB": 1e9}
_LARGEST = 100_000  # in the largest unit: 1,900 years, 100 TB

RunsFolder = Annotated[
    Path, typer.Argument(metavar="[FOLDER]", help="Folder of the runs.", show_default="logs")
]


def _quantity(units: Mapping[str, float], example: str) -> Callable[..., str | None]:
    """Make a typer callback that accepts a number with one of these units."""

    def check(parameter: typer.CallbackParam, text: str | None) -> str | None:
        if text is not None:
            at_most = f"at most {_LARGEST:,}{max(units, key=units.__getitem__)}"
            shown = text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"
            _parse(text, units, f"{parameter.opts[0]} {shown}: write {example}, {at_most}")
        return text

    return check


def _parse(text: str, units: Mapping[str, float], error: str) -> float:
    value = parse_quantity(text, units)
    if value is None or value > _LARGEST * max(units.values()):
        raise InputError(error)
    return value


def prune_command(
    folder: RunsFolder = Path("logs"),
    older: Annotated[
        str | None,
        value_option(
            "TIME",
            "Runs that began longer ago than this: 12h, 30d or 4w.",
            check=_quantity(TIME_UNITS, "a time with its unit, such as 12h, 30d or 4w"),
        ),
    ] = None,
    size: Annotated[
        str | None,
        value_option(
            "SIZE",
            "The oldest runs, until the rest is no larger than this: 500MB or 5GB.",
            check=_quantity(_BYTES, "a size in kB, MB or GB, such as 500MB or 5GB"),
        ),
    ] = None,
    keep: Annotated[
        int | None,
        positive_option(
            "N",
            "Keep the newest N runs of each scenario; without --older and --size, delete "
            "all others.",
        ),
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Delete; without it the runs are only listed.")
    ] = False,
) -> None:
    """Delete old runs: by age, by total size, or all but the newest.

    Deletes run directories only: none that is being flown, and none with a file that is not as the
    testbed wrote it, such as one that you added, changed or linked. Those are named, and stay
    whole. Without --yes nothing is deleted.
    """
    from testbed.logs.run_list import delete_runs, list_runs, select_runs

    if older is None and size is None and keep is None:
        raise InputError("prune: which runs? (write --older 30d, --size 5GB or --keep 3)")
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; run this where the runs are")
    runs = list_runs(folder)
    chosen = select_runs(
        runs,
        older_than=timedelta(seconds=_parse(older, TIME_UNITS, "")) if older else None,
        keep=keep,
        max_bytes=int(_parse(size, _BYTES, "")) if size else None,
    )
    console = result_console()
    for entry in (each for each in runs if each.others):
        more = f" and {len(entry.others) - 1} more" if entry.others[1:] else ""
        console.write_line(
            f"kept: {entry.directory} has {entry.others[0]}{more}, not as the testbed wrote it",
            "yellow",
        )
    if yes:
        chosen = list(delete_runs(chosen))
    if chosen:
        print_runs(chosen, console)
        console.print()
    rest = sum(each.size for each in runs) - sum(each.size for each in chosen)
    what = f"{_count(chosen)}: {'deleted' if yes else 'to delete'}"
    left = f"{len(runs) - len(chosen)} {'left' if yes else 'would be left'}, {format_bytes(rest)}"
    console.write_line(f"{what}; {left}")
    if chosen and not yes:
        console.write_line("nothing was deleted: write --yes to delete these", "dim")


def print_runs(runs: Sequence[RunEntry], console: PipeSafeConsole) -> None:
    """Print a line for each run: directory, date, simulated time, outcome and size."""
    table = Table(box=None, pad_edge=False, show_header=False)
    for justify in ("left", "left", "right", "left", "right"):
        table.add_column(justify=justify, no_wrap=True)
    for each in runs:
        duration = MISSING if each.simulated_s is None else f"{each.simulated_s:,.0f} s"
        table.add_row(
            str(each.directory),
            f"{each.begun:%Y-%m-%d %H:%M} UTC",
            duration,
            each.outcome.replace("_", " "),
            format_bytes(each.size),
        )
    console.print_table(table)


def runs_document(runs: Sequence[RunEntry]) -> list[dict[str, Any]]:
    """Return the same as a JSON document."""
    return [
        {
            "directory": str(each.directory),
            "scenario": each.scenario,
            "begun": each.begun.isoformat(),
            "simulated_s": each.simulated_s,
            "outcome": each.outcome,
            "size_bytes": each.size,
        }
        for each in runs
    ]


def _count(runs: Sequence[RunEntry]) -> str:
    number = "1 run" if len(runs) == 1 else f"{len(runs)} runs"
    return f"{number}, {format_bytes(sum(each.size for each in runs))}"
