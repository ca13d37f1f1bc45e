"""Options of every command that draws figures: width, title, font and labels.

A command gets them by `@draws_figures("plot")` and a parameter `look: FigureLook`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.options import require_finite
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.scenario.yaml_io import Node
    from testbed.views.figure_style import FigureStyle
    from testbed.views.panels import PanelGrid

WIDTHS_IN = 2.0, 20.0

PANEL = "Figures"  # of the help
Width = Annotated[
    float | None,
    typer.Option(
        metavar="IN",
        callback=require_finite,
        rich_help_panel=PANEL,
        help="Width in inches, with text of 8 points, for the column of a paper: "
        f"{WIDTHS_IN[0]:g} to {WIDTHS_IN[1]:g}.",
    ),
]
NoTitle = Annotated[
    bool, typer.Option("--no-title", rich_help_panel=PANEL, help="Draw without titles.")
]
Font = Annotated[
    str | None,
    typer.Option(
        metavar="FAMILY",
        rich_help_panel=PANEL,
        help="Font, such as 'DejaVu Serif' or STIXGeneral.  \\[default: DejaVu Sans]",
    ),
]
Labels = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        rich_help_panel=PANEL,
        help="YAML map of names to what stands in the figure in their place: cases, axes, "
        "followers.",
    ),
]
_OPTIONS = {
    "width": (Width, None, "--width"),
    "no_title": (NoTitle, False, "--no-title"),
    "font": (Font, None, "--font"),
    "labels": (Labels, None, "--labels"),
}


@dataclass(frozen=True, slots=True)
class FigureLook:
    """The values of these options, checked.

    Args:
        width: inches; None: as wide as the panels need.
        no_title: draw without title and subtitle.
        font: family; None: Matplotlib's own.
        labels: texts by name, with their places in the file.
    """

    width: float | None = None
    no_title: bool = False
    font: str | None = None
    labels: dict[str, Node] = field(default_factory=dict)

    def style(self, grids: Iterable[PanelGrid]) -> FigureStyle:
        """Return the style of figures.

        Raises:
            ScenarioError: the file of --labels has a name that stands in none of them.
        """
        from testbed.scenario.problems import Problem, ScenarioError
        from testbed.views.figure_style import FigureStyle, unknown_labels

        if unknown := unknown_labels(self.labels, grids):
            raise ScenarioError(
                [
                    Problem(self.labels[name].key, f"stands in no figure (write {near})", (name,))
                    for name, near in unknown.items()
                ]
            )
        labels = {name: str(node.value) for name, node in self.labels.items()}
        return FigureStyle(self.width, not self.no_title, self.font or "", labels)

    def save(self, grid: PanelGrid, path: Path, option: str = "--plot") -> None:
        """Draw a figure to the file of an option.

        Raises:
            InputError: the file cannot be written, or a label is of nothing in the figure.
        """
        from testbed.views.matplotlib_backend import save_figure

        with report_write_errors(f"{option} {path}"):
            save_figure(grid, path, self.style([grid]))


DEFAULT_LOOK = FigureLook()


def draws_figures(file: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options, which it gets as its parameter `look`.

    Args:
        file: name of the parameter with the file or the folder of figures: without it the options
            are errors.
    """

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        own = [each for each in signature.parameters.values() if each.name != "look"]
        option = f"--{file.replace('_', '-')}"
        own += [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind
            )
            for name, (kind, default, _) in _OPTIONS.items()
        ]

        @wraps(command)
        def run(**values: Any) -> None:  # noqa: ANN401 - of all options
            given = {name: values.pop(name) for name in _OPTIONS}
            if not values[file]:
                for name, (_, default, written) in _OPTIONS.items():
                    if given[name] != default:
                        raise InputError(
                            f"{written}: is of the figures of {option}; write that too"
                        )
            command(**values, look=_checked(**given))

        own = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in own]
        run.__signature__ = signature.replace(parameters=own)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in own}
        return run

    return with_options


def _checked(
    width: float | None, no_title: bool, font: str | None, labels: Path | None
) -> FigureLook:
    """Check the values of the options before any work.

    Raises:
        InputError: the width is too small or too large, there is no such font, or the file of
            labels cannot be used.
    """
    low, high = WIDTHS_IN
    if width is not None and not low <= width <= high:
        raise InputError(f"--width {width:g}: write {low:g} to {high:g}, in inches")
    if font is not None:
        from testbed.views.matplotlib_backend import check_font

        try:
            check_font(font)
        except InputError as error:
            raise InputError(f"--font {error}") from None
    return FigureLook(width, no_title, font, {} if labels is None else _read_labels(labels))


def _read_labels(path: Path) -> dict[str, Node]:
    """Read a file of labels.

    Raises:
        ScenarioError: it cannot be read, is no map of names to texts, or has wrong mathematics.
    """
    from testbed.scenario.problems import Problem, ScenarioError
    from testbed.scenario.yaml_io import error_at, read
    from testbed.views.matplotlib_backend import mathematics_problem

    tree = read(path)
    if not isinstance(tree.value, dict):
        raise error_at(tree.place, "is no map (write lines such as uav1: left wingman)")
    problems = []
    for name, node in tree.value.items():
        if not isinstance(node.value, str) or not node.value.strip():
            problem = "is no text (write one, in quotes if it is a number)"
        elif wrong := mathematics_problem(node.value):
            problem = f"{wrong} (write text, or mathematics as $x_1$)"
        else:
            continue
        problems.append(Problem(node.place, problem, (name,)))
    if problems:
        raise ScenarioError(problems)
    return tree.value
