"""The conditions whose largest values are found: their levels, and the settings of a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from testbed.assessment.search import geometric_levels
from testbed.core.random import named_stream
from testbed.scenario import Scenario
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.network import Bernoulli
from testbed.scenario.sensors import PRESETS, Sensors

PRESET = "pixhawk"  # of sensors that the scenario does not model
TURBULENCE = "coherent"  # where the scenario has none
_KNOTS = 0.514444
_INTENSITY_MPS = {"light": 15 * _KNOTS, "moderate": 30 * _KNOTS, "severe": 45 * _KNOTS}
_SPEED_KEYS = ("noise_pa", "offset_sigma_pa", "scale_sigma")
_POSITION_KEYS = ("noise_m", "velocity_noise_mps", "shared_drift_m", "own_drift_m")


@dataclass(frozen=True, slots=True)
class VariedCondition:
    """A condition of which the largest value is found.

    Attributes:
        title: for people.
        unit: of its values.
        low: smallest value above that of the scenario, where this is smaller.
        high: largest that is tried.
        own: value of the scenario itself.
        settings: of a flight with a value above it: of scenario, value and seed.
        flown_with: what of the flights is not the scenario's; "": nothing else.
        nominal: settings of flights at `own`.
        is_drawn: the settings of each seed have something of their own.
    """

    title: str
    unit: str
    low: float
    high: float
    own: Callable[[Scenario], float]
    settings: Callable[[Scenario, float, int], list[str]]
    flown_with: Callable[[Scenario], str] = lambda scenario: ""
    nominal: Callable[[Scenario], list[str]] = lambda scenario: []
    is_drawn: bool = False

    def levels(self, scenario: Scenario) -> list[float]:
        """Return the values that are tried: that of the scenario, and larger ones."""
        own, *higher = geometric_levels(self.own(scenario), self.low, self.high)
        return [own, *(each for each in higher if each > own * 1.0001)]

    def flight(self, scenario: Scenario, value: float, seed: int) -> list[str]:
        """Return the settings of a flight at one of the levels."""
        if value == self.own(scenario):
            return self.nominal(scenario)
        return self.settings(scenario, value, seed)


def _of_links(scenario: Scenario, key: str, value: float) -> list[str]:
    """Return settings of a key of the network, also where some links have their own."""
    links = scenario.network.links.values()
    own = any(getattr(link, key) is not None for to in links for link in to.values())
    text = f"{value:.4g}"
    return [f"network.{key}={text}", *([f"network.links.*.*.{key}={text}"] if own else [])]


def _loss(scenario: Scenario) -> float:
    loss = scenario.network.loss
    return loss.probability if isinstance(loss, Bernoulli) else 0.0


def _bursts(scenario: Scenario) -> bool:
    loss = scenario.network.loss
    return loss is not None and not isinstance(loss, Bernoulli)


def _wind(scenario: Scenario, value: float, seed: int) -> list[str]:
    return [*_no_record(scenario), f"air.wind.speed_mps={value:.4g}", f"air.wind.{_from(seed)}"]


def _calm(scenario: Scenario) -> list[str]:
    return [*_no_record(scenario), "air.wind.speed_mps=0"]


def _no_record(scenario: Scenario) -> list[str]:
    return ["air.wind.file=null"] if scenario.air.wind.file else []


def _from(seed: int) -> str:
    return f"from_deg={named_stream(seed, 'assess/wind').uniform(0.0, 360.0):.0f}"


def _turbulence(scenario: Scenario, value: float, seed: int) -> list[str]:
    own = scenario.air.turbulence
    model = [f"air.turbulence.model={TURBULENCE}"] if own.model == "none" else []
    removed = [] if own.sigma_mps is None else ["air.turbulence.sigma_mps=null"]
    return [*model, *removed, f"air.turbulence.w20_mps={value:.4g}"]


def _own_turbulence(scenario: Scenario) -> float:
    own = scenario.air.turbulence
    if own.model == "none":
        return 0.0
    return round(_INTENSITY_MPS[own.intensity] if own.w20_mps is None else own.w20_mps, 4)


def _sensor_places(scenario: Scenario) -> Iterator[tuple[str, Sensors]]:
    """Yield the sensors of all aircraft by their keys, equal ones of the fleet as one."""
    yield "leader.sensors", scenario.leader.sensors
    fleet: tuple[AircraftSection, ...] = scenario.fleet
    if len({each.sensors.model_dump_json() for each in fleet}) == 1:
        yield "fleet.*.sensors", fleet[0].sensors
    else:
        yield from ((f"fleet.{k}.sensors", each.sensors) for k, each in enumerate(fleet))


def _scaled(values: Mapping[str, Any], keys: tuple[str, ...], factor: float) -> dict[str, Any]:
    return {key: _times(values[key], factor) for key in keys}


def _times(value: Any, factor: float) -> Any:  # noqa: ANN401 - a number or some
    if isinstance(value, list | tuple):
        return [_times(each, factor) for each in value]
    return float(f"{factor * value:.6g}")


def _flow(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}: {value}" for key, value in values.items())


def sensor_settings(scenario: Scenario) -> list[str]:
    """Return the settings that give sensors with errors to aircraft without."""
    return [f"{at}={PRESET}" for at, own in _sensor_places(scenario) if own.exact]


def _gps(scenario: Scenario, factor: float, seed: int) -> list[str]:
    found = []
    for at, own in _sensor_places(scenario):
        if own.exact:
            scaled = _scaled(PRESETS[PRESET]["gps"], _POSITION_KEYS, factor)
            found.append(f"{at}={{preset: {PRESET}, gps: {{{_flow(scaled)}}}}}")
        elif own.gps:
            scaled = _scaled(own.gps.model_dump(), _POSITION_KEYS, factor)
            found += [f"{at}.gps.{key}={value}" for key, value in scaled.items()]
        else:
            found += [
                f"{at}.position.sigma_m={_times(own.position.sigma_m, factor)}",
                f"{at}.velocity.sigma_mps={_times(own.velocity.sigma_mps, factor)}",
            ]
    return found


def _airspeed(scenario: Scenario, factor: float, seed: int) -> list[str]:
    found = []
    for at, own in _sensor_places(scenario):
        values = own.airspeed.model_dump() if own.airspeed else PRESETS[PRESET]["airspeed"]
        scaled = _scaled(values, _SPEED_KEYS, factor)
        if own.airspeed:
            found += [f"{at}.airspeed.{key}={value}" for key, value in scaled.items()]
        elif own.exact:
            found.append(f"{at}={{airspeed: {{{_flow(scaled)}}}}}")
        else:
            found.append(f"{at}.airspeed={{{_flow(scaled)}}}")
    return found


def _gps_of(scenario: Scenario) -> str:
    exact = [own.exact for _, own in _sensor_places(scenario)]
    if not any(exact):
        return ""
    of = "all aircraft" if all(exact) else "the aircraft whose sensors are exact"
    return f"sensors: {PRESET} on {of}, as the scenario has no errors there"


def _airspeed_of(scenario: Scenario) -> str:
    if all(own.airspeed for _, own in _sensor_places(scenario)):
        return ""
    return f"airspeed sensors of {PRESET}, as the scenario has exact ones"


CONDITIONS: Mapping[str, VariedCondition] = {
    "loss": VariedCondition(
        "lost messages",
        "share",
        0.01,
        0.99,
        _loss,
        lambda scenario, value, seed: _of_links(scenario, "loss", value),
        lambda s: "independent losses in place of the scenario's" if _bursts(s) else "",
        lambda s: _of_links(s, "loss", 0.0) if _bursts(s) else [],
    ),
    "delay": VariedCondition(
        "delay of messages",
        "s",
        0.005,
        2.0,
        lambda scenario: scenario.network.delay_s or 0.0,
        lambda scenario, value, seed: _of_links(scenario, "delay_s", value),
    ),
    "wind": VariedCondition(
        "wind",
        "m/s",
        0.5,
        40.0,
        lambda scenario: 0.0,
        _wind,
        lambda scenario: "each seed with a direction of its own",
        _calm,
        is_drawn=True,
    ),
    "turbulence": VariedCondition(
        "turbulence: wind at 20 ft",
        "m/s",
        0.5,
        40.0,
        _own_turbulence,
        _turbulence,
        lambda s: f"model {TURBULENCE}" if s.air.turbulence.model == "none" else "",
    ),
    "gps": VariedCondition(
        "errors of GPS",
        "times",
        1.05,
        20.0,
        lambda scenario: 1.0,
        _gps,
        _gps_of,
        sensor_settings,
    ),
    "airspeed": VariedCondition(
        "errors of airspeed",
        "times",
        1.05,
        20.0,
        lambda scenario: 1.0,
        _airspeed,
        _airspeed_of,
        lambda scenario: _airspeed(scenario, 1.0, 0),
    ),
}
