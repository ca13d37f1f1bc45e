"""Samples of an artificial flight: a formation on a rectangle with round corners."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from testbed.core.frames import GRAVITY
from testbed.core.records import (
    ActuatorCommand,
    AirData,
    Array,
    Event,
    FbwaCommand,
    FormationState,
    LinkCounters,
    NedOrigin,
    RunInfo,
    Sample,
    VehicleState,
)
from testbed.scenario import Scenario, load_scenario

SPEED = 22.0  # m/s
SIDE, CORNER = 660.0, 110.0  # m, of the rectangle and of its corners' arcs


def vee(followers: int) -> Array:
    """Offsets (n, 3) forward, right, down of a vee with the leader at its point."""
    k = np.arange(followers)
    row, side = k // 2 + 1, np.where(k % 2, -1.0, 1.0)
    return np.stack([-5.0 * row, 5.0 * row * side, np.where(k % 2, 1.0, -1.0) * (k > 0)], axis=-1)


def vee_page(followers: int) -> Scenario:
    """Make a vee behind Simulation 3's leader; each follower listens to the one before it."""
    names = [f"uav{k + 1}" for k in range(followers)]
    offsets = dict(zip(names, vee(followers).tolist(), strict=True))
    page = load_scenario("simulation-3").model_dump(mode="json", exclude_unset=True)
    page["scenario"] = {"schema": 2, "name": "vee", "duration_s": 1080.0}
    page["fleet"] = [
        {"name": name, "aircraft": "rascal110", "start_m": [ahead - 3.0, right, down]}
        for name, (ahead, right, down) in offsets.items()
    ]
    page["formation"] |= {
        "offsets_m": offsets,
        "leader_gains": dict.fromkeys(names, 1.0),
        "neighbour_gains": {names[k]: {names[k - 2]: 1.0} for k in range(2, followers)},
    }
    return Scenario.model_validate(page)


def info(aircraft: int, duration_s: float) -> RunInfo:
    """Describe the flight."""
    corners = [[SIDE, 0, -100], [SIDE, SIDE, -100], [0, SIDE, -100], [0, 0, -100], [SIDE, 0, -100]]
    n = aircraft - 1
    return RunInfo(
        scenario_name="made-up",
        make_yaml=str,
        names=("leader", *(f"uav{k + 1}" for k in range(n))),
        aircraft=("rascal110",) * aircraft,
        wingspan_m=(2.795,) * aircraft,
        origin=NedOrigin(),
        base_rate_hz=200,
        sample_rate_hz=25,
        duration_s=duration_s,
        seed=1,
        speed_bounds_mps=((16.0, 30.0),) * n,
        kappa_mps=(3.6,) * n,
        roll_limit_rad=(np.radians(45.0),) * n,
        leader_path_ned=np.array(corners, dtype=float),
        windows={},
        versions={},
    )


def course_and_position(distance: Array) -> tuple[Array, Array, Array]:
    """Position (m, 2), course (m,) and turning (m,) after a distance (m,) round the rectangle."""
    straight, arc = SIDE - 2.0 * CORNER, 0.5 * np.pi * CORNER
    lap, leg = np.divmod(distance, straight + arc)
    turned = np.clip((leg - straight) / CORNER, 0.0, None)
    along = np.minimum(leg, straight) + CORNER * np.sin(turned)
    aside = CORNER * (1.0 - np.cos(turned))
    start = 0.5 * np.pi * (lap % 4)
    c, s = np.cos(start), np.sin(start)
    # the four starts of legs are rotations of the first
    first = np.array([CORNER - 0.5 * SIDE, -0.5 * SIDE])
    local = np.stack([along, aside], axis=-1) + first
    position = np.stack([c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1]], -1)
    return position + 0.5 * SIDE, start + turned, turned > 0.0


def samples(aircraft: int, duration_s: float, rate_hz: float = 25.0) -> Iterator[Sample]:
    """Generate the samples of the flight."""
    n = aircraft - 1
    offsets = np.concatenate([np.zeros((1, 3)), vee(n)])
    rng = np.random.default_rng(1)
    phase = rng.uniform(0.0, 2.0 * np.pi, (aircraft, 3))
    phase_rate = rng.uniform(0.2, 0.6, (aircraft, 3))
    bank = 0.0
    start_error = np.concatenate([np.zeros((1, 3)), rng.normal(0.0, 6.0, (n, 3))])
    for tick in range(int(duration_s * rate_hz)):
        t = tick / rate_hz
        position, sigma, turning = (v[0] for v in course_and_position(np.array([SPEED * t])))
        wanted = np.arctan(SPEED**2 / (CORNER * GRAVITY)) if turning else 0.0
        bank += (wanted - bank) / (0.6 * rate_hz)
        c, s = np.cos(sigma), np.sin(sigma)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        centre = np.array([*position, -100.0 - 15.0 * np.sin(0.03 * t)])
        desired = centre + offsets @ turn.T
        sway = 0.35 * np.sin(phase + phase_rate * t) * (np.arange(aircraft) > 0)[:, None]
        error = sway + start_error * np.exp(-t / 5.0)
        velocity = np.tile(turn @ [SPEED, 0.0, 0.0], (aircraft, 1)) + 2.0 * sway
        euler = np.zeros((aircraft, 3))
        euler[:, 0] = bank + 0.08 * np.sin(phase[:, 0] + 0.9 * t)
        euler[:, 1] = np.radians(3.0)
        euler[:, 2] = sigma
        state = VehicleState(
            position_ned=desired + error,
            velocity_ned=velocity,
            acceleration_ned=np.zeros((aircraft, 3)),
            euler=euler,
            rates_body=np.zeros((aircraft, 3)),
            airspeed=np.linalg.norm(velocity, axis=-1),
            equivalent_airspeed=np.linalg.norm(velocity, axis=-1),
        )
        zeros, nil = np.zeros(aircraft), np.zeros(n)
        throttle = 0.25 + 0.1 * np.sin(phase[:, 1] + t)
        yield Sample(
            tick=tick * 8,
            time_s=t,
            truth=state,
            estimate=state,
            air=AirData(zeros, zeros, zeros, *np.zeros((2, aircraft, 3)), *np.zeros((3, aircraft))),
            command=FbwaCommand(zeros, euler[:, 0], throttle),
            surfaces=ActuatorCommand(zeros, zeros, zeros, throttle),
            links=LinkCounters(*np.zeros((2, n, aircraft), np.uint32)),
            formation=FormationState(
                slot_ned=desired[1:],
                error_ned=error[1:],
                speed=np.linalg.norm(velocity[1:], axis=-1),
                speed_desired=nil + SPEED,
                airspeed_command=nil + SPEED,
                course=nil + sigma,
                course_desired=nil + sigma,
                flight_path_angle=nil,
                flight_path_angle_desired=nil,
                limiter_flags=np.zeros(n, np.uint8),
                saturations=np.zeros(n, np.uint8),
                age_s=np.zeros((n, aircraft)),
                slot_index=np.arange(1, n + 1, dtype=np.uint32),
                estimated_error_ned=error[1:],
            ),
            lost=np.zeros(aircraft, dtype=bool),
            events=(Event(t, "info", "uav1", "joined"),) if tick == 400 and n else (),
        )


def log(aircraft: int, duration_s: float) -> SimpleNamespace:
    """Stack the samples as in a log read back."""
    flown = list(samples(aircraft, duration_s))
    records = ("truth", "estimate", "air", "command", "surfaces", "formation", "links")
    stacked = {
        name: type(getattr(flown[0], name))(
            *(np.stack(column) for column in zip(*(getattr(f, name) for f in flown), strict=True))
        )
        for name in records
    }
    return SimpleNamespace(
        **stacked,
        info=info(aircraft, duration_s),
        time_s=np.array([sample.time_s for sample in flown]),
        lost=np.stack([sample.lost for sample in flown]),
        events=tuple(event for sample in flown for event in sample.events),
        metrics=None,
    )
