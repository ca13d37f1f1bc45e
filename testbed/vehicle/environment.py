"""Planet, gravity, atmosphere, wind and integrators of a JSBSim instance."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

_EARTH = Path(__file__).with_name("earth.xml")
_WGS84_GRAVITY = 1  # with J2; 0: of a sphere
_NO_TURBULENCE = 0

EULER = 1
ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_3, ADAMS_BASHFORTH_4 = 3, 4, 5  # of second to fourth order


class Integrators(NamedTuple):
    """JSBSim's methods of integration by state, and when controls act with them."""

    rate_rotational: int  # body rates
    rate_translational: int  # velocity
    position_rotational: int  # attitude
    position_translational: int  # position
    control_lead: float  # share of a change added in the first step, see `jsbsim_io.lead_controls`


INTEGRATORS = Integrators(
    ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_2, ADAMS_BASHFORTH_3, 0.5
)
# Recordings of ArduPlane on JSBSim were flown with them; controls acted one step late.
JSBSIM_DEFAULT_INTEGRATORS = Integrators(EULER, ADAMS_BASHFORTH_2, EULER, ADAMS_BASHFORTH_3, 0.0)
_STATES = ("rate/rotational", "rate/translational", "position/rotational", "position/translational")
_METHODS = {
    EULER: "Euler",
    ADAMS_BASHFORTH_2: "Adams-Bashforth 2",
    ADAMS_BASHFORTH_3: "Adams-Bashforth 3",
    ADAMS_BASHFORTH_4: "Adams-Bashforth 4",
}


def describe_integrators(integrators: Integrators = INTEGRATORS) -> dict[str, str]:
    """Return the fields of `Integrators` as text for a log, with the names of the methods."""
    return {
        name: f"{value:g}" if name == "control_lead" else _METHODS[int(value)]
        for name, value in integrators._asdict().items()
    }


def load_planet(fdm: Any) -> None:  # noqa: ANN401
    """Load the planet: the Earth, WGS 84 with J2.

    It resets all models of JSBSim, so it comes before the aircraft: of a loaded one, the limits of
    the stall's hysteresis would be lost. It comes again after an aircraft with a planet of its own.

    Args:
        fdm: JSBSim's FGFDMExec.
    """
    fdm.load_planet(str(_EARTH), False)


def set_environment(fdm: Any, integrators: Integrators = INTEGRATORS) -> None:  # noqa: ANN401
    """Set gravity, atmosphere, wind and integrators.

    JSBSim's atmosphere is the US standard atmosphere of 1976. Its own turbulence is off: wind is
    what is written to atmosphere/wind-north-fps, -east-fps and -down-fps.

    Args:
        fdm: JSBSim's FGFDMExec with the planet, and a model after it.
        integrators: of body rates, velocity, attitude and position.
    """
    fdm["simulation/gravity-model"] = _WGS84_GRAVITY
    fdm["atmosphere/turb-type"] = _NO_TURBULENCE
    for state, method in zip(_STATES, integrators, strict=False):
        fdm[f"simulation/integrator/{state}"] = method
