"""Frequency responses of a scenario's followers, predicted and flown by the workers of a pool."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array
from testbed.linear.flown_response import fly_response
from testbed.linear.predicted_response import (
    INPUTS,
    amplitudes,
    gains_per_hop,
)
from testbed.linear.straight_formation import linearise_straight
from testbed.linear.string_gain import HopGain, hop_gains
from testbed.pool.flight_pool import FlightPool
from testbed.pool.flight_task import COMPLETED, FlightTask
from testbed.scenario import Scenario

LOWEST_HZ, HIGHEST_HZ, POINTS = 0.01, 1.0, 81  # of predicted curves, or up to the highest flown
COMPARABLE = 1e-6  # m per unit of the input: less is no response


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of a formation.

    Args:
        input: of INPUTS.
        output: "slot-error" or "position".
        sender: row of the aircraft whose messages have the error, of MESSAGE_INPUTS.
        flown_hz: frequencies of flights.
        factor: of the amplitudes of the flights.
    """

    input: str
    output: str
    sender: int
    flown_hz: tuple[float, ...]
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class AmplitudeCurves:
    """Amplitudes of n followers at F frequencies.

    Attributes:
        frequency_hz: (F,).
        amplitude: (F, n) m per unit of the input.
        per_hop: (F, n) over the amplitude of the aircraft ahead; NaN: that is the leader.
    """

    frequency_hz: Array
    amplitude: Array
    per_hop: Array


@dataclass(frozen=True, slots=True)
class StringResponse:
    """Response of a formation, with what each follower passes on.

    Attributes:
        followers: names.
        ahead: name of the aircraft ahead of each.
        predicted: from LOWEST_HZ on.
        at_flown: predicted, at the frequencies of the flights; None: nothing is flown.
        flown: the same, measured.
        hops: along the axis of the input; None: only the leader acts.
    """

    followers: tuple[str, ...]
    ahead: tuple[str, ...]
    predicted: AmplitudeCurves
    at_flown: AmplitudeCurves | None
    flown: AmplitudeCurves | None
    hops: tuple[HopGain | None, ...]


def response_of(
    scenario: Scenario,
    question: Question,
    pool: FlightPool,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StringResponse:
    """Predict the response of a scenario's followers, and measure it at each frequency asked for.

    Args:
        scenario: whose formation flies straight, behind a virtual leader.
        question: what is asked.
        pool: whose workers predict and fly.
        progress: called with the number of parts done, and their total.

    Raises:
        InputError: the scenario cannot be flown so, or not linearised.
    """
    measures = [partial(_predict, question)]
    measures += [partial(_fly, question, frequency) for frequency in question.flown_hz]

    def tasks() -> Iterator[FlightTask]:
        for number, measure in enumerate(measures):
            yield FlightTask(number, scenario, measure=measure)

    done: dict[int, Any] = {}
    for result in pool.run(tasks()):
        if result.outcome != COMPLETED or result.metrics is None:
            raise InputError(result.error.removeprefix("invalid: "))
        done[result.number] = result.metrics["found"]
        progress(len(done), len(measures))
    ahead, found = done[0]
    response = cast(StringResponse, found)
    if not question.flown_hz:
        return response
    amplitude = np.array([done[1 + k] for k in range(len(question.flown_hz))])
    flown_hz = np.array(question.flown_hz)
    return replace(
        response, flown=AmplitudeCurves(flown_hz, amplitude, gains_per_hop(ahead, amplitude))
    )


def _predict(question: Question, scenario: Scenario) -> dict[str, Any]:
    formation = linearise_straight(scenario)
    ahead, names = formation.ahead(), (scenario.leader.name, *formation.names)

    def curves(frequency_hz: Array) -> AmplitudeCurves:
        response = formation.respond(question.input, frequency_hz, question.sender)
        amplitude = amplitudes(response, question.input, question.output)
        return AmplitudeCurves(frequency_hz, amplitude, gains_per_hop(ahead, amplitude))

    found = StringResponse(
        formation.names,
        tuple(names[row] for row in ahead),
        curves(np.geomspace(LOWEST_HZ, max(HIGHEST_HZ, *question.flown_hz, 0.0), POINTS)),
        curves(np.array(question.flown_hz)) if question.flown_hz else None,
        None,
        hop_gains(formation, INPUTS[question.input]),
    )
    return {"found": (ahead, found)}


def _fly(question: Question, frequency_hz: float, scenario: Scenario) -> dict[str, Any]:
    flown = fly_response(scenario, question.input, frequency_hz, question.sender, question.factor)
    return {"found": amplitudes(flown.response, question.input, question.output)[0]}


def largest_differences(response: StringResponse) -> list[tuple[float, float]]:
    """Return for each follower the largest differences of amplitude and gain per hop, relative.

    Flown over predicted, minus 1; NaN: there is nothing to compare.
    """
    assert response.at_flown is not None and response.flown is not None
    out = []
    for i in range(len(response.followers)):
        flown, found = response.flown, response.at_flown
        amplitude = _largest_difference(flown.amplitude[:, i], found.amplitude[:, i])
        out.append((amplitude, _largest_difference(flown.per_hop[:, i], found.per_hop[:, i])))
    return out


def _largest_difference(flown: Array, predicted: Array) -> float:
    known = np.isfinite(flown) & np.isfinite(predicted) & (predicted > COMPARABLE)
    if not known.any():
        return math.nan
    differences = flown[known] / predicted[known] - 1.0
    return float(differences[np.abs(differences).argmax()])


def to_document(scenario: Scenario, question: Question, response: StringResponse) -> dict[str, Any]:
    """Return a response as plain data for JSON; what does not exist is null."""
    curves = {
        "predicted": response.predicted,
        "predicted_at_flown": response.at_flown,
        "flown": response.flown,
    }
    return {
        "schema": 1,
        "scenario": scenario.name,
        "input": question.input,
        "output": question.output,
        **{
            name: {
                "frequency_hz": each.frequency_hz.tolist(),
                "followers": {
                    follower: {
                        "ahead": response.ahead[i],
                        "amplitude": _plain(each.amplitude[:, i]),
                        "per_hop": _plain(each.per_hop[:, i]),
                    }
                    for i, follower in enumerate(response.followers)
                },
            }
            for name, each in curves.items()
            if each is not None
        },
        "passed_on": {
            follower: None if hop is None else hop._asdict()
            for follower, hop in zip(response.followers, response.hops, strict=True)
        },
    }


def _plain(values: Array) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]
