"""Write the tables of docs/faults.md: responses to an engine failure, faults, a blocked pitot tube.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from inputs import Case, Inputs
from tables import COMMAND, OUTCOMES, Metrics, row, write_tables

ENGINE_OUT, PITOT = "engine-out-uav2", "airspeed-blocked"
RESPONSE = "formation.on_failure.response"
FAULTS = "fleet.uav2.faults"
PIXHAWK = ("leader.sensors=pixhawk", "fleet.*.sensors=pixhawk")
NONE = f"{FAULTS}=[]"
WINDOWS = ("glide", "after")
CLOSE_M = 5.0  # of pairs that are named

RESPONSES = {
    "no fault, `fleet.uav2.faults=[]`": (NONE,),
    "`ignore`": (f"{RESPONSE}=ignore",),
    "`drop`": (f"{RESPONSE}=drop",),
    "`reassign-slots`": (f"{RESPONSE}=reassign-slots",),
}
RESPONDED = {label: Case(ENGINE_OUT, keys) for label, keys in RESPONSES.items()}
MEMBERS = ("drop", "reassign-slots")  # responses that leave the aircraft out
TIMES_S = (95, 110, 120, 130, 140, 155, 175, 200)
AT_TIMES = {
    (response, at_s): Case(
        ENGINE_OUT,
        (f"{RESPONSE}={response}", f"{FAULTS}=[{{kind: engine-out, at_s: {at_s}}}]"),
    )
    for response in MEMBERS
    for at_s in TIMES_S
}
SEEDS = (1, 2, 3, 4)
LOSSY = {
    (response, seed): Case(
        ENGINE_OUT,
        (f"{RESPONSE}={response}", *PIXHAWK, "network.loss=0.3", f"scenario.seed={seed}"),
    )
    for response in MEMBERS
    for seed in SEEDS
}

# fault of UAV 2 from 125 s on, sensors, and what the numbers do not tell
KINDS: Sequence[tuple[str, bool, str]] = (
    ("", False, ""),
    ("thrust-loss, remaining: 0.75", False, "compensated by throttle"),
    ("thrust-loss, remaining: 0.5", False, ""),
    ("thrust-loss, remaining: 0.4", False, ""),
    ("surface-stuck, surface: rudder, position: 0.2", False, ""),
    ("surface-stuck, surface: aileron", False, "flies off"),
    ("surface-stuck, surface: elevator", False, ""),
    ("surface-floating, surface: aileron", False, "flies off"),
    ("surface-floating, surface: elevator", False, ""),
    ("autopilot-frozen, duration_s: 2", False, "on a straight"),
    ("autopilot-frozen, duration_s: 10", False, "misses a corner"),
    ("transmitter-off", False, "left out after 5 s"),
    ("airspeed-blocked", False, "level flight"),
    ("airspeed-blocked, drain: open", False, "full throttle"),
    ("", True, ""),
    ("gps-lost, duration_s: 60", True, ""),
    ("gps-lost", True, ""),
    ("gps-jump, offset_m: [0, 3, 0]", True, "accepted, unnoticed"),
    ("gps-jump, offset_m: [0, 20, 0]", True, "refused for 10 s, then accepted"),
)


def faulty(kind: str, pixhawk: bool) -> Case:
    """Return the flight with a fault of UAV 2, and response `drop`."""
    fault = f"{FAULTS}=[{{kind: {kind}, at_s: 125}}]" if kind else NONE
    return Case(ENGINE_OUT, (f"{RESPONSE}=drop", fault, *(PIXHAWK if pixhawk else ())))


COMPARED = {(kind, pixhawk): faulty(kind, pixhawk) for kind, pixhawk, _ in KINDS}
LEADERS = "leader.faults=[{{kind: airspeed-blocked{}, at_s: 105}}]"
OPEN = f"{FAULTS}=[{{kind: airspeed-blocked, drain: open, at_s: 105}}]"
BLOCKED = {
    "none": Case(PITOT, (NONE,)),
    "UAV 2's, the scenario": Case(PITOT),
    "UAV 2's, `formation.speed_mps=[16, 40]`": Case(PITOT, ("formation.speed_mps=[16, 40]",)),
    "UAV 2's, all on `sensors: pixhawk`": Case(PITOT, PIXHAWK),
    "UAV 2's, `drain: open`": Case(PITOT, (OPEN,)),
    "the leader's": Case(PITOT, (NONE, LEADERS.format(""))),
    "the leader's, `drain: open`": Case(PITOT, (NONE, LEADERS.format(", drain: open"))),
}


def number(value: float | None, digits: int | None = None) -> str:
    """Return an error as text, m; with fewer digits from 2 m and from 10 m on."""
    if value is None:
        return "–"
    if digits is None:
        digits = 0 if value >= 10.0 else 1 if value >= 2.0 else 2
    return f"{value:.{digits}f}"


def error(flight: Metrics, window: str, name: str) -> float | None:
    """Return the RMS error of a follower in a window, m; None: lost before its end."""
    value: float | None = flight["windows"][window]["rms_m"][name]
    return value


def uav(name: str) -> str:
    """Return the name of an aircraft as in the text."""
    return name.replace("uav", "UAV ").replace("leader", "the leader")


def lost(flight: Metrics) -> float:
    """Return when UAV 2 was lost, s; NaN: it was not."""
    at_s: float | None = flight["lost_at_s"]["uav2"]
    return math.nan if at_s is None else at_s


def response_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of the responses to the engine failure, and sentences on them."""
    yield row(
        *("response", "UAV 3 while UAV 2 glides (145–215 s), RMS", "at most"),
        *("UAV 3 afterwards (250–360 s), RMS", "at most"),
    )
    yield "|---|--:|--:|--:|--:|"
    for label, case in RESPONDED.items():
        parts = [flown[case]["windows"][name] for name in ("glide", "after")]
        cells = [
            f"{number(value)} m"
            for part in parts
            for value in (part["rms_m"]["uav3"], part["max_error_m"]["uav3"])
        ]
        yield row(label, *cells)
    ignore, drop, reassign = (flown[RESPONDED[f"`{each}`"]] for each in ("ignore", *MEMBERS))
    least = min(flight["min_separation_m"] for flight in (ignore, drop, reassign))
    closest = next(each for each in (ignore, drop, reassign) if each["min_separation_m"] == least)
    pair = " and ".join(uav(name) for name in closest["min_separation_between"])
    yield ""
    yield (
        f"UAV 2 is lost at {lost(ignore):.1f} s with `ignore`, at {lost(drop):.1f} s with `drop` "
        f"and at {lost(reassign):.1f} s with `reassign-slots`. With `ignore` it is "
        f"{error(ignore, 'glide', 'uav2'):.0f} m RMS from its slot as it glides. The smallest "
        f"separation is {least:.1f} m, between {pair}."
    )
    times = [flown[case] for case in AT_TIMES.values()]
    ground = [lost(flight) - at_s for (_, at_s), flight in zip(AT_TIMES, times, strict=True)]
    after = [error(flight, "after", "uav3") or 0.0 for flight in times]
    noisy = [flown[case] for case in LOSSY.values()]
    errors = [error(flight, "after", "uav3") or 0.0 for flight in noisy]
    yield ""
    yield (
        f"Engine failures at {TIMES_S[0]} to {TIMES_S[-1]} s, {len(TIMES_S)} times, with `drop` "
        f"and `reassign-slots`: UAV 2 is on the ground {min(ground):.0f} to {max(ground):.0f} s "
        f"later, and UAV 3's RMS error afterwards is {spread(after)} m. With `sensors: pixhawk` on "
        f"all aircraft and 30 % of the messages lost, seeds {SEEDS[0]} to {SEEDS[-1]}, it is "
        f"{spread(errors)} m, and "
        f"{min(flight['min_separation_m'] for flight in noisy):.1f} m the smallest separation."
    )


def spread(values: Sequence[float]) -> str:
    """Return the smallest and the largest value as text, m."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def notes(flight: Metrics, more: str) -> str:
    """Return what else happens in a flight as text."""
    found = [more]
    gone = [(name, at_s) for name, at_s in flight["lost_at_s"].items() if at_s is not None]
    largest = flight["windows"]["glide"]["max_error_m"]["uav2"]
    rms = error(flight, "glide", "uav2")
    if not gone and largest is not None and rms is not None and 0.5 < rms < 5.0:
        found.append(f"at most {number(largest)} m")
    if gone:
        found.append(" and ".join(f"{uav(name)} lost at {at_s:.0f} s" for name, at_s in gone))
    if flight["min_separation_m"] < CLOSE_M:
        pair = " and ".join(uav(name) for name in flight["min_separation_between"])
        found.append(f"{pair} {flight['min_separation_m']:.1f} m apart")
    if flight["outcome"] != "completed":
        found.append(f"`{flight['outcome']}`, exit code 1")
    return "; ".join(filter(None, found))


def fault_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of the faults of UAV 2."""
    yield row("fault of UAV 2", "UAV 2", "later", "UAV 3", "later", "")
    yield "|---|--:|--:|--:|--:|---|"
    for kind, pixhawk, more in KINDS:
        flight = flown[COMPARED[kind, pixhawk]]
        cells = [
            number(error(flight, window, name)) for name in ("uav2", "uav3") for window in WINDOWS
        ]
        label = f"`{kind}`" if kind else "none, `pixhawk`" if pixhawk else "none"
        yield row(label, *cells, notes(flight, more))
    others = {
        tuple(number(error(flown[faulty(kind, False)], window, "uav1")) for window in WINDOWS)
        for kind, pixhawk, _ in KINDS
        if not pixhawk
    }
    yield ""
    cells = ", or ".join(" and ".join(each) for each in sorted(others))
    yield f"The errors of UAV 1 are {cells} m with every fault without `pixhawk`."


def blocked_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of a blocked pitot tube."""
    followers = ("uav1", "uav2", "uav3")
    heads = "lower, UAV 1", "UAV 2", "UAV 3", "upper, UAV 1", "UAV 2", "UAV 3"
    yield row("blocked tube", *heads)
    yield "|---|" + "--:|" * 6
    for label, case in BLOCKED.items():
        cells = [
            number(error(flown[case], window, name))
            for window in ("low", "high")
            for name in followers
        ]
        yield row(label, *cells)
    gone: list[Any] = [
        (name, at_s)
        for name, at_s in flown[BLOCKED["the leader's, `drain: open`"]]["lost_at_s"].items()
        if at_s is not None
    ]
    if gone:
        names = " and ".join(uav(name) for name, _ in gone)
        yield ""
        yield f"Behind the leader with `drain: open`, {names} are lost at {gone[0][1]:.1f} s."


INPUTS = {
    f"{COMMAND}, engine out": Inputs((*RESPONDED.values(), *AT_TIMES.values(), *LOSSY.values())),
    f"{COMMAND}, faults compared": Inputs(tuple(COMPARED.values())),
    f"{COMMAND}, pitot tube": Inputs(tuple(BLOCKED.values())),
}
TEXTS = {
    mark: (lambda flown, lines=lines: list(lines(flown)))
    for mark, lines in zip(INPUTS, (response_table, fault_table, blocked_table), strict=True)
}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, TEXTS, (*OUTCOMES, "lost"))
