"""Arguments and options that several commands share: name, help, validation, completion.

Libraries that complete names are imported when a shell asks. A name without a match is left to the
shell, which completes files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.output import check_output_path
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.numbers import SMALLEST, TIME_UNITS, parse_number, parse_quantity

if TYPE_CHECKING:
    from testbed.scenario import Scenario


_MAX_DEPTH = 6  # sections in each other


def _complete(list_names: str) -> Callable[[str], list[str]]:
    """Make a completion by the names that a function of testbed.scenario lists."""

    def complete(incomplete: str) -> list[str]:
        from testbed import scenario

        return _beginning(incomplete, getattr(scenario, list_names)())

    return complete


scenario_names = _complete("list_scenarios")
study_names = _complete("list_studies")
tune_names = _complete("list_tunings")
aircraft_names = _complete("list_aircraft")


def run_names(incomplete: str) -> list[str]:
    """Return scenarios that were flown from here, or the runs of one: simulation-3/2026…."""
    from testbed.logs.run_directory import LOGS, list_run_names

    with suppress(OSError):
        return _beginning(incomplete, list_run_names(LOGS, incomplete.rpartition("/")[0]))
    return []


def scenario_keys(incomplete: str) -> list[str]:
    """Return the keys of scenarios that begin like this: network.delay_s, fleet.*.sensors."""
    from testbed.scenario import json_schema

    schema = json_schema()
    return _beginning(incomplete, dict.fromkeys(_keys(schema, schema["$defs"])))


def _beginning(incomplete: str, names: Any) -> list[str]:  # noqa: ANN401 - any names
    return [name for name in names if name.startswith(incomplete)]


def _keys(
    schema: Mapping[str, Any], definitions: Mapping[str, Any], prefix: str = ""
) -> Iterator[str]:
    """Yield the dotted keys of a schema that hold values; `*` is any element."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rpartition("/")[2]]
    parts = [each for word in ("anyOf", "oneOf", "allOf") for each in schema.get(word, ())]
    if not any(word in schema for word in ("properties", "items")) and not parts and prefix:
        yield prefix[:-1]
    if prefix.count(".") >= _MAX_DEPTH:
        return
    for part in parts:
        yield from _keys(part, definitions, prefix)
    for name, part in schema.get("properties", {}).items():
        yield from _keys(part, definitions, f"{prefix}{name}.")
    for word in ("items", "additionalProperties"):
        if isinstance(schema.get(word), dict) and _has_keys(schema[word]):
            yield from _keys(schema[word], definitions, f"{prefix}*.")


def _has_keys(schema: Mapping[str, Any]) -> bool:
    return any(word in schema for word in ("$ref", "properties", "anyOf", "oneOf", "allOf"))


MAX_SHOWN = 40  # characters of a value that an error repeats
_MAX_COUNT = 1_000_000  # of flights, processes and other things that are counted
FIGURE_FILES = (".png", ".pdf", ".svg")


def parse_pixels(text: str) -> tuple[int, int] | None:
    """Return width and height of a text such as 1280x720, each of 3 or 4 digits; None: others."""
    match = re.fullmatch(r"([1-9][0-9]{2,3})x([1-9][0-9]{2,3})", text)
    return None if match is None else (int(match[1]), int(match[2]))


def require_finite(parameter: typer.CallbackParam, value: float | None) -> float | None:
    """Refuse NaN and infinity; a typer callback.

    Raises:
        InputError: the value is one of them.
    """
    if value is not None and not math.isfinite(value):
        raise InputError(f"{parameter.opts[0]} {value}: write a finite number")
    return value


def require_positive(parameter: typer.CallbackParam, value: float | None) -> float | None:
    """Refuse zero, negative, infinite and very large whole numbers; a typer callback.

    Raises:
        InputError: the value is one of them.
    """
    whole = isinstance(value, int)
    if not whole:
        require_finite(parameter, value)
    if value is not None and value < SMALLEST:
        kind = "whole number" if whole else "number"
        shown = f"{value}" if whole else f"{value:g}"
        bound = "above 0" if value <= 0 else f"of at least {SMALLEST:g}"
        raise InputError(f"{parameter.opts[0]} {shown}: write a {kind} {bound}")
    if whole and value is not None and value > _MAX_COUNT:
        raise InputError(f"{parameter.opts[0]} {value}: write a number of at most {_MAX_COUNT:,}")
    return value


def value_option(
    metavar: str, help: str, *names: str, check: Callable[..., Any] | None = None
) -> Any:  # noqa: ANN401 - typer's own
    """Declare an option with a value; without names it has that of the parameter."""
    return typer.Option(*names, metavar=metavar, help=help, callback=check)


def finite_option(metavar: str, help: str, *names: str) -> Any:  # noqa: ANN401 - typer's own
    """Declare an option for a finite number; without names it has that of the parameter."""
    return value_option(metavar, help, *names, check=require_finite)


def positive_option(metavar: str, help: str, *names: str) -> Any:  # noqa: ANN401 - typer's own
    """Declare an option for a number above 0; without names it has that of the parameter."""
    return value_option(metavar, help, *names, check=require_positive)


def list_option(metavar: str, help: str, low: float, high: float, allowed: str) -> Any:  # noqa: ANN401
    """Declare an option for numbers from `low` to `high`, which are `allowed` in errors."""

    def check(parameter: typer.CallbackParam, text: str | None) -> str | None:
        for part in () if text is None else text.split(","):
            value = parse_number(part.strip())
            if value is None or not low <= value <= high:
                raise InputError(f"{parameter.opts[0]} {text}: write {allowed}")
        return text

    return value_option(metavar, help, check=check)


def split_list(text: str) -> list[float]:
    """Return the numbers of a `list_option` in their order, each text once."""
    return [float(part.strip()) for part in dict.fromkeys(text.split(","))]


def read_time(option: str, text: str) -> float:
    """Return a time above 0, s, from the text of an option: 120, 120s, 2m or 1.5h.

    Raises:
        InputError: it is none.
    """
    number = parse_number(text.strip())
    value = parse_quantity(text.strip(), TIME_UNITS) if number is None else number
    shown = text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"
    if value is None:
        raise InputError(f"{option} {shown}: write a time such as 120, 120s, 2m or 1.5h")
    if value < SMALLEST:
        bound = "above 0" if value <= 0 else f"of at least {SMALLEST:g} s"
        raise InputError(f"{option} {shown}: write a time {bound}")
    return value


def output_option(
    *names: str, metavar: str = "FILE", help: str, suffixes: tuple[str, ...] = ()
) -> Any:  # noqa: ANN401 - typer's own
    """Declare an option for an output file; its path is checked before any work.

    Args:
        names: of the option; default: the name of the parameter.
        metavar: name of the value in the help text.
        help: of the option.
        suffixes: of which the path must have one; default: any.
    """

    def check(parameter: typer.CallbackParam, path: Path | None) -> Path | None:
        check_output_path(parameter, path)
        if path and suffixes and path.suffix.lower() not in suffixes:
            raise InputError(
                f"{parameter.opts[0]} {path}: write a name that ends in {', '.join(suffixes)}"
            )
        return path

    return value_option(metavar, help, *names, check=check)


def figure_option(help: str, *, metavar: str = "FILE") -> Any:  # noqa: ANN401 - typer's own
    """Declare an option for the file of a figure."""
    return output_option(metavar=metavar, help=help, suffixes=FIGURE_FILES)


ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Name of a scenario (`testbed list`) or a path.",
        autocompletion=scenario_names,
    ),
]
RunName = Annotated[
    str,
    typer.Argument(
        metavar="RUN",
        help="A run directory, a .mcap file, or a scenario's name for its latest run.",
        autocompletion=run_names,
    ),
]
AircraftName = Annotated[
    str,
    typer.Argument(
        metavar="AIRCRAFT",
        help="Name of an aircraft (`testbed list`) or its folder.",
        autocompletion=aircraft_names,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the scenario, e.g. network.delay_s=0.1 or "
        "'fleet.*.sensors=gps-ins'; may be repeated.",
        autocompletion=scenario_keys,
    ),
]
Seed = Annotated[int | None, value_option("N", "Seed of every random stream.")]
Jobs = Annotated[
    int | None, positive_option("N", "Flights at the same time.  \\[default: one per processor]")
]
JsonFile = Annotated[
    Path | None,
    output_option("--json", help="Write the results as JSON to this file; - or no name is stdout."),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no table.")]
RrdFile = Annotated[
    Path | None, output_option(help="Save a Rerun recording instead of opening a viewer.")
]


def _followed_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the aircraft of the scenario or run before --follow that begin like this."""
    from testbed.logs.run_directory import SCENARIO_NAME, find_run
    from testbed.scenario import load_scenario as load

    names: tuple[str, ...] = ()
    with suppress(InputError, OSError):
        first = ctx.params.get("scenario") or ctx.params.get("run") or next(iter(ctx.args), "")
        if first and "run" in ctx.params:
            names = load(find_run(first).with_name(SCENARIO_NAME)).aircraft_names
        elif first:
            names = load(first).aircraft_names
    return _beginning(incomplete, names)


Follow = Annotated[
    str | None,
    typer.Option(
        metavar="AIRCRAFT",
        help="Keep the first camera near this aircraft; arrows point at those out of sight.  "
        "\\[default: all aircraft in sight]",
        autocompletion=_followed_names,
    ),
]
Host = Annotated[
    str,
    value_option(
        "ADDRESS",
        "Address on which a web viewer listens: 127.0.0.1, or 0.0.0.0 for other machines.",
    ),
]
ParamFile = Annotated[
    str, value_option("FILE", "Autopilot parameters: a tune of the aircraft, or a .param file.")
]


def _read_start_time(parameter: typer.CallbackParam, text: str | None) -> str | None:
    """Replace `now` by the present time; a typer callback.

    Raises:
        InputError: the text is no time that a log may begin at.
    """
    from testbed.core.start_time import now, start_unix_ns

    if text == "now":
        return now()
    if text is not None:
        try:
            start_unix_ns(text)
        except ValueError as error:
            raise InputError(f"{parameter.opts[0]} {text}: {error}, or now") from None
    return text


StartTime = Annotated[
    str | None,
    value_option(
        "TIME",
        "Time of the log's first sample: now, or ISO 8601 such as 2026-05-01T09:30:00Z.  "
        "\\[default: 1970-01-01T00:00:00Z]",
        check=_read_start_time,
    ),
]


@contextmanager
def error_places(scenario: str, overrides: Sequence[str] | None) -> Iterator[None]:
    """Add file, line and column to an error that begins with a scenario's key."""
    from testbed.scenario import ScenarioError, place_of_key

    try:
        yield
    except (ScenarioError, ExternalProgramLost):  # the first has places, the second none
        raise
    except InputError as error:
        with suppress(ScenarioError):  # the file has changed since
            if place := place_of_key(str(error), scenario, overrides or ()):
                error.args = (f"{place}: {error}",)
        raise


def check_follow(follow: str | None, names: Sequence[str]) -> None:
    """Check that the aircraft of --follow exists.

    Raises:
        InputError: it does not.
    """
    if follow is not None and follow not in names:
        raise InputError(f"--follow {follow}: write one of {', '.join(names)}")


def load_scenario(name: str, overrides: Sequence[str] | None, seed: int | None = None) -> Scenario:
    """Load a scenario with the changes of --set and --seed.

    Raises:
        InputError: there is no such scenario, or it cannot be used.
    """
    import testbed.scenario

    seeds = [] if seed is None else [f"scenario.seed={seed}"]
    return testbed.scenario.load_scenario(name, (*(overrides or ()), *seeds))
