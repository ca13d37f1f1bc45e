"""A recorded run as named arrays, for notebooks and exports."""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from operator import attrgetter
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.errors import needs_extra
from testbed.core.flags import flag_names
from testbed.core.records import Array, BoolArray, Event, RunInfo
from testbed.logs.messages import Quantity, quantities_of
from testbed.logs.read import RunLog, read_log
from testbed.logs.run_directory import METRICS_NAME, SCENARIO_NAME, find_run
from testbed.scenario.arguments import check_path

if TYPE_CHECKING:  # the package loads compiled functions, which a reader of logs does not need
    from testbed.metrics.model import Metrics

if TYPE_CHECKING:
    import pandas
    import xarray

Numbers = NDArray[Any]
TABLE_ROWS = 65_536  # in memory at once, and in a row group of Parquet
MAX_SUGGESTIONS = 5  # in place of an unknown name


@dataclass(frozen=True, slots=True, eq=False)
class FlightData:
    """A recorded run.

    `flight["state_roll_rad"]` is an array (K, N): K samples at `time_s` of N aircraft in the order
    of `names`, the leader first. `keys()` lists the names; a name is a topic of the log and a field
    in it. Quantities about each aircraft, as `formation_age_s`, are (K, N, N). Where only
    followers have a value, the leader's row is NaN, or 0 in integers.

    `log` has the same numbers as the records that controllers see: `flight.log.formation.error_ned`
    is (K, n, 3).
    """

    log: RunLog

    def __repr__(self) -> str:
        """Name the run and its size, with its RMS errors unless it was cut short."""
        kinds = ", ".join(dict.fromkeys(self.info.aircraft))
        line = f"FlightData of {self.info.scenario_name}: {self.log.size} ({kinds})"
        metrics = self.metrics
        if metrics is None or "windows" not in metrics:
            outcome = metrics.get("outcome", "cut short") if metrics else "cut short"
            return f"<{line}; {outcome}>"
        from testbed.metrics.printed_tables import table_text

        return f"{line}\n{table_text(metrics)}"

    def _repr_html_(self) -> str:
        """Show the same in a notebook."""
        from html import escape

        from testbed.metrics.printed_tables import table_html

        line, *rest = repr(self).splitlines()
        table = table_html(self.metrics) if self.metrics and rest else ""
        return f"<p>{escape(line)}</p>{table}"

    @property
    def info(self) -> RunInfo:
        """What is known before the first sample: names, bounds, seed, versions."""
        return self.log.info

    @property
    def names(self) -> tuple[str, ...]:
        """N aircraft, the leader first."""
        return self.log.info.names

    @property
    def time_s(self) -> Array:
        """(K,) of each sample."""
        return self.log.time_s

    @property
    def events(self) -> tuple[Event, ...]:
        """The events of the run, in order."""
        return self.log.events

    @property
    def metrics(self) -> Metrics | None:
        """The content of metrics.json without wall-clock times; None if the run was cut short."""
        return self.log.metrics

    @property
    def quantities(self) -> Mapping[str, Quantity]:
        """The quantities of the log by name: those of each log, and numbers that a law logs."""
        return quantities_of(self.info.law_numbers)

    def keys(self) -> tuple[str, ...]:
        """List the names of all quantities."""
        return tuple(self.quantities)

    def __getitem__(self, name: str) -> Numbers:
        """Return a quantity (K, N), or (K, N, N) if it is about each aircraft.

        Raises:
            KeyError: No quantity has this name; suggests similar ones.
        """
        known = self.quantities
        if name not in known:
            similar = difflib.get_close_matches(name, known, n=3)
            similar += [key for key in known if name and name in key and key not in similar]
            similar = similar[:MAX_SUGGESTIONS]
            hint = f"; did you mean {', '.join(similar)}?" if similar else "; keys() lists them"
            raise KeyError(f"{name}{hint}")
        return self.values(known[name])

    def values(self, quantity: Quantity, rows: slice = slice(None)) -> Numbers:
        """Return some samples of a quantity."""
        values: Numbers = quantity.of(attrgetter(quantity.source)(self.log)[rows])
        if quantity.source.startswith("links."):
            # before the log counts messages their number is unknown, not zero
            counted = self.log.links.sent[rows].any(axis=(1, 2), keepdims=True)
            values = np.where(counted, values, np.nan)
        if not quantity.followers_only:
            return values
        no_value = 0 if values.dtype.kind in "ub" else np.nan
        out = np.full((len(values), len(self.names), *values.shape[2:]), no_value, values.dtype)
        out[:, 1:] = values
        return out

    def flags(self, name: str) -> dict[str, BoolArray]:
        """Return where the bits of a quantity are set, (K, N) by the name of each bit.

        Raises:
            KeyError: no quantity has this name, or it is a number.
        """
        values, bits = self[name], self.quantities[name].bits
        if bits is None:
            sets = ", ".join(each.name for each in self.quantities.values() if each.bits)
            raise KeyError(f"{name} is a number, without bits; {sets} have some")
        return {
            text: (values & flag) != 0 for flag, text in zip(bits, flag_names(bits), strict=True)
        }

    def documents(self) -> dict[str, str]:
        """Return the texts that exports carry: the scenario, and JSON of run, metrics, events."""
        log = self.log
        return {
            "run.json": json.dumps({**log.metadata, "names": self.names, "finished": log.finished}),
            SCENARIO_NAME: log.info.scenario_yaml,
            METRICS_NAME: json.dumps(log.metrics, ensure_ascii=False),
            "events.json": json.dumps([asdict(each) for each in log.events], ensure_ascii=False),
        }

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with one row for each sample and aircraft; needs pandas.

        The index is time_s and aircraft, the columns are those of `testbed export`.
        """
        with needs_extra("notebook", "to_pandas"):
            import pandas

        index = [self.time_s, list(self.names)]
        columns = {}
        for quantity in self.quantities.values():
            values = self.values(quantity)
            if quantity.followers_only and values.dtype.kind == "u":
                values = values.astype(np.float64)
                values[:, 0] = np.nan
            names = quantity.columns(self.names)
            for k, name in enumerate(names):
                of_column = values[..., k] if quantity.per_aircraft else values
                columns[name] = of_column.reshape(-1)
        rows = pandas.MultiIndex.from_product(index, names=["time_s", "aircraft"])
        return pandas.DataFrame(columns, index=rows)

    def to_xarray(self) -> xarray.Dataset:
        """Return a dataset over time_s and aircraft, with units; needs xarray."""
        with needs_extra("notebook", "to_xarray"):
            import xarray

        names = list(self.names)
        variables = {
            each.name: (
                ("time_s", "aircraft", "other") if each.per_aircraft else ("time_s", "aircraft"),
                self.values(each),
                ({"units": each.unit} if each.unit else {}) | each.flag_attributes,
            )
            for each in self.quantities.values()
        }
        coordinates = {"time_s": self.time_s, "aircraft": names, "other": names}
        return xarray.Dataset(variables, coords=coordinates, attrs=self.documents())


def load_run(run: str | os.PathLike[str]) -> FlightData:
    """Load a run by directory, .mcap file, or scenario (its latest run).

    A run that was killed is read up to its last complete chunk.

    Raises:
        LogError: There is no such run, or its log is damaged before its end.
        InputError: `run` is no path.
    """
    return FlightData(read_log(find_run(check_path("run", run))))


Part = tuple[Array, NDArray[np.int32], list[tuple[Numbers, BoolArray]]]


def table_parts(flight: FlightData) -> Iterator[Part]:
    """Make a table with a row per sample and aircraft, in parts that fit into memory.

    Yields:
        At least one part of r rows, which may be none: times (r,) s, aircraft (r,) as rows of
        `FlightData.names`, and of each further column the values (r,) and where there is none (r,).
    """
    count = len(flight.names)
    step = max(1, TABLE_ROWS // count)
    for start in range(0, max(1, flight.time_s.size), step):
        rows = slice(start, start + step)
        time_s = flight.time_s[rows]
        aircraft = np.tile(np.arange(count, dtype=np.int32), time_s.size)
        columns = []
        for each in flight.quantities.values():
            values = flight.values(each, rows)
            absent = aircraft == 0 if each.followers_only else np.zeros(aircraft.size, dtype=bool)
            for other in range(count if each.per_aircraft else 1):
                column = (values[..., other] if each.per_aircraft else values).reshape(-1)
                missing = absent | np.isnan(column) if column.dtype.kind == "f" else absent
                if each.integer and each.source != "lost":
                    column = np.where(missing, 0, column).astype(np.uint32)
                columns.append((column, missing))
        yield np.repeat(time_s, count), aircraft, columns


def write_csv(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as CSV: a header, then numbers exact to the last bit; missing ones are empty.

    Neither fields nor aircraft have a comma in their names. Flags are true and false.
    """
    names = [name for each in flight.quantities.values() for name in each.columns(flight.names)]
    file.write((",".join(["time_s", "aircraft", *names]) + "\n").encode())
    for time_s, aircraft, values in table_parts(flight):
        columns = [list(map(repr, time_s.tolist())), [flight.names[k] for k in aircraft.tolist()]]
        columns += [_cells(*each) for each in values]
        lines = map(",".join, zip(*columns, strict=True))
        file.write("".join(f"{line}\n" for line in lines).encode())


def _cells(values: Numbers, missing: BoolArray) -> list[str]:
    """Write the cells of a column (r,)."""
    if values.dtype.kind == "b":
        cells = ["true" if each else "false" for each in values.tolist()]
    else:
        cells = list(map(repr, values.tolist()))
    for row in np.flatnonzero(missing).tolist():
        cells[row] = ""
    return cells


def write_npz(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as NumPy arrays by name, which `numpy.load` reads without pickle.

    The arrays are those of `FlightData`, (K, N) and (K, N, N), with `time_s` (K,), `aircraft` (N,)
    and the texts of `FlightData.documents`.
    """
    arrays: dict[str, Any] = {"time_s": flight.time_s, "aircraft": np.array(flight.names)}
    arrays |= {name: flight[name] for name in flight.keys()}
    arrays |= {name: np.array(text) for name, text in flight.documents().items()}
    np.savez_compressed(file, **arrays)
