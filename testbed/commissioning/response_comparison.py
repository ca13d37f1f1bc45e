"""Compare the response of a model with the recorded one, and say what the difference points to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.commissioning.command_files import RESPONSES, Commands
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, BoolArray

_DEGREES = 180.0 / np.pi
# Column: name, unit and units per unit of the column; in the order of the table.
_QUANTITIES = {
    "phi_rad": ("roll", "°", _DEGREES),
    "theta_rad": ("pitch", "°", _DEGREES),
    "psi_rad": ("heading", "°", _DEGREES),
    "p_radps": ("roll rate", "°/s", _DEGREES),
    "q_radps": ("pitch rate", "°/s", _DEGREES),
    "r_radps": ("yaw rate", "°/s", _DEGREES),
    "airspeed_mps": ("airspeed", "m/s", 1.0),
    "altitude_m": ("altitude", "m", 1.0),
    "v_down_mps": ("climb rate", "m/s", -1.0),
    "alpha_rad": ("angle of attack", "°", _DEGREES),
    "beta_rad": ("sideslip", "°", _DEGREES),
    "pwm_ail": ("aileron", "µs", 1.0),
    "pwm_ele": ("elevator", "µs", 1.0),
    "pwm_rud": ("rudder", "µs", 1.0),
    "pwm_thr": ("throttle", "µs", 1.0),
}
_ENERGY = "energy height", "m"  # altitude + V²/2g

MOST_SHIFT_S, SHIFT_STEP_S = 0.5, 0.01  # of the search for a latency
# What a difference must exceed to be named.
LATENCY_S, LATENCY_SHARE = 0.015, 0.8  # and the RMS that is left, as a share
AIRSPEED_MPS, CLIMB_MPS, ALPHA_DEG, TRIM_US = 0.5, 0.2, 0.5, 10.0  # mean differences
MAX_HOLD_S = 0.1  # commands that are held for longer move the model's means
GUSTY_MPS = 0.3  # standard deviation of the estimated wind, from which on it moves them, too
BLOCK_S, MIN_BLOCKS = 10.0, 4  # of means that differ from block to block
POWER_SHARE, POWER_CORRELATION = 0.05, 0.9
MIN_ROLL_DEG, MIN_PULSE_US = 2.0, 5.0  # standard deviations: less motion shows nothing


@dataclass(frozen=True, slots=True)
class ComparedQuantity:
    """One quantity of the recording and of the model, at the rows that are compared.

    Attributes:
        name: in words.
        unit: of all numbers.
        recorded: (K,)
        model: (K,)
        difference: (K,) model minus recording; of a heading between −180° and 180°.
    """

    name: str
    unit: str
    recorded: Array
    model: Array
    difference: Array

    @property
    def rms(self) -> float:
        """RMS difference."""
        return float(np.sqrt(np.mean(self.difference**2)))

    @property
    def mean(self) -> float:
        """Mean difference."""
        return float(self.difference.mean())

    @property
    def largest_row(self) -> int:
        """Row of the difference with the largest magnitude."""
        return int(np.abs(self.difference).argmax())


@dataclass(frozen=True, slots=True)
class ResponseComparison:
    """What differs between a recording and the model.

    Attributes:
        time_s: (K,) of the rows that are compared.
        quantities: those that the recording has, by name.
        findings: what the differences point to, a sentence each.
    """

    time_s: Array
    quantities: Mapping[str, ComparedQuantity]
    findings: tuple[str, ...]


def compare_response(
    commands: Commands, response: Array, skip_s: float = 2.0
) -> ResponseComparison:
    """Compare the recorded columns of a recording with the response of the model.

    Args:
        commands: K rows, with what was recorded.
        response: (K, 15) of the model; rows of NaN are not compared.
        skip_s: of the recording that is left out at its start, s.
    """
    kept = (commands.time_s >= commands.time_s[0] + skip_s) & np.isfinite(response[:, 0])
    time = commands.time_s[kept]
    columns = {
        name: (recorded[kept], response[kept, RESPONSES.index(name)])
        for name, recorded in commands.recorded.items()
    }
    quantities = {}
    for column, (name, unit, factor) in _QUANTITIES.items():
        if column in columns and len(time):
            recorded, model = (factor * each for each in columns[column])
            difference = model - recorded
            if column == "psi_rad":
                difference = (difference + 180.0) % 360.0 - 180.0
            quantities[name] = ComparedQuantity(name, unit, recorded, model, difference)
    if {"airspeed", "altitude"} <= quantities.keys():
        energy = [
            getattr(quantities["altitude"], each)
            + getattr(quantities["airspeed"], each) ** 2 / (2.0 * GRAVITY)
            for each in ("recorded", "model")
        ]
        quantities[_ENERGY[0]] = ComparedQuantity(
            *_ENERGY, energy[0], energy[1], energy[1] - energy[0]
        )
    held = _periods(commands.rates_hz)
    gusts = _gusts(commands, kept)
    others = _other_causes(held, gusts)
    findings = (*_latency(time, quantities, held), *_findings(time, quantities, others, gusts))
    return ResponseComparison(time, quantities, findings)


def _periods(rates_hz: Mapping[str, float]) -> dict[str, float]:
    """Return the time between two messages of each column, s."""
    return {name: 1.0 / rate for name, rate in rates_hz.items()}


def _gusts(commands: Commands, kept: BoolArray) -> float:
    """Return the standard deviation of the estimated wind along an axis, m/s; 0: not known."""
    if commands.wind_mps is None or not kept.any():
        return 0.0
    north, east = commands.wind_mps[kept].std(axis=0)
    gusts = float(np.hypot(north, east) / np.sqrt(2.0))
    return gusts if gusts > GUSTY_MPS else 0.0


def _other_causes(held: Mapping[str, float], gusts: float) -> tuple[str, ...]:
    """Return what moves the means of a replay beside the aircraft: slow commands, and gusts."""
    found = []
    slowest = max(("theta_cmd_rad", "throttle_cmd"), key=lambda name: held.get(name, 0.0))
    if held.get(slowest, 0.0) > MAX_HOLD_S:
        found.append(f"{slowest} came {1.0 / held[slowest]:.3g} times a second")
    if gusts:
        found.append(f"the wind varied by {gusts:.2g} m/s, and the model flies in still air")
    return tuple(found)


def _findings(
    time: Array, quantities: Mapping[str, ComparedQuantity], others: Sequence[str], gusts: float
) -> Iterator[str]:
    """Yield what the differences point to, by the rules of docs/autopilot.md.

    Args:
        time: (K,) s.
        quantities: by name.
        others: causes beside the aircraft; with any, means that differ from block to block may be
            theirs.
        gusts: standard deviation of the wind, m/s.
    """
    for name in ("aileron", "elevator"):
        if pulses := quantities.get(name):
            yield from _control_power(pulses, quantities.get("airspeed"))
    unsteady = []
    for name, (bound, sentence) in _MEANS.items():
        each = quantities.get(name)
        if each is None or abs(each.mean) <= bound:
            continue
        least = gusts if each.unit == "m/s" else 0.0
        if others and not _is_steady(time, each.difference, least):
            unsteady.append(f"{name} {each.mean:+.2g} {each.unit}")
        else:
            yield f"trim: the model{sentence(each.mean)}"
    if unsteady:
        yield (
            f"trim: mean differences of {', '.join(unsteady)} may have other causes than the "
            f"aircraft: {'; '.join(others)}"
        )


def _faster(mean: float) -> str:
    word = "faster" if mean > 0.0 else "slower"
    return (
        f" is {abs(mean):.2f} m/s {word} on average with the same throttle and pitch commands: "
        "drag, thrust, the airspeed sensor, or the pitch trim of the tune"
    )


def _climbs(mean: float) -> str:
    word = "climbs more" if mean > 0.0 else "climbs less"
    return (
        f" {word}, by {abs(mean):.2f} m/s on average: mass, drag, thrust, or the pitch trim of the "
        "tune"
    )


# By quantity: the mean difference from which on it is named, and what follows "the model".
_MEANS: Mapping[str, tuple[float, Callable[[float], str]]] = {
    "airspeed": (AIRSPEED_MPS, _faster),
    "climb rate": (CLIMB_MPS, _climbs),
    "angle of attack": (
        ALPHA_DEG,
        lambda mean: (
            f"'s angle of attack differs by {mean:+.2f}° on average: mass, lift, or the vane's "
            "mounting"
        ),
    ),
    "elevator": (
        TRIM_US,
        lambda mean: (
            f"'s elevator differs by {mean:+.0f} µs on average: centre of gravity, pitching "
            "moment, or the servo's neutral pulse"
        ),
    ),
}


def _is_steady(time: Array, difference: Array, gusts: float) -> bool:
    """Return whether a mean (K,) is beyond twice its standard error, by means of blocks.

    Slow gusts add to the error as a process with a correlation time of a block: the vertical wind,
    which no log has, is like the horizontal one.
    """
    blocks = np.floor((time - time[0]) / BLOCK_S).astype(int)
    means = [difference[blocks == k].mean() for k in range(blocks[-1]) if (blocks == k).any()]
    if len(means) < MIN_BLOCKS:
        return False
    scatter = max(float(np.std(means, ddof=1)), np.sqrt(2.0) * gusts)
    return bool(abs(float(difference.mean())) > 2.0 * scatter / np.sqrt(len(means)))


def _latency(
    time: Array, quantities: Mapping[str, ComparedQuantity], held: Mapping[str, float]
) -> Iterator[str]:
    """Find the shift of the model's aileron that leaves the least difference, or of its roll.

    The aileron answers to a command at once; the roll is later also where the aileron is weaker. A
    shift that is not longer than the roll command or the recorded quantity was held is theirs.
    """
    least = {"aileron": MIN_PULSE_US, "roll": MIN_ROLL_DEG}
    moved = (quantities[name] for name in least if name in quantities)
    each = next((one for one in moved if one.recorded.std() > least[one.name]), None)
    if each is None or time[-1] - time[0] < 4.0 * MOST_SHIFT_S:
        return
    shift = best_shift(time, each.recorded, each.model)
    before, left = (_rms_of_shift(time, each.recorded, each.model, by) for by in (0.0, shift))
    if abs(shift) <= LATENCY_S or left >= LATENCY_SHARE * before:
        return
    column = {"aileron": "pwm_ail", "roll": "phi_rad"}[each.name]
    slowest = max(("phi_cmd_rad", column), key=lambda name: held.get(name, 0.0))
    if abs(shift) <= held.get(slowest, 0.0):
        yield (
            f"latency: cannot be found, as {slowest} came {1.0 / held[slowest]:.3g} times a second "
            f"and its steps may be {1e3 * held[slowest]:.0f} ms late (have it logged more often)"
        )
    else:
        word = "behind" if shift > 0.0 else "ahead of"
        yield (
            f"latency: the recorded {each.name} is {1e3 * abs(shift):.0f} ms {word} the model's; "
            f"with that shift {left:.2g} {each.unit} RMS of {before:.2g} are left"
        )


def best_shift(time: Array, recorded: Array, model: Array) -> float:
    """Return by how much later, s, the model must be for the least squared difference.

    Args:
        time: (K,) s.
        recorded: (K,)
        model: (K,)
    """
    count = round(MOST_SHIFT_S / SHIFT_STEP_S)
    shifts = SHIFT_STEP_S * np.arange(-count, count + 1)
    errors = [_rms_of_shift(time, recorded, model, each) for each in shifts.tolist()]
    return float(shifts[int(np.argmin(errors))])


def _rms_of_shift(time: Array, recorded: Array, model: Array, shift: float) -> float:
    """Return the RMS difference about its mean, with the model later by a shift, s."""
    inner = (time > time[0] + MOST_SHIFT_S) & (time < time[-1] - MOST_SHIFT_S)
    difference = np.interp(time[inner] - shift, time, model) - recorded[inner]
    return float(difference.std())


def _control_power(pulses: ComparedQuantity, airspeed: ComparedQuantity | None) -> Iterator[str]:
    """Compare how far a control is moved for nearly the same motion, times dynamic pressure."""
    recorded, model = pulses.recorded, pulses.model
    recorded, model = (each - each.mean() for each in (recorded, model))
    if min(recorded.std(), model.std()) < MIN_PULSE_US:
        return
    if airspeed is not None:
        typical = float(np.mean(airspeed.model**2))
        recorded = recorded * airspeed.recorded**2 / typical
        model = model * airspeed.model**2 / typical
    correlation = float(np.corrcoef(recorded, model)[0, 1])
    ratio = float(recorded.std() / model.std())
    if abs(ratio - 1.0) > POWER_SHARE and correlation > POWER_CORRELATION:
        word, name = "weaker" if ratio > 1.0 else "stronger", pulses.name
        yield (
            f"airframe: the recorded {name} moves {ratio:.2f} times as far as the model's, at the "
            f"same dynamic pressure: a {word} {name}, or another servo travel"
        )
