"""Write what was fitted to a recording as an aircraft folder."""

from __future__ import annotations

from pathlib import Path

from testbed.autopilot.parameters import AutopilotTiming
from testbed.commissioning.airframe_fit import LATENCY, AirframeFit, FittedParameter
from testbed.commissioning.airframe_variant import FACTORS, copy_with_factors
from testbed.core.files import new_folder, write_text_file
from testbed.core.input_files import read_bounded_text

SOURCE = "SOURCE.md"
DEFAULT_LATENCY_S = AutopilotTiming().command_latency


def write_fitted_aircraft(folder: Path, fit: AirframeFit, path: Path, recording: str) -> None:
    """Copy an aircraft with the fitted factors, and say in its SOURCE.md what was fitted.

    Args:
        folder: of the aircraft that was fitted.
        fit: of its parameters.
        path: the new folder.
        recording: name of the recording's file.

    Raises:
        OSError: the folder exists or cannot be written.
    """
    with new_folder(path) as new:
        copy_with_factors(folder, new, fit.factors())
        source = new / SOURCE
        before = read_bounded_text(source).rstrip() + "\n\n" if source.is_file() else ""
        with write_text_file(source) as file:
            file.write(before + _source_text(folder.name, fit, recording))


def companion_latency(fit: AirframeFit) -> float | None:
    """Return `controller.companion.command_latency_s` of a fitted latency, s; None: none fitted.

    The virtual autopilot itself has the default latency.
    """
    found = [each.value for each in fit.parameters if each.name == LATENCY]
    return max(0.0, found[0] - DEFAULT_LATENCY_S) if found else None


def _source_text(name: str, fit: AirframeFit, recording: str) -> str:
    rows = "\n".join(_row(each) for each in fit.parameters)
    text = (
        f"## Fitted to a recording\n\n`testbed respond {name} {recording} --fit` has fitted these; "
        "all else is as in the aircraft it began with.\n\n"
        f"| fitted | value | 95 % interval | what it is |\n|---|--:|--:|---|\n{rows}\n\n"
        "Intervals allow for differences that are correlated in time and between columns. Factors "
        "are properties `fit/…-factor` of the aircraft's file; that of the mass is in its empty "
        "weight.\n"
    )
    latency = companion_latency(fit)
    if latency is not None:
        text += (
            "\nThe latency is no part of an aircraft. For followers write "
            f"`controller: {{companion: {{command_latency_s: {latency:.3g}}}}}` in the scenario: "
            f"what is fitted, less the {DEFAULT_LATENCY_S:g} s of the virtual autopilot.\n"
        )
    return text


def _row(each: FittedParameter) -> str:
    meaning = f"factor {FACTORS[each.name]}" if each.name in FACTORS else "of the commands, s"
    return f"| {each.name} | {each.value:.4g} | {each.low:.4g} to {each.high:.4g} | {meaning} |"
