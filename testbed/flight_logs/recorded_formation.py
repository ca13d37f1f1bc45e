"""A formation of several recorded flights on one clock: a run with the log and metrics of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    LINK,
    Array,
    Event,
    Indices,
    NedOrigin,
    Records,
    RunInfo,
    Sample,
    allocate,
    mark_unknown,
)
from testbed.core.samples import make_sample
from testbed.core.standard_atmosphere import density_ratio
from testbed.core.start_time import iso_time
from testbed.flight_logs.recorded_motion import (
    EULER,
    NED,
    RATES,
    VELOCITY,
)
from testbed.flight_logs.tracks import Track
from testbed.formation.slots import write_formation_state
from testbed.guidance.recorded_path import (
    RecordedFlight,
    SampledTrajectory,
    sample_recording,
)
from testbed.logs.file_record import record_files
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import (
    LOG_NAME,
    METRICS_NAME,
    SCENARIO_NAME,
    create_run_directory,
    write_run_file,
)
from testbed.metrics.document import write_json
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver
from testbed.plan.clock import build_clock
from testbed.plan.fleet import FormationPlan
from testbed.plan.measured_fleet import resolve
from testbed.plan.world import versions
from testbed.scenario import Scenario, ScenarioText
from testbed.scenario.fields import MAX_DURATION_S

_DRAWN = 5000  # points of the leader's path in a view
_BLOCK = 1000  # samples that are interpolated at once
# parts of an aircraft that logs of flights do not have
_UNKNOWN = ("air", "wind", "command", "control", "surfaces")


@dataclass(frozen=True, slots=True)
class FormationRun:
    """A formation that was written as a run.

    Attributes:
        directory: of the run.
        metrics: of its metrics.json.
        tracks: of the aircraft, the leader's first.
        start_unix_s: UNIX time of time 0.
        sections: begin and end of all sections in which every aircraft has data, s; the first one
            is the longest, and is written.
    """

    directory: Path
    metrics: Metrics
    tracks: tuple[Track, ...]
    start_unix_s: float
    sections: tuple[tuple[float, float], ...]


def write_formation(
    scenario: Scenario,
    tracks: Sequence[Track],
    start_unix_s: float,
    out: Path | None,
    *,
    begin: float = 0.0,
    end: float = math.inf,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> FormationRun:
    """Write the longest section in which all aircraft have data as a run of the scenario.

    Slots, errors and metrics are those of a simulated run, by the scenario's formation. Positions
    are interpolated cubically between rows at most `MAX_GAP_S` apart. What a log does not have,
    such as the law's output, is NaN in the log of the run.

    Args:
        scenario: whose slots the followers had.
        tracks: of its aircraft, in its order.
        start_unix_s: UNIX time of time 0.
        out: the run directory, new or empty; None: a new one below `logs`.
        begin: earliest time, s.
        end: latest time, s.
        advance: called with the number of samples that are written and of all.

    Raises:
        InputError: there is no time at which all aircraft have data, or time 0 is more than a day
            before it.
        LogError: the directory or the log cannot be written.
    """
    _check_start(tracks, start_unix_s)
    plan = resolve(scenario)
    clock = build_clock(scenario)
    ticks, sections = _common_ticks(tracks, clock.base_rate_hz, clock.log, max(begin, 0.0), end)
    info = _run_info(scenario, plan, tracks, ticks, clock.base_rate_hz, start_unix_s)
    events = _events(tracks, sections, start_unix_s)
    directory = create_run_directory(scenario.name, out=out)
    write_run_file(directory, SCENARIO_NAME, info.scenario_yaml.encode())
    recorder, meter = McapRecorder(directory / LOG_NAME, live=False), MetricsObserver()
    observers = (recorder, meter)
    try:
        for observer in observers:
            observer.begin(info)
        samples = _samples(plan, tracks, ticks, clock.base_rate_hz, events)
        for number, sample in enumerate(samples, start=1):
            for observer in observers:
                observer.observe(sample)
            advance(number, len(ticks))
    except BaseException:
        # a half would look like a simulated run that was killed
        recorder.close()
        for name in (LOG_NAME, SCENARIO_NAME):
            (directory / name).unlink(missing_ok=True)
        with suppress(OSError):
            directory.rmdir()
        raise
    metrics = meter.summary()
    metrics["outcome"], metrics["recorded"] = "completed", True
    for name in plan.names[1:]:  # of a law that is not known
        metrics["limiter_flags"][name]["seconds"] = None
        metrics["saturations"][name]["seconds"] = None
    recorder.end(metrics, ())
    write_json(directory / METRICS_NAME, metrics)
    record_files(directory, SCENARIO_NAME, LOG_NAME, METRICS_NAME)
    return FormationRun(directory, metrics, tuple(tracks), start_unix_s, sections)


def _check_start(tracks: Sequence[Track], start_unix_s: float) -> None:
    """Check that time 0 is at most as long before all logs have begun as a run lasts."""
    first = max(float(each.time[0]) for each in tracks)
    if first > MAX_DURATION_S:
        raise InputError(
            f"time 0 is {iso_time(start_unix_s)}, and all logs have begun {first:,.0f} s later, at "
            f"{iso_time(start_unix_s + first)}; write --start with a time at most a day earlier"
        )


def _common_ticks(
    tracks: Sequence[Track], base_rate_hz: int, stride: int, begin: float, end: float
) -> tuple[Indices, tuple[tuple[float, float], ...]]:
    """Return the ticks of the longest section that all aircraft have, and all sections."""
    last = min(end, *(float(each.time[-1]) for each in tracks))
    first = max(begin, *(float(each.time[0]) for each in tracks))
    if last - first > MAX_DURATION_S:
        raise InputError(
            f"the logs have {last - first:,.0f} s in common, more than a day; choose a part with "
            "--from and --to"
        )
    ticks = np.arange(
        math.ceil(first * base_rate_hz / stride - 1e-6) * stride,
        math.floor(last * base_rate_hz + 1e-6) + 1,
        stride,
    )
    known = np.ones(len(ticks), dtype=bool)
    for each in tracks:
        known &= each.known(ticks / base_rate_hz)
    where = np.flatnonzero(known)
    parts = [p for p in np.split(where, np.flatnonzero(np.diff(where) > 1) + 1) if len(p) > 2]
    if not parts:
        spans = "; ".join(f"{e.name} {e.time[0]:.1f} to {e.time[-1]:.1f}" for e in tracks)
        raise InputError(
            f"no time that all aircraft have: {spans} (s since time 0). Check the clocks: --offset "
            "NAME=S moves one, --from and --to choose a part"
        )
    parts.sort(key=len, reverse=True)
    sections = tuple(
        (float(ticks[p[0]]) / base_rate_hz, float(ticks[p[-1]]) / base_rate_hz) for p in parts
    )
    return ticks[parts[0]], sections


def _events(
    tracks: Sequence[Track], sections: Sequence[tuple[float, float]], start_unix_s: float
) -> tuple[Event, ...]:
    """Say where the data comes from, and which parts of the flight are left out."""
    begin = sections[0][0]
    text = f"recorded flight, not simulated; time 0 is {iso_time(start_unix_s)}"
    events = [
        Event(begin, "info", "run", text),
        *(
            Event(
                begin,
                "info",
                each.name,
                f"recorded in {each.log.path.name}"
                + ("" if each.log.system is None else f", system {each.log.system}")
                + f", {each.rate_hz:.3g} rows per second; time by {each.clock}",
            )
            for each in tracks
        ),
    ]
    for each in tracks:
        events += [Event(begin, "warning", each.name, note) for note in each.motion.notes]
    if sections[1:]:
        others = ", ".join(f"{a:g} to {b:g}" for a, b in sorted(sections[1:]))
        text = f"sections between gaps, left out: {others} s"
        events.append(Event(begin, "warning", "run", text))
    return tuple(events)


def _run_info(
    scenario: Scenario,
    plan: FormationPlan,
    tracks: Sequence[Track],
    ticks: Indices,
    base_rate_hz: int,
    start_unix_s: float,
) -> RunInfo:
    agents = [each.agent for each in plan.followers]
    time = ticks / base_rate_hz
    drawn = time[:: max(1, len(time) // _DRAWN)]
    leader = _sample(tracks[0], drawn).position_ned
    return RunInfo(
        scenario_name=scenario.name,
        make_yaml=ScenarioText(scenario),
        names=plan.names,
        aircraft=tuple(each.folder.name for each in plan.aircraft),
        wingspan_m=tuple(each.airframe.span for each in plan.aircraft),
        origin=plan.origin,
        base_rate_hz=base_rate_hz,
        sample_rate_hz=scenario.rates.log_hz,
        duration_s=float(time[-1]),
        seed=scenario.scenario.seed,
        speed_bounds_mps=tuple(each.speed_mps for each in agents),
        kappa_mps=tuple(each.kappa_mps for each in agents),
        roll_limit_rad=tuple(math.radians(e.gains.limits.roll_deg) for e in plan.followers),
        leader_path_ned=leader,
        windows=dict(scenario.scenario.windows),
        versions=versions(),
        start_unix_ns=round(start_unix_s * 1e9),
    )


def _sample(track: Track, time: Array) -> SampledTrajectory:
    """Sample the motion of an aircraft at times (T,), s."""
    motion = track.motion
    recording = RecordedFlight(
        time=track.time,
        position_ned=motion.stack(NED),
        velocity_ned=motion.stack(VELOCITY),
        euler=np.unwrap(motion.stack(EULER), axis=0),
        rates_body=motion.stack(RATES),
        airspeed=motion.columns["airspeed_mps"],
        throttle=motion.columns["throttle"],
        source=str(track.log),
    )
    return sample_recording(recording, time - track.time[0])


def _samples(
    plan: FormationPlan,
    tracks: Sequence[Track],
    ticks: Indices,
    base_rate_hz: int,
    events: tuple[Event, ...],
) -> Iterator[Sample]:
    """Yield the samples of a formation; each is of arrays that change with the next."""
    count = len(tracks)
    aircraft, followers = allocate(AIRCRAFT, count), allocate(FOLLOWER, count - 1)
    links = allocate(LINK, count - 1, count)
    mark_unknown(aircraft, followers, links, _UNKNOWN)
    sample = make_sample(aircraft, followers, links, exact=True, faults=False)
    offsets, altitudes = plan.offsets, plan.altitudes
    for start in range(0, len(ticks), _BLOCK):
        block = ticks[start : start + _BLOCK]
        time = block / base_rate_hz
        moved = [_sample(each, time) for each in tracks]
        surfaces = [_surfaces(each, time) for each in tracks]
        for k, tick in enumerate(block.tolist()):
            for i, track in enumerate(moved):
                _write_motion(aircraft[i], track, k, plan.origin)
                for name, values in surfaces[i].items():
                    aircraft[i]["surfaces"][name] = values[k]
            aircraft["estimate"] = aircraft["truth"]
            write_formation_state(aircraft, followers, offsets, altitudes)
            first = start == 0 and k == 0
            yield sample._replace(
                tick=tick, time_s=tick / base_rate_hz, events=events if first else ()
            )


def _write_motion(row: Records, track: SampledTrajectory, k: int, origin: NedOrigin) -> None:
    truth = row["truth"]
    truth["position_ned"] = track.position_ned[k]
    truth["velocity_ned"] = track.velocity_ned[k]
    truth["acceleration_ned"] = track.acceleration_ned[k]
    truth["euler"] = track.euler[k]
    truth["rates_body"] = track.rates_body[k]
    truth["airspeed"] = track.airspeed[k]
    height = origin.elevation_m - track.position_ned[k, 2]
    truth["equivalent_airspeed"] = track.airspeed[k] * math.sqrt(density_ratio(height, 0.0))
    row["command"]["throttle"] = track.throttle[k]


def _surfaces(track: Track, time: Array) -> dict[str, Array]:
    """Return servo outputs (T,) by name, of the pulses that the log has."""
    columns = track.motion.columns
    found = {}
    for name, pulse, centre, scale in (
        ("aileron", "pwm_ail", 1500.0, 500.0),
        ("elevator", "pwm_ele", 1500.0, -500.0),
        ("rudder", "pwm_rud", 1500.0, -500.0),
        ("throttle", "pwm_thr", 1000.0, 1000.0),
    ):
        if pulse in columns:
            values = (np.interp(time, track.time, columns[pulse]) - centre) / scale
            found[name] = np.clip(values, -1.0, 1.0)
    return found
