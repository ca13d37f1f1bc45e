"""Progress bars on standard error, for a run and for a number of items."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from testbed.core.compile import NOTICE

if TYPE_CHECKING:
    from testbed.core.records import Event, RunInfo, Sample

REDRAW_S = 0.1  # wall-clock time between redraws
SPEED_WINDOW_S = 600.0  # the remaining time is estimated from the speed over this window


class _RealTimeFactor(ProgressColumn):
    """Simulated seconds per wall-clock second."""

    def render(self, task: Task) -> Text:
        """Format the factor; see rich."""
        return Text(f"{task.speed:.0f} x" if task.speed else "", style="cyan")


class _Rate(ProgressColumn):
    """Items per second of wall-clock time; empty without a name of the items."""

    def __init__(self, items: str) -> None:
        super().__init__()
        self._items = items

    def render(self, task: Task) -> Text:
        """Format the rate; see rich."""
        speed = task.speed if self._items else None
        if not speed:
            return Text()
        number = f"{speed:,.0f}" if speed >= 100.0 else f"{speed:.3g}"
        return Text(f"{number} {self._items}/s", style="cyan")


class ProgressBar:
    """Show the progress of a run; hidden where the console is no terminal."""

    zero_copy = True

    def __init__(self, console: Console) -> None:
        """Draw on this console."""
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.completed:.0f} of {task.total:.0f} s simulated"),
            _RealTimeFactor(),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._drawn = 0.0

    def begin(self, info: RunInfo) -> None:
        """Draw the bar at 0 s."""
        self._task = self._progress.add_task(info.scenario_name, total=info.duration_s)
        self._progress.start()

    def observe(self, sample: Sample) -> None:
        """Redraw the bar, at most once per `REDRAW_S`."""
        now = time.monotonic()
        if now - self._drawn >= REDRAW_S:
            self._drawn = now
            self._progress.update(self._task, completed=sample.time_s)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Remove the bar."""
        self._progress.stop()


class CompilingBar:
    """Announce once that kernels are compiled, and show how many are ready; see `runs.run.run`."""

    def __init__(self, console: Console) -> None:
        """Write and draw on this console."""
        self._console = console
        self._bar: Progress | None = None

    def __call__(self, ready: int, total: int) -> None:
        """Announce the work, then draw the bar; remove it when all are ready."""
        if self._bar is None:
            self._console.print(NOTICE)
            self._bar = Progress(
                TextColumn("[bold]compiling"),
                BarColumn(bar_width=None),
                TextColumn("{task.completed} of {task.total} kernels"),
                console=self._console,
                transient=True,
                disable=not self._console.is_terminal,
            )
            self._task = self._bar.add_task("", total=total)
        self._bar.start()
        self._bar.update(self._task, completed=ready, total=total)
        if ready == total:
            self._bar.stop()


@contextmanager
def progress_counter(
    label: str, *, total: int = 0, unit: str = "", rate: str = "", hidden: bool = False
) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error in the block, if that is a terminal.

    Args:
        label: before the bar.
        total: number of items, if known in advance.
        unit: after the numbers.
        rate: name of the items, to show how many are done per second.
        hidden: show nothing.

    Yields:
        A function that updates the bar, called with the items done and their total.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=None),
        TextColumn(f"{{task.completed:,.0f}} of {{task.total:,.0f}} {unit}".rstrip()),
        _Rate(rate),
        TimeRemainingColumn(compact=True),
        console=console,
        transient=True,
        disable=hidden or not console.is_terminal,
        speed_estimate_period=SPEED_WINDOW_S,
    )
    with bar:
        task = bar.add_task(label, total=total, start=False)
        started = False

        def update(done: int, total: int) -> None:
            nonlocal started
            if not started:  # items of an earlier session do not count for the speed
                started = True
                bar.reset(task, total=total, completed=done)
            bar.update(task, completed=done, total=total)

        yield update


@contextmanager
def activity(label: str) -> Iterator[Callable[[str], None]]:
    """Show on standard error, if that is a terminal, what is being done and for how long.

    Args:
        label: before the words.

    Yields:
        A function that is called with what is done next, in words.
    """
    console = Console(stderr=True)
    line = Progress(
        SpinnerColumn("line"),
        TextColumn("[bold]{task.description}"),
        TextColumn("{task.fields[doing]}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    with line:
        task = line.add_task(label, doing="")
        yield lambda doing: line.update(task, doing=doing)
