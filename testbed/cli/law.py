"""The command that shows control functions and barriers before a flight: law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import Overrides, scenario_names
from testbed.cli.output import result_console
from testbed.cli.report import FigureFormat, Figures, check_figures, figure_format, write_figures

if TYPE_CHECKING:
    from testbed.reports.figures_law import Barriers, Functions


@draws_figures("figures")
def law_command(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENARIO]",
            autocompletion=scenario_names,
            help="Name or path of a scenario.  \\[default: the examples as the paper draws them]",
            show_default=False,
        ),
    ] = None,
    overrides: Overrides = None,
    figures: Figures = None,
    format: FigureFormat = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Show control functions and barriers of a scenario, or of the paper, and draw them.

    Functions of your own are checked.
    """
    import numpy as np
    from rich.table import Table

    from testbed.formation.barrier import barrier_curve
    from testbed.formation.control_function import control_function_curve
    from testbed.reports.figures_law import half_way, law_figures

    ending = figure_format(format, figures)
    functions, barriers = _of_scenario(scenario, overrides or ()) if scenario else _of_paper()
    subtitle = scenario or "as in [HBH23], Figs. 1 and 2"
    drawn = list(law_figures(functions, barriers, subtitle)) if figures else []
    check_figures(drawn, figures, ending, look)
    console = result_console()
    table = Table(box=None, pad_edge=True)
    for name in ("control function", "mu at 0", "rho_bar", "half of it at, m"):
        table.add_column(name, justify="left" if name == "control function" else "right")
    for label, function in functions.items():
        at_zero = control_function_curve(function, np.zeros(1))[0][0]
        table.add_row(label, f"{at_zero:.4g}", f"{function.bound:.4g}", f"{half_way(function):.3g}")
    console.print(table)
    table = Table(box=None, pad_edge=True)
    for name in ("barrier", "speeds, m/s", "h midway", "h' at the bounds, s/m"):
        table.add_column(name, justify="left" if name == "barrier" else "right")
    for label, (barrier, low, high) in barriers.items():
        value, slope = barrier_curve(barrier, np.array([0.5 * (low + high), low, high]), low, high)
        table.add_row(
            label, f"{low:g} to {high:g}", f"{value[0]:.3g}", f"{slope[1]:.3g}, {slope[2]:.3g}"
        )
    console.print(table)
    if figures:
        write_figures(drawn, figures, ending, console, look)


def _of_paper() -> tuple[Functions, Barriers]:
    """Return the examples with the parameters of Figs. 1 and 2 of [HBH23]."""
    from testbed.formation.barrier import SpeedBarrier
    from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1

    functions: Functions = {
        "example 1, ν₁ = ν₂ = 1, m = 0.5": example_1(1.0, 1.0, 0.5),
        "example 2": EXAMPLE_2,
        "example 3": EXAMPLE_3,
    }
    barriers: Barriers = {
        "example 4, ν = 1/50": (SpeedBarrier(4, 1.0 / 50.0), 10.0, 30.0),
        "example 5, ν = 1/20": (SpeedBarrier(5, 1.0 / 20.0), 10.0, 30.0),
        "example 6, ν = 1": (SpeedBarrier(6, 1.0), 10.0, 30.0),
    }
    return functions, barriers


def _of_scenario(name: str, overrides: Sequence[str] = ()) -> tuple[Functions, Barriers]:
    """Return the different functions of a scenario's followers, named by these.

    Raises:
        InputError: the scenario cannot be read, or a function of its own violates a condition.
    """
    from testbed.core.records import join_names
    from testbed.plan.control import make_barrier, make_control_function
    from testbed.plan.fleet import agent_parameters
    from testbed.scenario import load_scenario

    scenario, notes = load_scenario(name, overrides), list[str]()
    functions: dict[Any, list[str]] = {}
    barriers: dict[Any, list[str]] = {}
    for follower in scenario.aircraft_names[1:]:
        agent = agent_parameters(scenario.formation, follower)
        functions.setdefault(agent.control_function, []).append(follower)
        barriers.setdefault((agent.barrier, agent.speed_mps), []).append(follower)
    return (
        {join_names(each): make_control_function(key, notes) for key, each in functions.items()},
        {
            join_names(each): (make_barrier(chosen, low, high, notes), low, high)
            for (chosen, (low, high)), each in barriers.items()
        },
    )
