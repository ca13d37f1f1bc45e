"""A scenario's flights against its golden table: structure first, then values, then offenders."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from testbed.metrics.document import errors
from testbed.study.flights import Flight
from testbed.study.golden_band import prediction_band
from testbed.study.golden_page import differences, spelt_out
from testbed.study.golden_table import Rule, Table, measure, metric_names


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that is wrong with a flight, or with what the flights have; seed None: all."""

    seed: int | None
    text: str

    def __str__(self) -> str:
        """On one line."""
        return self.text if self.seed is None else f"seed {self.seed}: {self.text}"


@dataclass(frozen=True, slots=True)
class Offence:
    """A number outside what it is held to: one seed's, or the mean of several."""

    key: str
    seeds: tuple[int, ...]
    now: float
    low: float
    high: float
    better: bool

    @property
    def outside(self) -> float:
        """Distance from the middle in half-widths: above 1, and the larger the worse."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        return abs(self.now - middle) / half


@dataclass(frozen=True, slots=True)
class Comparison:
    """One row of the table beside what was flown."""

    key: str
    rule: Rule
    seeds: tuple[int, ...]  # that have a number
    golden: float  # mean over the seeds that both have; else over all that the table has
    now: float | None  # mean over the seeds that both have; else over the others; None: no number
    band: tuple[float, float] | None
    missing: bool
    offences: tuple[Offence, ...]

    @property
    def passed(self) -> bool:
        """Whether it holds; a row without a sound flight is a matter of the flights."""
        return not self.missing and not self.offences

    @property
    def inside_band(self) -> bool:
        """Whether the mean of what was flown is where one more seed might be."""
        if self.band is None or self.now is None:
            return False
        return self.band[0] <= self.now <= self.band[1]


@dataclass(frozen=True, slots=True)
class Verdict:
    """All that a comparison found."""

    name: str  # of the scenario as it was given
    table: Table
    seeds: tuple[int, ...]
    wall_s: float
    changes: tuple[str, ...]  # of the page and its files
    versions: tuple[str, ...]  # that differ
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    rows: tuple[Comparison, ...]

    @property
    def passed(self) -> bool:
        """Whether the flights are those of the table."""
        return not self.faults and all(row.passed for row in self.rows)

    @property
    def offences(self) -> list[Offence]:
        """Of all rows, the farthest outside first."""
        found = [offence for row in self.rows for offence in row.offences]
        return sorted(found, key=lambda each: (-each.outside, each.key, each.seeds))


def faults_of(flight: Flight) -> list[Fault]:
    """Why a flight cannot be compared: not flown to its end, never engaged, a window not covered.

    A formation that never forms gives numbers too, and they may even repeat.
    """
    if flight.metrics is None:
        return [Fault(flight.seed, flight.problem)]
    metrics = flight.metrics
    if metrics["outcome"] != "flown":
        why = "".join(f"; {what}" for _, what in errors(metrics)[:3])
        text = f"{metrics['outcome']} at {metrics['simulated_s']:g} s{why}"
        return [Fault(flight.seed, text)]
    never = [name for name, at in metrics["engaged_at_s"].items() if at is None]
    faults = []
    if never:
        faults.append(Fault(flight.seed, f"the formation never engaged: {', '.join(never)}"))
    for name, portion in metrics["portions"].items():
        if not portion["complete"]:
            start, end = portion["window_s"]
            text = f"portion {name} covers {portion['covered_s']:g} s of {end - start:g} s"
            faults.append(Fault(flight.seed, text))
    return faults


def compare(
    name: str,
    table: Table,
    flights: Sequence[Flight],
    *,
    page: Mapping[str, Any],
    files: Mapping[str, str],
) -> Verdict:
    """Hold flights of a scenario to its table.

    A seed that the table has is held to its own number there. Other seeds of a table with dice
    are held to the band, one by one and in the mean.

    Args:
        name: the scenario as it was given.
        table: what it is held to.
        flights: one per seed.
        page: as `page_kept` has it, to name what changed.
        files: as `digests` has them.
    """
    faults = [fault for flight in flights for fault in faults_of(flight)]
    unsound = {fault.seed for fault in faults}
    sound = {
        flight.seed: flight.metrics
        for flight in flights
        if flight.metrics is not None and flight.seed not in unsound
    }
    rows = {seed: measure(metrics) for seed, metrics in sound.items()}
    notes: list[str] = []
    if sound:
        structure, notes = _structure(table, list(sound.values()))
        faults += [Fault(None, text) for text in structure]
    running: Mapping[str, str] = next(
        (flight.metrics["versions"] for flight in flights if flight.metrics), {}
    )
    return Verdict(
        name=name,
        table=table,
        seeds=tuple(flight.seed for flight in flights),
        wall_s=sum(flight.wall_s for flight in flights),
        changes=(*differences(spelt_out(table.page), page), *_files(table.files, files)),
        versions=differences(table.versions, running) if running else (),
        faults=tuple(faults),
        notes=tuple(notes),
        rows=tuple(_row(table, key, rows) for key in table.rows),
    )


def _files(then: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    """Files that are not what they were; digests themselves say nothing to a reader."""
    lines = []
    for name in dict.fromkeys((*then, *now)):
        if name not in now:
            lines.append(f"file {name} is gone")
        elif name not in then:
            lines.append(f"file {name} is new")
        elif then[name] != now[name]:
            lines.append(f"file {name} has another content")
    return tuple(lines)


def _structure(table: Table, flown: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """What is missing or new beside the table, from the coarse to the fine; and mere notes."""
    faults: list[str] = []
    explained: set[str] = set()
    keys = list(dict.fromkeys(key for metrics in flown for key in measure(metrics)))
    for what, level in (("portion", 1), ("follower", 2)):
        then, now = _parts(table.rows, level), _parts(keys, level)
        for name in (*(n for n in then if n not in now), *(n for n in now if n not in then)):
            faults.append(f"{what} {name} is {'missing' if name in then else 'new'}")
            explained.add(name)
    for key in (*table.rows, *keys):
        if (key in table.rows) != (key in keys) and not explained & set(key.split("/")):
            faults.append(f"number {key} is {'missing' if key in table.rows else 'new'}")
    if not table.random and any(measure(each) != measure(flown[0]) for each in flown):
        faults.append("the seed moves the numbers, which it did not for the table")
    names = metric_names(flown[0])
    faults += [f"metric {name} is missing" for name in table.metrics if name not in names]
    notes = [f"metric {name} is new" for name in names if name not in table.metrics]
    return list(dict.fromkeys(faults)), notes


def _parts(keys: Sequence[str] | Mapping[str, Any], level: int) -> list[str]:
    """Portions (1) or followers (2) among the rows of RMS errors, in their order."""
    split = [key.split("/") for key in keys if key.startswith("rms_m/")]
    return list(dict.fromkeys(parts[level] for parts in split))


def _row(table: Table, key: str, flown: Mapping[int, Mapping[str, float | None]]) -> Comparison:
    rule, row = table.rules[key.split("/")[0]], table.rows[key]
    values = {seed: value for seed, rows in flown.items() if (value := rows.get(key)) is not None}
    kept = {seed: table.same_seed(key, seed) for seed in values}
    golden = {seed: value for seed, value in kept.items() if value is not None}
    offences = []
    for seeds in _alike(table, values, golden):
        value = golden[seeds[0]]
        bounds = value - rule.allowed(value), value + rule.allowed(value)
        offences += _offence(key, rule, seeds, values[seeds[0]], bounds)
    unseen = tuple(seed for seed in values if seed not in golden)
    if row.band:
        for seed in unseen:
            offences += _offence(key, rule, (seed,), values[seed], row.band)
        if len(unseen) > 1:
            bounds = prediction_band(
                row.by_seed,
                false_alarm=table.band.false_alarm,
                least=rule.allowed(statistics.fmean(row.by_seed)),
                of=len(unseen),
            )
            mean = statistics.fmean(values[seed] for seed in unseen)
            offences += _offence(key, rule, unseen, mean, bounds)
    # the same seeds on both sides, unless only seeds that the table has not went astray
    astray = {seed for offence in offences for seed in offence.seeds}
    paired = tuple(golden) if golden and not (astray and astray.isdisjoint(golden)) else ()
    shown = paired or unseen
    return Comparison(
        key=key,
        rule=rule,
        seeds=tuple(values),
        golden=statistics.fmean([golden[seed] for seed in paired] or row.by_seed),
        now=statistics.fmean([values[seed] for seed in shown]) if shown else None,
        band=row.band,
        missing=bool(flown) and not values,
        offences=tuple(offences),
    )


def _alike(
    table: Table, values: Mapping[int, float], golden: Mapping[int, float]
) -> list[tuple[int, ...]]:
    """Seeds to be judged one by one, or all at once where they gave one and the same number."""
    if not table.random and golden and len(set(values.values())) == 1:
        return [tuple(golden)]
    return [(seed,) for seed in golden]


def _offence(
    key: str, rule: Rule, seeds: tuple[int, ...], now: float, band: tuple[float, float]
) -> list[Offence]:
    """One offence, or none. The bounds belong to the band, whatever the last digit does."""
    low, high = band
    slack = 1e-9 * max(abs(low), abs(high))
    if low - slack <= now <= high + slack and math.isfinite(now):
        return []
    return [Offence(key, seeds, now, low, high, (now < low) == (rule.better == "lower"))]
