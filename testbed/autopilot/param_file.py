"""Read ArduPlane's parameter files: `.param` and `.parm` of ground stations and of SITL."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from testbed.core.errors import InputError
from testbed.core.input_files import quote_word, read_bounded_text
from testbed.core.numbers import parse_number, parse_whole


class ParamError(InputError):
    """A `.param` file that cannot be read, or a parameter with an invalid value."""


# Names before version 4.5: the present name, and the factor of the value (centidegrees, cm/s).
OLD_NAMES = {
    "LIM_ROLL_CD": ("ROLL_LIMIT_DEG", 0.01),
    "LIM_PITCH_MAX": ("PTCH_LIM_MAX_DEG", 0.01),
    "LIM_PITCH_MIN": ("PTCH_LIM_MIN_DEG", 0.01),
    "TRIM_PITCH_CD": ("PTCH_TRIM_DEG", 0.01),
    "TRIM_ARSPD_CM": ("AIRSPEED_CRUISE", 0.01),
    "ARSPD_FBW_MIN": ("AIRSPEED_MIN", 1.0),
    "ARSPD_FBW_MAX": ("AIRSPEED_MAX", 1.0),
}
MAX_NAME = 16  # characters, as in ArduPlane
_AUTOPILOT = 1  # MAVLink component of an autopilot
_SEPARATORS = re.compile(r"[,= \t]+")
_COMMENT = re.compile(r"#|//")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TYPED = re.compile(r"[^,]*,[^,]*,")  # NAME,0.3,9: name, value, type
_STACK = re.compile(r"#\s*Stack:\s*(?P<stack>.*)")  # in the head of QGroundControl's files


class GivenValue(NamedTuple):
    """A value of a `.param` file."""

    value: float
    line: int
    name: str  # as the file has it


class Note(NamedTuple):
    """What of a file has no effect."""

    text: str
    name: str = ""  # the present name of the parameter with another value


class ParamFile(NamedTuple):
    """Values of a file by ArduPlane's present names, and what of the file has no effect."""

    path: Path
    values: dict[str, GivenValue]
    notes: tuple[Note, ...]


def read_param_file(path: Path) -> ParamFile:
    """Read a parameter file by ArduPlane's grammar.

    A line is a name and a number, separated by blanks, tabs, commas or `=`; the rest of the line
    is not read, but must not begin with a second number, unless commas separate all three. `#`
    and `//` start a comment. The last value of a name counts, and names of more than 16
    characters are ignored, as in ArduPlane; both are in the notes. Lines that ArduPlane would
    skip or read as zero are errors.

    Lines that begin with two numbers are QGroundControl's: vehicle, component, name, value, type.
    Parameters of other components than the autopilot are ignored, with a note.

    Names before version 4.5 are converted, with their units (`OLD_NAMES`).

    Raises:
        ParamError: the file cannot be read, is of another autopilot, or a line is invalid.
    """
    values: dict[str, GivenValue] = {}
    notes: list[Note] = []
    others: set[str] = set()
    vehicle, vehicle_line = "", 0
    for number, line in _lines(path):
        stack = _STACK.match(line)
        if stack and stack["stack"].strip().lower() not in ("", "ardupilot"):
            raise ParamError(
                f"{path}:{number}: parameters of {stack['stack'].strip()[:30]!r} (write those of "
                "ArduPlane)"
            )
        words = [word for word in _SEPARATORS.split(_COMMENT.split(line, 1)[0]) if word]
        if not words:
            continue
        ground_station = len(words) >= 5 and None not in map(parse_whole, words[:2])
        if ground_station:
            vehicle, vehicle_line = vehicle or words[0], vehicle_line or number
            if words[0] != vehicle:
                raise ParamError(
                    f"{path}:{number}: vehicle {words[0][:10]} after vehicle {vehicle[:10]} in "
                    f"line {vehicle_line} (write the parameters of one vehicle)"
                )
            if parse_whole(words[1]) != _AUTOPILOT:
                others.add(words[1])
                continue
            words = words[2:]
        value = parse_number(words[1]) if len(words) > 1 else None
        # a second number may be the decimals behind a comma, which ArduPlane would cut off
        second = len(words) > 2 and parse_number(words[2]) is not None
        ambiguous = second and not (ground_station or _TYPED.match(line))
        if value is None or not _NAME.fullmatch(words[0]) or ambiguous:
            raise ParamError(
                f"{path}:{number}: expected a name and a number, as in 'RLL_RATE_P 0.3' or "
                f"'RLL_RATE_P,0.3', found {quote_word(words[0])}"
            )
        name, factor = OLD_NAMES.get(words[0].upper(), (words[0].upper(), 1.0))
        if len(name) > MAX_NAME:
            text = f"a name has at most {MAX_NAME} characters"
            notes.append(Note(f"line {number}: {name[:40]} is ignored, as by ArduPlane: {text}"))
            continue
        given = GivenValue(factor * value, number, words[0])
        if (before := values.get(name)) and before.value != given.value:
            text = (
                f"line {number}: {words[0]} {given.value:.9g} replaces {before.name} "
                f"{before.value:.9g} of line {before.line}; ArduPlane takes the last value"
            )
            notes.append(Note(text, name))
        values[name] = given
    if others:
        some = ", ".join(sorted(others)[:3])
        text = f"parameters of MAVLink component {some} are ignored: the autopilot is 1"
        notes.append(Note(text))
    return ParamFile(path, values, tuple(notes))


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines, from 1; a line ends with LF, CR or both."""
    text = read_bounded_text(path, error=ParamError)
    yield from enumerate(re.split(r"\r\n|\n|\r", text), start=1)
