"""Exit codes of the command line."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """How a command ended."""

    OK = 0
    AIRCRAFT_LOST = 1
    BAD_INPUT = 2
    DIFFERENT = 3
    INTERNAL_ERROR = 4
    EXTERNAL_PROGRAM_LOST = 5
    INTERRUPTED = 130


EXIT_CODES_HELP = (
    "Exit codes: 0 success; 1 aircraft, formation or separation lost, or envelope exceeded; 2 bad "
    "input; 3 regression, a number outside the bounds of the scenario, or runs that differ; 4 "
    "internal error; 5 external program lost; 130 interrupted."
)
