"""Build formation laws and middle loops from a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import PAPER_GRAVITY
from testbed.core.reads import Deferred, current, deferred, derive, unrecorded
from testbed.core.records import Array, FbwaCommand, Records, UnicycleCommand, allocate
from testbed.core.speed_model import OwnSpeedModel, speed_model_records
from testbed.core.speed_model import make_own as make_speed_model
from testbed.flight.control import BuiltControl, ControlGroup, law_name
from testbed.flight.schedule import Clock
from testbed.formation import barrier, control_function
from testbed.formation import leader_filter as leader
from testbed.formation.assumptions import SpeedSet, check_barrier, margin
from testbed.formation.barrier import SpeedBarrier, UserBarrier
from testbed.formation.control_function import ControlFunction, UserControlFunction
from testbed.formation.control_step import Hbh23Law, initial_controllers, make_neighbours
from testbed.formation.hbh23 import LAW
from testbed.formation.law import FormationConfig, Law
from testbed.formation.middle_loop import LOOP
from testbed.formation.separation_filter import SEPARATION
from testbed.plan.fleet import AgentParameters, FormationPlan, PlannedFollower
from testbed.plan.user_code import build_function, build_law, check_law
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario.control import BUILT_IN, Controller
from testbed.scenario.middle_loop import Estimators

_ACCELERATION_SOURCES = {
    "none": leader.NOTHING,
    "broadcast": leader.BROADCAST,
    "coordinated_turn": leader.TURN,
}
_ANGULAR_ACCELERATION_SOURCES = {
    "none": leader.NOTHING,
    "roll_rate": leader.ROLL_RATE,
    "difference": leader.DIFFERENCE,
}


def build_control(
    fleet: FormationPlan,
    controller: Controller,
    clock: Clock,
    groups: Sequence[Sequence[int]] | None = None,
) -> BuiltControl:
    """Build the control of the followers of a fleet.

    Args:
        fleet: the aircraft.
        controller: section of the scenario.
        clock: of the run.
        groups: rows of followers that step together; None: those of the clock.
    """
    builtin = controller.law == BUILT_IN
    extrapolates = not builtin and controller.extrapolate_from is not None
    config, parts = build_config(fleet, controller, dt=clock.control / clock.base_rate_hz)
    law, messages, reads = build_law_records(fleet.followers, controller, config)
    loops, flown_loops = build_loops(fleet.followers, controller, config)
    hold = builtin and controller.on_neighbour_timeout == "hold-relative-position"
    timeout_s = math.inf if hold else config.neighbour_timeout_s
    with deferred() as weights:
        gains = config.gains
    neighbours = make_neighbours(config.offsets, gains, config.leader_timeout_s, timeout_s)
    ideal = [each.is_ideal for each in fleet.followers]
    separation = build_separation(fleet, controller)
    controllers = initial_controllers(law, loops, ideal, separation)
    if builtin:
        _use(weights, *reads)
    if extrapolates:
        reads.extrapolation.use()
    commands: set[type] = {UnicycleCommand} if builtin else set()
    built = []
    for rows in clock.groups if groups is None else groups:
        members, user_law = select_followers(config, rows), None
        if not builtin:
            indices = list(rows)
            hbh23 = Hbh23Law(
                law[indices], neighbours[indices], (weights, *reads), (reads.velocity,)
            )
            user_law, origin = build_law(
                controller.law, controller.options, members, parts, hbh23, config, controller.map
            )
            commands.add(_check_user_law(fleet.followers, members, user_law, controller))
            messages.append(f"the law {law_name(user_law)} runs {origin}")
        built.append(ControlGroup(np.array(rows, dtype=np.intp), members, user_law))
    if UnicycleCommand in commands:
        flown_loops.use()
    if FbwaCommand in commands:  # which are limited to them
        _use(parts["pitch_limit"], parts["roll_limit"])
    return BuiltControl(
        config,
        tuple(built),
        controllers,
        neighbours,
        builtin,
        hold,
        tuple(dict.fromkeys(messages)),
        extrapolates=extrapolates,
    )


def build_separation(fleet: FormationPlan, controller: Controller) -> Records | None:
    """Return the separation filters (n,) of followers; None: there are none.

    Raises:
        InputError: slots are closer than separation and margin, or ages of messages are not known.
    """
    safety = controller.safety
    if safety is None:
        return None
    if controller.extrapolate_from != "timestamp":
        raise InputError(
            "controller.safety: positions of others are those of the time of measurement plus "
            "the time since (write controller.extrapolate_from: timestamp)"
        )
    distance = safety.separation_m + safety.margin_m
    slots, names = fleet.offsets, fleet.names
    for i in range(len(slots)):
        for j in range(i):
            apart = float(np.linalg.norm(slots[i] - slots[j]))
            if apart < distance:
                raise InputError(
                    f"controller.safety: the slots of {names[j]} and {names[i]} are {apart:.4g} m "
                    f"apart, less than separation_m + margin_m, {safety.separation_m:g} + "
                    f"{safety.margin_m:g} m (move formation.offsets_m apart, or write a smaller "
                    "separation or margin)"
                )
    separation = allocate(SEPARATION, len(fleet.followers))
    separation["on"], separation["distance"] = True, distance
    separation["rate"] = safety.rate_per_s
    return separation


def _use(*parts: Deferred) -> None:
    for each in parts:
        each.use()


class LawReads(NamedTuple):
    """What was read for the parts of the records of laws."""

    velocity: Deferred  # from a desired velocity to a command, (8)-(15)
    extrapolation: Deferred  # of messages
    rest: Deferred


def _check_user_law(
    followers: Sequence[PlannedFollower],
    config: FormationConfig,
    law: Law,
    controller: Controller,
) -> type[UnicycleCommand | FbwaCommand[Array]]:
    """Check a user's law, and return its type of command, which its vehicles accept."""
    command = check_law(law, config)
    if command is FbwaCommand and controller.safety is not None:
        raise InputError(
            f"controller.safety: {law_name(law)} commands fly-by-wire A, and the filter is behind "
            "laws that desire a velocity (return a UnicycleCommand, as command_from_velocity "
            "does, or leave safety out)"
        )
    unicycles = [each.name for each in followers if each.is_ideal]
    unable = [name for name in config.names if name in unicycles]
    if command is FbwaCommand and unable:
        raise InputError(
            f"controller.law: {law_name(law)} commands fly-by-wire A, which a unicycle "
            f"cannot fly (write vehicle: jsbsim for {', '.join(unable)}, or return a "
            "UnicycleCommand)"
        )
    return command


def build_law_records(
    followers: Sequence[PlannedFollower], controller: Controller, config: FormationConfig
) -> tuple[Records, list[str], LawReads]:
    """Return the laws (n,) of LAW of followers.

    Returns:
        The laws, messages about functions of the user's, and what was read for each part.

    Raises:
        InputError: a function of the user's violates (C1), (C2) or (B1) to (B5).
    """
    law, messages = allocate(LAW, len(config.names)), list[str]()
    law["row"] = config.agents
    with deferred() as velocity:
        _write_velocity_control(law, followers, controller, config, messages)
    chosen = [_estimators(each, controller) for each in followers]
    with deferred() as extrapolation:
        _write_extrapolation(law, controller, chosen)
    with deferred() as rest:
        _write_estimates(law, chosen)
        _write_timeouts(law, controller, config)
    return law, messages, LawReads(velocity, extrapolation, rest)


def _write_velocity_control(
    law: Records,
    followers: Sequence[PlannedFollower],
    controller: Controller,
    config: FormationConfig,
    messages: list[str],
) -> None:
    """Write what turns a desired velocity into a command; functions add messages."""
    names, agents = config.names, [each.agent for each in followers]
    law["speed_pole"] = config.speed_pole
    for key in ("k", "a", "b"):
        law[key] = [getattr(each, key) for each in agents]
    law["c"] = [each.c.constant for each in agents]
    law["c_speed"] = [each.c.per_speed_squared for each in agents]
    functions = [make_control_function(each.control_function, messages) for each in agents]
    law["mu"] = control_function.control_function_records(*functions)
    speed_set = _speed_set(agents, config, law["k"], functions)
    for field, speeds in speed_set._asdict().items():
        law[f"speed_{field}"] = speeds
    barriers = [
        make_barrier(each.barrier, low, high, messages)
        for each, low, high in zip(agents, config.airspeed_min, config.airspeed_max, strict=True)
    ]
    law["barrier"] = barrier.barrier_records(*barriers)
    for found in check_barrier(barriers, speed_set):
        if isinstance(barriers[found.agent], UserBarrier):
            raise InputError(f"formation.barrier: of {names[found.agent]}, {found.text}")
    law["speed_model"] = speed_model_records(
        *(own_speed_model(each, controller, messages) for each in followers)
    )
    law["horizontal"] = ~np.isnan([each.altitude for each in followers])
    law["bounds_of_airspeed"] = controller.bounded_speed == "airspeed"


def _estimators(follower: PlannedFollower, controller: Controller) -> Estimators:
    """Return the estimators of a follower: those of its airframe, with the scenario's changes."""
    changes, own = controller.estimators, follower.gains.estimators
    with unrecorded():
        chosen = changes.over(own)
        changed = {name for name in Estimators.model_fields if getattr(changes, name) is not None}
    sources = {
        name: [(changes if name in changed else own, name)] for name in Estimators.model_fields
    }
    derive(chosen, sources)
    return chosen


def _write_extrapolation(
    law: Records, controller: Controller, chosen: Sequence[Estimators]
) -> None:
    """Write how messages are extrapolated to the present."""
    law["from_timestamp"] = controller.extrapolate_from == "timestamp"
    law["with_acceleration"] = [each.extrapolation == "acceleration" for each in chosen]


def _write_estimates(law: Records, chosen: Sequence[Estimators]) -> None:
    """Write how the leader's accelerations are estimated; a source reads its own keys only."""
    law["acceleration_source"] = [
        _ACCELERATION_SOURCES[each.leader_acceleration] for each in chosen
    ]
    law["angular_acceleration_source"] = [
        _ANGULAR_ACCELERATION_SOURCES[each.leader_angular_acceleration] for each in chosen
    ]
    for key, source, name, used in (
        ("acceleration_blend", "acceleration_source", "leader_acceleration_blend", "BROADCAST"),
        ("difference_blend", "acceleration_source", "leader_difference_blend", "TURN"),
        ("turn_rate_blend", "angular_acceleration_source", "leader_turn_rate_blend", "DIFFERENCE"),
    ):
        for row, each in enumerate(chosen):
            with nullcontext() if law[source][row] == getattr(leader, used) else unrecorded():
                law[key][row] = getattr(each, name)


def _write_timeouts(law: Records, controller: Controller, config: FormationConfig) -> None:
    """Write what followers do without messages of the leader or of neighbours."""
    loiters = controller.on_leader_timeout == "loiter"
    tangent = math.tan(math.radians(controller.loiter_bank_deg)) if loiters else 0.0
    law["leader_timeout_s"] = config.leader_timeout_s
    law["neighbour_timeout_s"] = config.neighbour_timeout_s
    law["hold_stale_neighbours"] = controller.on_neighbour_timeout == "hold-relative-position"
    law["lost_leader_airspeed"] = config.trim_airspeed
    law["lost_leader_turn_rate"] = PAPER_GRAVITY * tangent / config.trim_airspeed


def own_speed_model(
    follower: PlannedFollower, controller: Controller, messages: list[str] | None = None
) -> OwnSpeedModel | None:
    """Return f and g of (2) for one follower, and add messages about them; None: −p s and p.

    Raises:
        InputError: g is zero somewhere, or a derivative is not continuous; or the follower has a
            flight model, whose middle loop takes u as a speed, or a user's law.
    """
    chosen, name = follower.agent.speed_model, follower.name
    if chosen is None:
        return None
    own = "speed_model" in follower.agent.own_keys
    key = f"formation.agents.{name}.speed_model" if own else "formation.speed_model"
    if not follower.is_ideal:
        raise InputError(
            f"{key}: {name} has a flight model, and the throttle loop (21) takes u as a speed "
            f"(write vehicle: unicycle for {name}, or speed_pole_per_s)"
        )
    if controller.law != BUILT_IN:
        raise InputError(
            f"{key}: a law of your own commands speeds, which vehicles with other f and g do not "
            "take (write law: hbh23, or speed_pole_per_s)"
        )
    (f, of_f), (g, of_g) = (
        build_function(getattr(chosen, each), f"{key}.{each}") for each in ("f", "g")
    )
    if messages is not None:
        messages += [f"f of the speed model runs {of_f}", f"g of the speed model runs {of_g}"]
    try:
        return make_speed_model(f, g, *follower.agent.speed_mps)
    except ValueError as error:
        raise InputError(f"{key}: {error}") from error


def make_control_function(
    chosen: Any,  # noqa: ANN401 - a union
    messages: list[str],
) -> ControlFunction | UserControlFunction:
    """Return μ of a `control_function` section, and add a message about a function of the user's.

    Raises:
        InputError: (C1) or (C2) fails.
    """
    if chosen.example == "own":
        key = "formation.control_function"
        function, origin = build_function(chosen.function, key)
        messages.append(f"the control function runs {origin}")
        try:
            return control_function.make_own(function)
        except ValueError as error:
            raise InputError(f"{key}: {error}") from error
    if chosen.example == 1:
        return control_function.example_1(chosen.nu1, chosen.nu2, chosen.m)
    return control_function.EXAMPLE_2 if chosen.example == 2 else control_function.EXAMPLE_3


def make_barrier(
    chosen: Any,  # noqa: ANN401 - a union
    speed_min: float,
    speed_max: float,
    messages: list[str],
) -> SpeedBarrier | UserBarrier:
    """Return h of a `barrier` section for speed bounds, m/s; see `make_control_function`.

    Raises:
        InputError: the function has no continuous derivative.
    """
    if chosen.example == "own":
        key = "formation.barrier"
        function, origin = build_function(chosen.function, key)
        messages.append(f"the barrier runs {origin}")
        try:
            return barrier.make_own(
                lambda s: function(s, speed_min, speed_max), speed_min, speed_max
            )
        except ValueError as error:
            raise InputError(f"{key}: {error}") from error
    return SpeedBarrier(chosen.example, 0.0 if chosen.example == 7 else chosen.nu)


def _speed_set(
    agents: Sequence[AgentParameters],
    config: FormationConfig,
    k: Array,
    functions: Sequence[ControlFunction | UserControlFunction],
) -> SpeedSet:
    """Return S and S_d, by fact 1 where the scenario does not give S_d."""
    low, high = config.airspeed_min, config.airspeed_max
    kappa = np.array([each.kappa_mps for each in agents])
    epsilon = margin(k, kappa, np.array([each.bound for each in functions]))
    desired_low, desired_high = low + epsilon, high - epsilon
    for i, each in enumerate(agents):
        if each.speed_desired_mps is not None:
            desired_low[i], desired_high[i] = each.speed_desired_mps
    return SpeedSet(low, high, desired_low, desired_high)


_OF_FOLLOWERS = (
    "airspeed_min",
    "airspeed_max",
    "ground_speed_min",
    "ground_speed_max",
    "speed_pole",
    "pitch_limit",
    "roll_limit",
    "trim_throttle",
    "trim_airspeed",
)


def build_config(
    fleet: FormationPlan, controller: Controller, *, dt: float
) -> tuple[FormationConfig, Mapping[str, Deferred]]:
    """Build the configuration of all n followers, which step every `dt` s.

    Returns:
        The configuration, and what was read for each of its fields.
    """
    names, profiles = fleet.names[1:], [each.gains for each in fleet.followers]
    agents = [each.agent for each in fleet.followers]

    def speeds(of_ground: bool, index: int, none: float) -> Array:
        if of_ground and controller.bounded_speed == "airspeed":
            return np.full(len(agents), none)
        return np.array([each.speed_mps[index] for each in agents], dtype=np.float64)

    def leader_timeout() -> float:
        return controller.leader_timeout_s

    def neighbour_timeout() -> float:
        own = controller.neighbour_timeout_s
        return controller.leader_timeout_s if own is None else own

    degree = math.radians(1.0)
    make: dict[str, Callable[[], Any]] = {
        "names": lambda: names,
        "agents": lambda: np.arange(1, len(names) + 1, dtype=np.intp),
        "offsets": lambda: fleet.offsets,
        "gains": lambda: fleet.weights,
        "airspeed_min": lambda: speeds(False, 0, 0.0),
        "airspeed_max": lambda: speeds(False, 1, math.inf),
        "ground_speed_min": lambda: speeds(True, 0, 0.0),
        "ground_speed_max": lambda: speeds(True, 1, math.inf),
        "speed_pole": lambda: np.array([each.speed_pole_per_s for each in agents]),
        "pitch_limit": lambda: profile_values(profiles, "limits.pitch_deg", scale=degree),
        "roll_limit": lambda: profile_values(profiles, "limits.roll_deg", scale=degree),
        "trim_throttle": lambda: profile_values(profiles, "trim_throttle"),
        "trim_airspeed": lambda: profile_values(profiles, "trim_airspeed_mps"),
        "dt": lambda: dt,
        "leader_timeout_s": leader_timeout,
        "neighbour_timeout_s": neighbour_timeout,
    }
    values: dict[str, Any] = {}
    parts: dict[str, Deferred] = {}
    for name, value in make.items():
        with deferred() as parts[name]:
            values[name] = value()
    parts["speed_min"], parts["speed_max"] = parts["airspeed_min"], parts["airspeed_max"]
    config = FormationConfig(**values)
    if (reads := current()) is not None:
        reads.register_parts(config, parts)
    return config, parts


def select_followers(config: FormationConfig, rows: Sequence[int]) -> FormationConfig:
    """Select some followers; all N aircraft stay possible neighbours."""
    chosen = np.array(rows, dtype=np.intp)
    with unrecorded():
        return FormationConfig(
            names=tuple(config.names[i] for i in rows),
            agents=config.agents[chosen],
            offsets=config.offsets,
            gains=config.gains[chosen],
            **{name: getattr(config, name)[chosen] for name in _OF_FOLLOWERS},
            dt=config.dt,
            leader_timeout_s=config.leader_timeout_s,
            neighbour_timeout_s=config.neighbour_timeout_s,
        )


def profile_values(profiles: Sequence[Profile], path: str, scale: float = 1.0) -> Array:
    """Return one number of every profile (n,), by its dotted key."""
    return scale * np.array([attrgetter(path)(profile) for profile in profiles], dtype=np.float64)


_SCALED = {
    f"{field}_{term}": f"{key}.{term}"
    for field, key, terms in (
        ("gamma", "flight_path", "pid"),
        ("course", "course", "pid"),
        ("speed", "speed", "pi"),
        ("altitude", "altitude", "pid"),
    )
    for term in terms
}
_UNSCALED = {
    "eta_speed": "eta_speed",
    "eta_bank": "eta_bank",
    "trim_throttle": "trim_throttle",
    "trim_airspeed": "trim_airspeed_mps",
    "roll_lead": "feed_forwards.roll_lead_s",
    "lead_filter": "feed_forwards.lead_filter_s",
    "eta_climb": "feed_forwards.eta_climb",
    "rate_filter": "rate_filter_s",
}
_DEGREES = {
    "pitch_limit": "limits.pitch_deg",
    "roll_limit": "limits.roll_deg",
    "turn_incidence": "feed_forwards.turn_incidence_deg",
}


def make_loops(
    profiles: Sequence[Profile],
    *,
    dt: float,
    speed_min: Array,
    speed_max: Array,
    altitude: Array | float = math.nan,
    scale: float = 1.0,
    incidence: float = 0.0,
    airspeed_error_as_printed: bool = False,
) -> Records:
    """Return middle loops (n,) of LOOP with the gains of profiles.

    Args:
        profiles: n of them.
        dt: control period, s.
        speed_min: (n,) m/s, of the commanded airspeed.
        speed_max: (n,) m/s.
        altitude: (n,) m to hold; nan: none.
        scale: multiplies every PID gain, as `controller.gain_scale`.
        incidence: fraction of θ − γ that is fed forward, 0 or 1.
        airspeed_error_as_printed: see LOOP.
    """
    loops = allocate(LOOP, len(profiles))
    loops["altitude"] = altitude
    holds = ~np.isnan(loops["altitude"])
    for names, degree in ((_SCALED, scale), (_UNSCALED, 1.0), (_DEGREES, math.radians(1.0))):
        for name, path in names.items():
            # altitude gains are for followers that hold an altitude, path gains for the others
            used = holds.any() if name.startswith("altitude_") else True
            used = not holds.all() if name.startswith("gamma_") else used
            with nullcontext() if used else unrecorded():
                loops[name] = profile_values(profiles, path, degree)
    loops["course_inside"] = [each.course_feedback == "inside_arctangent" for each in profiles]
    loops["incidence"], loops["dt"] = incidence, dt
    loops["speed_min"], loops["speed_max"] = speed_min, speed_max
    loops["airspeed_error_as_printed"] = airspeed_error_as_printed
    return loops


def build_loops(
    followers: Sequence[PlannedFollower], controller: Controller, config: FormationConfig
) -> tuple[Records, Deferred]:
    """Return the middle loops (n,) of LOOP of the followers, and what was read for them."""
    with deferred() as reads:
        loops = make_loops(
            [each.gains for each in followers],
            dt=config.dt,
            speed_min=config.airspeed_min,
            speed_max=config.airspeed_max,
            altitude=np.array([each.altitude for each in followers]),
            scale=controller.gain_scale,
            incidence=float(controller.pitch_feedforward == "incidence"),
            airspeed_error_as_printed=controller.throttle_error == "airspeed",
        )
    return loops, reads
