"""Progress bars: of a run, as an observer, and of anything that is counted."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from testbed.state import Event, Frame, RunInfo

PERIOD_S = 0.1  # of wall-clock time between redraws
SEEN_S = 600.0  # the stretch of the past that tells how quick we are


class _Speed(ProgressColumn):
    """Simulated seconds per second of waiting."""

    def render(self, task: Task) -> Text:
        """See rich."""
        return Text(f"{task.speed:.0f} x" if task.speed else "", style="cyan")


class ProgressBar:
    """Show how far a run is; silent where the console is no terminal."""

    borrows = True  # keeps nothing of a frame

    def __init__(self, console: Console) -> None:
        """Draw on this console."""
        self._progress = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.completed:.0f} of {task.total:.0f} s flown"),
            _Speed(),
            TimeRemainingColumn(compact=True),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._drawn = 0.0

    def begin(self, info: RunInfo) -> None:
        """Draw the empty bar."""
        self._task = self._progress.add_task(info.scenario_name, total=info.duration_s)
        self._progress.start()

    def observe(self, frame: Frame) -> None:
        """Move the bar, a few times a second."""
        now = time.monotonic()
        if now - self._drawn >= PERIOD_S:
            self._drawn = now
            self._progress.update(self._task, completed=frame.time_s)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Take the bar away."""
        self._progress.stop()


@contextmanager
def counting(
    what: str, *, of: int = 0, done: str = "", hidden: bool = False
) -> Iterator[Callable[[int, int], None]]:
    """A bar on standard error, silent where that is no terminal, for as long as the block lasts.

    Args:
        what: is shown before the bar.
        of: how many there will be, if that is known.
        done: after the numbers, with a blank.
        hidden: show nothing.

    Yields:
        A function that moves the bar: how many are done, and of how many.
    """
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f}" + done),
        TimeRemainingColumn(compact=True),
        console=console,
        transient=True,
        disable=hidden or not console.is_terminal,
        speed_estimate_period=SEEN_S,
    )
    with bar:
        task = bar.add_task(what, total=of, start=False)
        begun: list[int] = []

        def show(number: int, of: int) -> None:
            if not begun:  # what was done before says nothing about how quick we are
                begun.append(number)
                bar.reset(task, total=of, completed=number)
            bar.update(task, completed=number, total=of)

        yield show
