"""Columns of the row of numbers that is the state of a compiled aircraft.

The first `FRAME_COLUMNS` are the same for all aircraft. They are followed by the memories of the
integrators and by the properties of the aircraft's own files.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class RowQuantity(NamedTuple):
    """Consecutive columns that are one variable of the step."""

    name: str  # of the variable
    columns: tuple[str, ...]  # JSBSim's properties, or names of our own
    is_output: bool  # written by each step, and not read by it


def _quantity(name: str, pattern: str, parts: str = "", *, is_output: bool = False) -> RowQuantity:
    columns = tuple(pattern.format(each) for each in parts.split()) if parts else (pattern,)
    return RowQuantity(name, columns, is_output)


# of the frame: integrated or carried to the next step
MOTION: Final = (
    _quantity("position", "position/eci-{}-ft", "x y z"),
    _quantity("velocity", "velocities/eci-{}-fps", "x y z"),
    _quantity("attitude", "attitude/eci-quaternion-{}", "0 1 2 3"),
    _quantity("rates", "velocities/{}i-rad_sec", "p q r"),
    _quantity("earth_angle", "position/epa-rad"),
    _quantity("acceleration", "accelerations/{}idot-ft_sec2", "u v w"),
    _quantity("rates_dot", "accelerations/{}idot-rad_sec2", "p q r"),
    _quantity("uvw_dot", "accelerations/{}dot-ft_sec2", "u v w"),
)
# of a step, for the properties that the testbed reads
OUTPUTS: Final = (
    _quantity("alpha", "aero/alpha-rad", is_output=True),
    _quantity("beta", "aero/beta-rad", is_output=True),
    _quantity("vt", "velocities/vt-fps", is_output=True),
    _quantity("qbar", "aero/qbar-psf", is_output=True),
)
# constant from one call to the next
CONTROLS: Final = _quantity("controls", "fcs/{}-cmd-norm", "aileron elevator rudder throttle")
WIND: Final = _quantity("wind", "atmosphere/wind-{}-fps", "north east down")
CONSTANTS: Final = (
    _quantity("delta_t", "atmosphere/delta-T"),
    _quantity("mass", "inertia/mass-slugs"),
    _quantity("inertia", "inertia/i{}-slugs_ft2", "xx yy zz xy xz yz"),
    _quantity("cg", "inertia/cg-{}-in", "x y z"),
    _quantity("terrain", "terrain-elevation-ft"),  # as set; JSBSim's own property is rounded
)
FRAME: Final = (*MOTION, *OUTPUTS, CONTROLS, WIND, *CONSTANTS)
AIR_INPUTS: Final = tuple(f"air/{each}" for each in ("p-rad_sec", "q-rad_sec", "r-rad_sec")) + (
    "air/roll-coefficient",
)
_NAMES = [column for quantity in FRAME for column in quantity.columns]
COLUMN: Final = {name: index for index, name in enumerate(_NAMES)}
FRAME_COLUMNS: Final = len(_NAMES)
START: Final = {quantity.name: COLUMN[quantity.columns[0]] for quantity in FRAME}
