"""Progress bars on standard error, for a number of items."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

SPEED_WINDOW_S = 600.0  # the remaining time is estimated from the speed over this window


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
