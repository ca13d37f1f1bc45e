"""A flown run as labelled arrays: every number of its log under a name that says its unit."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from testbed.record.messages import FIXED32, TOPICS
from testbed.record.read import Log, read_log
from testbed.record.rundir import find_run
from testbed.state import Array, Event, RunInfo

if TYPE_CHECKING:
    import pandas
    import xarray

# The last word of a name says its unit; names that end in no such word are of plain numbers.
UNITS: Mapping[str, str] = {
    "m": "m",
    "mps": "m/s",
    "mps2": "m/s²",
    "rad": "rad",
    "radps": "rad/s",
    "rps": "1/s",
    "s": "s",
    "v": "V",
}
Numbers = NDArray[Any]
MOST_ALIKE = 5  # names that are offered in the place of one that is none


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of each aircraft, or of each aircraft about each other, at every frame."""

    name: str  # topic and field of the log: formation_error_north_m
    unit: str  # "" of a plain number
    source: str  # path from Log
    component: int | None  # of the array there; None: it has none
    followers_only: bool  # the leader has none
    about_each: bool  # a number for every aircraft
    whole: bool  # a count or a set of bits


def _quantities() -> dict[str, Quantity]:
    found = {}
    for topic in TOPICS:
        for column in topic.columns:
            for i, field in enumerate(column.names):
                twice = field.startswith(f"{topic.name}_")  # the same word
                name = field if twice else f"{topic.name}_{field}"
                found[name] = Quantity(
                    name=name,
                    unit=UNITS.get(field.rpartition("_")[2], ""),
                    source=column.source,
                    component=i if len(column.names) > 1 else None,
                    followers_only=topic.followers_only,
                    about_each=column.per_aircraft,
                    whole=column.type == FIXED32,
                )
    return found


QUANTITIES: Mapping[str, Quantity] = _quantities()


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """A flown run in a notebook.

    `flight["state_roll_rad"]` is an array (K, N): K frames at `time_s` of N aircraft in the order
    of `names`, the leader first; `keys()` are all such names, a topic of the log and its field.
    What is about each aircraft, as `formation_age_s`, is (K, N, N). The leader's rows are not a
    number, or zero in whole numbers, where only followers have any.

    `log` has the same as the records that controllers see: `flight.log.formation.error_ned` is
    (K, n, 3).
    """

    log: Log

    def __repr__(self) -> str:
        """Which run it is and how it ended."""
        kinds = ", ".join(dict.fromkeys(self.info.aircraft))
        outcome = str(self.metrics["outcome"]) if self.metrics else "cut short"
        return f"<Flight of {self.info.scenario_name}: {self.log.size} ({kinds}); {outcome}>"

    @property
    def info(self) -> RunInfo:
        """What was known before the first frame: names, bounds, seed, versions."""
        return self.log.info

    @property
    def names(self) -> tuple[str, ...]:
        """N aircraft, the leader first."""
        return self.log.info.names

    @property
    def time_s(self) -> Array:
        """(K,) of each frame."""
        return self.log.time_s

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened, in order."""
        return self.log.events

    @property
    def metrics(self) -> Mapping[str, Any] | None:
        """The document of metrics.json without wall-clock times; None if the run was cut short."""
        return self.log.metrics

    def keys(self) -> tuple[str, ...]:
        """The names of all quantities."""
        return tuple(QUANTITIES)

    def __getitem__(self, name: str) -> Numbers:
        """The numbers of a quantity (K, N), or (K, N, N) where it is about each aircraft.

        Raises:
            KeyError: no quantity is called that; says which are called alike.
        """
        if name not in QUANTITIES:
            alike = difflib.get_close_matches(name, QUANTITIES, n=3)
            alike += [each for each in QUANTITIES if name and name in each and each not in alike]
            alike = alike[:MOST_ALIKE]
            hint = f"; did you mean {', '.join(alike)}?" if alike else "; keys() lists them"
            raise KeyError(f"{name}{hint}")
        return self.of(QUANTITIES[name])

    def of(self, quantity: Quantity, rows: slice = slice(None)) -> Numbers:
        """The numbers of a quantity in some of the frames."""
        values: Numbers = attrgetter(quantity.source)(self.log)[rows]
        if quantity.component is not None:
            values = values[..., quantity.component]
        if quantity.source.startswith("links."):
            # until the log begins to tell of messages it has none, not none that were sent
            told = self.log.links.sent[rows].any(axis=(1, 2), keepdims=True)
            values = np.where(told, values, np.nan)
        if not quantity.followers_only:
            return values
        nothing = 0 if values.dtype.kind in "ub" else np.nan
        out = np.full((len(values), len(self.names), *values.shape[2:]), nothing, values.dtype)
        out[:, 1:] = values
        return out

    def facts(self) -> dict[str, str]:
        """What tells this run from others, as texts: the page, and JSON of the rest."""
        log = self.log
        return {
            "run.json": json.dumps({**log.metadata, "names": self.names, "finished": log.finished}),
            "scenario.resolved.yaml": log.info.scenario_yaml,
            "metrics.json": json.dumps(log.metrics, ensure_ascii=False),
            "events.json": json.dumps([asdict(each) for each in log.events], ensure_ascii=False),
        }

    def to_pandas(self) -> pandas.DataFrame:
        """A table with one row for each frame and aircraft; needs pandas.

        The index is time_s and aircraft, the columns are those of `testbed export`.
        """
        from testbed.record.arrow_door import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> xarray.Dataset:
        """A dataset over time_s and aircraft, with units; needs xarray."""
        import xarray

        names = list(self.names)
        variables = {
            each.name: (
                ("time_s", "aircraft", "other") if each.about_each else ("time_s", "aircraft"),
                self.of(each),
                {"units": each.unit} if each.unit else {},
            )
            for each in QUANTITIES.values()
        }
        places = {"time_s": self.time_s, "aircraft": names, "other": names}
        return xarray.Dataset(variables, coords=places, attrs=self.facts())


def load(run: str | Path) -> Flight:
    """Read a run back: its directory, its .mcap file, or a scenario's name for its latest run.

    Of a run that was killed, everything up to then.

    Raises:
        LogError: there is no such run, or its log is damaged before its end.
    """
    return Flight(read_log(find_run(run)))
