"""Progress of a flight: a bar in a terminal, a line in a notebook or a log, a user's function."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from testbed.core.compile import notice
from testbed.scenario.arguments import check_calls

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as RichProgress

    from testbed.core.records import Event, RunInfo, Sample

# Called with "compiling", the kernels that are ready, and all of them; then with "flying", the
# simulated time and the duration, s.
Report: TypeAlias = Callable[[str, float, float], None]
# True: shown; False: not shown; None: shown in a notebook only.
Progress: TypeAlias = "bool | Report | None"

REPORT_S = 0.1  # wall-clock time between reports in flight
_NOTEBOOK_S, _LOG_S = 0.3, 10.0  # between updates of a line in a notebook, and lines in a log
_UNITS = {"compiling": "kernels", "flying": "s simulated"}


class Display(Protocol):
    """What shows the progress of one flight until it is closed."""

    def __call__(self, phase: str, done: float, total: float) -> None:
        """Show progress; see `Report`."""

    def close(self) -> None:
        """Remove or finish what is shown; repeatable."""


@contextmanager
def reporting_progress(progress: Progress, name: str) -> Iterator[Report | None]:
    """Show the progress of a flight in the block.

    Args:
        progress: as given by the user, see `Progress`.
        name: of the scenario.

    Yields:
        The function to call; None: nothing is shown.

    Raises:
        InputError: `progress` is neither true, false, None nor a function.
    """
    check_progress(progress)
    if progress is None:
        progress = in_notebook()
    if not isinstance(progress, bool):
        yield progress
    elif not progress:
        yield None
    else:
        display = make_display(name)
        try:
            yield display
        finally:
            display.close()


def check_progress(progress: Progress) -> None:
    """Check the argument of a user.

    Raises:
        InputError: it is neither true, false, None nor a function.
    """
    if not isinstance(progress, bool | None):
        check_calls("progress", progress)


def make_display(name: str, console: Console | None = None) -> Display:
    """Make what suits a notebook, a terminal or another output.

    Args:
        name: of the scenario.
        console: None: standard error.
    """
    from rich.console import Console

    if console is None and in_notebook():
        return _NotebookLine(name)
    shown = console or Console(stderr=True, highlight=False)
    return _TerminalBar(name, shown) if shown.is_terminal else _LogLines(name, shown)


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


class FlightProgress:
    """Report the progress of a flight, as its observer."""

    zero_copy = True

    def __init__(self, report: Report) -> None:
        self._report = report
        self._reported = self._time_s = self._total_s = 0.0

    def begin(self, info: RunInfo) -> None:
        """Report the start of the flight."""
        self._total_s = info.duration_s
        self._report("flying", 0.0, self._total_s)

    def observe(self, sample: Sample) -> None:
        """Report the time of a sample, at most once per `REPORT_S`."""
        self._time_s = sample.time_s
        now = time.monotonic()
        if now - self._reported >= REPORT_S:
            self._reported = now
            self._report("flying", self._time_s, self._total_s)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Report the last time."""
        self._report("flying", self._time_s, self._total_s)


def compiling_report(report: Report | None) -> Callable[[int, int], None] | None:
    """Return what `core.compile.prepare` calls; None: nothing."""
    if report is None:
        return None
    return lambda ready, total: report("compiling", ready, total)


def _text(phase: str, done: float, total: float) -> str:
    return f"{done:.0f} of {total:.0f} {_UNITS[phase]}"


class _TerminalBar:
    """A bar with the rate and the remaining time, removed at the end."""

    def __init__(self, name: str, console: Console) -> None:
        self._name, self._console = name, console
        self._bar: RichProgress | None = None
        self._phase = ""
        self._notified = False

    def __call__(self, phase: str, done: float, total: float) -> None:
        if phase != self._phase or self._bar is None:
            self._begin(phase, total)
        assert self._bar is not None, "the phase has begun"
        self._bar.update(self._task, completed=done, total=total)
        if phase == "compiling" and done == total:
            self.close()

    def _begin(self, phase: str, total: float) -> None:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self.close()
        if phase == "compiling" and not self._notified:
            self._notified = True
            self._console.print(notice())
        self._bar = Bar(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=None),
            TextColumn(f"{{task.completed:.0f}} of {{task.total:.0f}} {_UNITS[phase]}"),
            *(
                [_factor_column(), TimeRemainingColumn(compact=True)]
                if phase == "flying"
                else [TimeElapsedColumn()]
            ),
            console=self._console,
            transient=True,
        )
        self._phase = phase
        self._task = self._bar.add_task(self._name if phase == "flying" else phase, total=total)
        self._bar.start()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.stop()
        self._bar = None


def _factor_column() -> Any:  # noqa: ANN401 - rich is imported when a bar is drawn
    from rich.progress import ProgressColumn, Task
    from rich.text import Text

    class RealTimeFactor(ProgressColumn):
        """Simulated seconds per wall-clock second."""

        def render(self, task: Task) -> Text:
            """Format the factor; see rich."""
            return Text(f"{task.speed:.0f} x" if task.speed else "", style="cyan")

    return RealTimeFactor()


class _LogLines:
    """Lines some seconds apart, for an output that is no terminal."""

    def __init__(self, name: str, console: Console) -> None:
        self._name, self._console = name, console
        self._notified = False
        self._phase, self._shown, self._begun = "", 0.0, 0.0

    def __call__(self, phase: str, done: float, total: float) -> None:
        if phase == "compiling" and not self._notified:
            self._notified = True
            self._console.print(notice(), soft_wrap=True)
        now = time.monotonic()
        if phase != self._phase:
            self._phase, self._shown, self._begun = phase, now, now
        if phase == "compiling" and done == total and now - self._begun >= _LOG_S:
            self._shown = now
            took = f"{now - self._begun:.0f} s"
            self._console.print(f"compiling: {_text(phase, done, total)} in {took}", markup=False)
            return
        if now - self._shown >= _LOG_S:
            self._shown = now
            subject = phase if phase == "compiling" else self._name
            self._console.print(
                f"{subject}: {_text(phase, done, total)}", markup=False, soft_wrap=True
            )

    def close(self) -> None:
        pass


class _NotebookLine:
    """One line of the cell's output, which is replaced."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._handle: Any = None
        self._shown = self._begun = -1.0
        self._last = "", 0.0

    def __call__(self, phase: str, done: float, total: float) -> None:
        now = time.monotonic()
        if phase != self._last[0]:
            self._begun = now
            self._shown = -1.0
        self._last = phase, done
        if now - self._shown >= _NOTEBOOK_S or done == total:
            self._shown = now
            first = f"{notice()}: " if phase == "compiling" else ""
            self._show(f"{self._name}: {first}{_text(phase, done, total)}")

    def _show(self, text: str) -> None:
        content = {"text/plain": text}
        if self._handle is None:
            from IPython.display import display

            show: Any = display  # without types
            self._handle = show(content, raw=True, display_id=True)
        else:
            self._handle.update(content, raw=True)

    def close(self) -> None:
        phase, done = self._last
        if phase == "flying":
            wall_s = time.monotonic() - self._begun
            self._show(f"{self._name}: {done:.0f} s simulated in {wall_s:.1f} s")
