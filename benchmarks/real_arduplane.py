"""Write tables and figure of four real ArduPlanes against the virtual autopilot, from a recording.

usage: make arduplane

Flies simulation-3-30deg once per profile with virtual autopilots, and compares it with the
recording in tests/data; once more with the pulses of the link; and other flights of ArduPlanes of
which only the errors are known. All use the Rascal, tune and gains of those flights.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from inputs import Case, Inputs
from recorded_arduplane import LINKED_GAINS, LINKED_TUNE, make_linked_airframe
from tables import add_output_arguments, draw, publish, row

import testbed
from testbed.autopilot.parameters import read_params
from testbed.core.records import Array, Event, FbwaCommand, RunInfo, Sample
from testbed.flight import arduplane_vehicles
from testbed.flight.vehicles import JsbsimVehicles
from testbed.mavlink.rc_channels import rc_scaling
from testbed.plan import vehicles as build_vehicles
from testbed.scenario import load_scenario, set_duration
from testbed.vehicle.environment import JSBSIM_DEFAULT_INTEGRATORS
from testbed.vehicle.workers import make_fleet
from testbed.views.panels import BLUE, GREY, ORANGE, Band, Line, Panel, PanelGrid

ROOT = Path(__file__).parent.parent
RECORDING = ROOT / "tests" / "data" / "arduplane_simulation_3.npz"
FIGURE = ROOT / "docs" / "images" / "arduplane.png"
SCENARIO = "simulation-3-30deg"  # the path of the recording
MARK = "make arduplane"
OTHERS_MARK = "make arduplane, others"
PROFILES = ("tuned", "authors", "improved")
# The ArduPlanes were SITL with physics at 200 Hz, which has a gyro filter of 4 Hz.
SITL = tuple(
    f"{key}={value}"
    for key, value in (
        ("scenario.engine", "jsbsim"),  # its integrators are those of the recordings
        ("rates.physics_hz", "200"),
        ("leader.autopilot", "{kind: virtual, gyro_filter: sitl}"),
        ("fleet.*.autopilot", "{kind: virtual, gyro_filter: sitl}"),
    )
)
# The profile `improved` was recorded with other gains than it has now, and is labelled so.
_LABELS = {"improved": "earlier gains of `improved`"}
WINDOWS = {name: tuple(of) for name, of in load_scenario(SCENARIO).scenario.windows.items()}
# Other flights of ArduPlane 4.8.0-dev that are not in the repository: its RMS errors, m.
_BEGIN_S, _END_S = 30.0, 160.0  # of those without windows
_NO_SLEW_LIMITER = "RLL_RATE_SMAX 0\nPTCH_RATE_SMAX 0\n"
_OTHERS = (
    (
        "`simulation-3-recorded-leader` (45 to 50° of bank), earlier gains of `improved`, "
        "three real followers",
        "simulation-3-recorded-leader",
        ("controller.profile=improved",),
        {"rectangles": "0.401 0.796 0.989", "circles": "0.107 0.108 0.103"},
        "",
    ),
    (
        "`turbulence-moderate`, two real followers, one seed",
        "turbulence-moderate",
        (),
        {"30 to 160 s": "3.2 4.4 4.6"},
        "",
    ),
    (
        "the same; virtual autopilots without slew limiter (`RLL_RATE_SMAX` 0, `PTCH_RATE_SMAX` 0)",
        "turbulence-moderate",
        (),
        {"30 to 160 s": "3.2 4.4 4.6"},
        _NO_SLEW_LIMITER,
    ),
)
_LAP_S = (95.0, 205.0)  # shown in the figure
_SHOWN = {"tuned": BLUE, "authors": ORANGE}
_BAND = 0.5  # %


class Flight(NamedTuple):
    """Samples of one flight at the recorded times."""

    time: Array  # (K,) s
    leader: Array  # (K, 3) m, NED
    euler: Array  # (K, 4, 3) rad: roll, pitch, yaw
    error: Array  # (K, 3, 3) m, NED, followers relative to their slots


class _Sampler:
    """Keep the samples at given times."""

    def __init__(self, times: Array) -> None:
        self._times = iter(times)
        self._next = next(self._times)
        self.samples: list[tuple[Array, Array, Array]] = []

    def begin(self, info: RunInfo) -> None:
        """Need nothing of the run."""

    def observe(self, sample: Sample) -> None:
        """Keep a sample whose time has come."""
        if sample.time_s > self._next - 1e-3:
            truth = sample.truth
            self.samples.append((truth.position_ned[0], truth.euler, sample.formation.error_ned))
            self._next = next(self._times, np.inf)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Need nothing of the metrics."""


class PulseVehicles(JsbsimVehicles):
    """Virtual autopilots with the resolution of the link.

    Sticks are whole µs of ArduPlane's default ranges; servo pulses are truncated towards neutral.
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:  # noqa: ANN401
        """See `JsbsimVehicles`."""
        super().__init__(*arguments, **keywords)
        params = read_params(LINKED_TUNE)
        ends = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0}
        ranges = {f"RC{n}_{end}": pulse for n in (1, 2, 3) for end, pulse in ends.items()}
        limits = ("roll_limit_deg", "ptch_lim_max_deg", "ptch_lim_min_deg")
        self._rc = rc_scaling(ranges | {name.upper(): getattr(params, name) for name in limits})
        self.autopilot_steps = (self._step_autopilots,)

    def _step_autopilots(self, now: float) -> None:
        command = self._aircraft["command"]
        exact = command.copy()
        for each in map(command.__getitem__, self.rows):
            roll, pitch, throttle = map(round, self._rc.pulses(FbwaCommand._make(each.item())))
            each["roll"], each["pitch"] = self._rc.roll_angle(roll), self._rc.pitch_angle(pitch)
            each["throttle"] = self._rc.throttle_share(throttle)
        self._fly(now)
        command[:] = exact
        surfaces = self._aircraft["surfaces"]
        for name in ("aileron", "elevator", "rudder"):
            surfaces[name] = np.trunc(500.0 * surfaces[name]) / 500.0
        surfaces["throttle"] = np.trunc(800.0 * surfaces["throttle"]) / 800.0


def recorded(profile: str, end_s: float = np.inf) -> Flight:
    """Read the flight of four ArduPlanes with a profile, up to a time."""
    with np.load(RECORDING) as file:
        data = {name: file[name].astype(np.float64) for name in file.files}
    rows = data["time_s"] <= end_s
    leader = data["leader_euler_rad"][:, np.newaxis]
    euler = np.concatenate((leader, data[f"{profile}_euler_rad"]), axis=1)
    error = data[f"{profile}_error_ned_m"]
    return Flight(
        *(each[rows] for each in (data["time_s"], data["leader_position_ned_m"], euler, error))
    )


def fly_virtual(profile: str, times: Array, *, pulses: bool = False) -> Flight:
    """Fly the recorded path with virtual autopilots.

    Args:
        profile: of the middle loop.
        times: of the samples, s.
        pulses: with the resolution of the link's pulses.
    """
    sampler = _Sampler(times)
    overrides = (f"controller.profile={profile}",)
    vehicles = PulseVehicles if pulses else JsbsimVehicles
    with mock.patch.object(arduplane_vehicles, "JsbsimVehicles", vehicles):
        _fly(SCENARIO, overrides, float(times[-1]), sampler)
    leader, euler, error = (np.array(each) for each in zip(*sampler.samples, strict=True))
    return Flight(times, leader, euler, error)


def _fly(
    scenario: str,
    overrides: Sequence[str],
    end_s: float | None,
    *observers: _Sampler,
    params: str = "",
) -> Mapping[str, Any]:
    """Fly a scenario with airframe and integrators of the recorded flights; return its metrics."""
    recorded_fleet = partial(make_fleet, integrators=JSBSIM_DEFAULT_INTEGRATORS)
    with tempfile.TemporaryDirectory() as folder:
        rascal = make_linked_airframe(Path(folder))
        with (rascal / "autopilot.param").open("a", encoding="utf-8") as tune:
            tune.write(params)
        names = (f"leader.aircraft={rascal}", f"fleet.*.aircraft={rascal}")
        loaded = load_scenario(scenario, [*names, *SITL, *overrides])
        if end_s is not None:
            loaded = set_duration(loaded, end_s)
        with mock.patch.object(build_vehicles, "make_fleet", recorded_fleet):
            return testbed.run(loaded, write=False, observers=observers).metrics


def rms(values: Array) -> Array:
    """Compute the RMS over time of vectors (K, …, 3)."""
    mean: Array = np.mean(np.sum(np.square(values), axis=-1), axis=0)
    return np.sqrt(mean)


def rms_errors(flight: Flight, window: tuple[float, float]) -> Array:
    """Compute the RMS errors of the followers in a window, (3,) m."""
    return rms(flight.error[(flight.time >= window[0]) & (flight.time <= window[1])])


Pairs = Mapping[str, tuple[Flight, Flight]]  # virtual and real, by profile


def table(pairs: Pairs) -> Iterator[str]:
    """Return the rows of the RMS errors of both, and their differences."""
    yield row("profile", "window", "virtual, m", "four ArduPlanes, m", "virtual against real")
    yield "|---|---|---|---|---|"
    for profile, (virtual, real) in pairs.items():
        for name, window in WINDOWS.items():
            ours, theirs = rms_errors(virtual, window), rms_errors(real, window)
            difference = 100.0 * (ours / theirs - 1.0)
            yield row(
                _LABELS.get(profile, f"`{profile}`"),
                name,
                " ".join(f"{each:.3f}" for each in ours),
                " ".join(f"{each:.3f}" for each in theirs),
                " ".join(f"{each:+.1f}" for each in difference) + " %",
            )


def attitude_difference(virtual: Flight, real: Flight) -> Array:
    """Compute the RMS difference of roll, pitch and yaw from 5 s on, (4, 3) deg."""
    difference = virtual.euler - real.euler
    wrapped = (difference + np.pi) % (2.0 * np.pi) - np.pi
    square: Array = np.mean(np.square(wrapped[real.time >= 5.0]), axis=0)
    return np.degrees(np.sqrt(square))


def track_difference(virtual: Flight, real: Flight) -> tuple[Array, Array]:
    """Compute the difference of the leaders along and across the recorded track, (K,) m."""
    velocity = np.gradient(real.leader, real.time, axis=0)
    forward = velocity / np.linalg.norm(velocity, axis=1, keepdims=True)
    difference = virtual.leader - real.leader
    along: Array = np.sum(difference * forward, axis=1)
    return along, np.linalg.norm(difference - along[:, np.newaxis] * forward, axis=1)


def text(pairs: Pairs, with_pulses: Flight) -> str:
    """Return the table as text.

    Args:
        pairs: all profiles.
        with_pulses: the first of them, flown with the pulses of the link.
    """
    attitude = max(float(attitude_difference(*pair).max()) for pair in pairs.values())
    virtual, real = pairs[PROFILES[0]]
    laps = real.time <= WINDOWS["rectangles"][1]
    on_laps = rms(virtual.leader[laps] - real.leader[laps])
    whole, equal = (rms(each.leader - real.leader) for each in (virtual, with_pulses))
    along, _ = track_difference(virtual, real)
    errors = [rms_errors(with_pulses, w) / rms_errors(real, w) - 1.0 for w in WINDOWS.values()]
    return "\n".join(
        [
            *table(pairs),
            "",
            "RMS distance from the slot of uav1, uav2 and uav3 in `simulation-3-30deg`, 1080 s. "
            "The four ArduPlanes were 4.8.0-dev (SITL), one per aircraft, flown through this link "
            "with physics at 200 Hz, where SITL's gyro filter has 4 Hz; the virtual autopilots "
            "have the same (`gyro_filter: sitl`). Their [recording](../tests/data/ORIGIN.md) is in "
            f"the repository. Attitudes differ by at most {attitude:.2f}° RMS after 5 s, the "
            f"leaders on the laps by {on_laps:.2f} m RMS, and in all 1080 s by {whole:.2f} m: "
            f"after 24 km the virtual one is {-along[-1]:.1f} m behind.",
            "",
            "The virtual autopilot takes and gives real numbers. The real one takes sticks in "
            "whole µs, 0.125° of roll, and its servo pulses are truncated to whole µs. With these "
            f"two effects (`{PROFILES[0]}`) the virtual leader is {equal:.2f} m RMS from the real "
            f"one in all 1080 s; RMS errors then differ by at most "
            f"{100 * np.abs(errors).max():.1f} %.",
        ]
    )


def others_text() -> str:
    """Fly the other flights with virtual autopilots, and return their table as text."""
    rows = [row("flight", "window", "virtual, m", "ArduPlane, m"), "|---|---|---|---|"]
    for name, scenario, overrides, real, params in _OTHERS:
        for window, errors in _fly_other(scenario, overrides, list(real), params).items():
            decimals = len(real[window].split()[0]) - 2
            ours = " ".join(f"{each:.{decimals}f}" for each in errors)
            title = name if window == next(iter(real)) else ""
            rows.append(row(title, window, ours, real[window]))
    return "\n".join(rows)


def _fly_other(
    scenario: str, overrides: Sequence[str], windows: Sequence[str], params: str
) -> Mapping[str, Array]:
    """Return the RMS errors of the followers by window, (3,) m."""
    if len(windows) == 1:
        times = np.arange(_BEGIN_S, _END_S, 0.1)
        sampler = _Sampler(times)
        _fly(scenario, overrides, _END_S, sampler, params=params)
        return {windows[0]: rms(np.array([error for _, _, error in sampler.samples]))}
    metrics = _fly(scenario, overrides, None, params=params)["windows"]
    return {name: np.array(list(metrics[name]["rms_m"].values())) for name in windows}


def figure(pairs: Pairs) -> PanelGrid:
    """Return the figure: a lap of both, and the differences of all RMS errors."""
    panels = []
    for profile, colour in _SHOWN.items():
        virtual, real = pairs[profile]
        lap = (real.time >= _LAP_S[0]) & (real.time <= _LAP_S[1])
        size = [np.linalg.norm(each.error[lap, 2], axis=1) for each in (real, virtual)]
        lines = [
            Line(real.time[lap], size[0], GREY, "four real ArduPlanes", 4.0),
            Line(real.time[lap], size[1], colour, f"virtual autopilots, {profile}", 1.2),
        ]
        panels.append(
            Panel(f"uav3, profile {profile}", "time, s", "distance from the slot, m", lines)
        )
    ends = np.array([0.15, 3.0])
    band = Band(ends, np.full(2, -_BAND), np.full(2, _BAND), GREY, f"± {_BAND:g} %")
    dots = []
    for profile, colour in _SHOWN.items():
        virtual, real = pairs[profile]
        x = np.concatenate([rms_errors(real, window) for window in WINDOWS.values()])
        y = np.concatenate([rms_errors(virtual, window) for window in WINDOWS.values()])
        dots.append(Line(x, 100.0 * (y / x - 1.0), colour, width=5.0, dots=True))
    ticks = [(each, f"{each:g}") for each in (0.2, 0.5, 1.0, 2.0)]
    panels.append(
        Panel(
            "RMS errors, both windows, three followers",
            "RMS of four ArduPlanes, m",
            "virtual against real, %",
            dots,
            [band],
            x_log=True,
            y_limits=(-5.0, 5.0),
            x_limits=(0.15, 3.0),
            x_ticks=ticks,
        )
    )
    return PanelGrid(
        f"Four real ArduPlanes and the virtual autopilot: RMS within {_BAND:g} %",
        "Simulation 3 with corners of 30° of bank: ArduPlane 4.8.0-dev (SITL, physics at 200 Hz, "
        "gyro filter of 4 Hz) in every aircraft, and virtual autopilots with that filter",
        [panels],
        [1.0, 1.0, 1.0],
        (16.0, 5.6),
    )


_FILES = tuple(
    each.relative_to(ROOT).as_posix()
    for each in (RECORDING, LINKED_TUNE, LINKED_GAINS, ROOT / "aircraft/rascal110/rascal110.xml")
)
INPUTS = {
    MARK: Inputs((Case(SCENARIO, SITL),), files=_FILES),
    OTHERS_MARK: Inputs(
        tuple(Case(scenario, overrides) for _, scenario, overrides, *_ in _OTHERS), files=_FILES
    ),
}


def main() -> None:
    """Fly the profiles, draw the figure, and print or insert the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser)
    options = parser.parse_args()
    pairs = {}
    for profile in PROFILES:
        real = recorded(profile)
        pairs[profile] = fly_virtual(profile, real.time), real
    draw(figure(pairs), FIGURE)
    real = pairs[PROFILES[0]][1]
    parts = {
        MARK: text(pairs, fly_virtual(PROFILES[0], real.time, pulses=True)),
        OTHERS_MARK: others_text(),
    }
    sys.exit(0 if publish(options, parts, INPUTS) else 1)


if __name__ == "__main__":
    main()
