"""Parquet and CSV: the only module that imports pyarrow.

A table of a run has one row for each sample and aircraft, in order of time and then of the run's
names. Quantities about each aircraft have one column per aircraft, named before the unit:
`formation_age_leader_s`. A missing number is null: an empty cell in CSV.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as arrow
from pyarrow import csv, parquet

from testbed.logs.flight_data import QUANTITIES, FlightData, Numbers

_ROWS = 65_536  # in memory at once, and in a row group of Parquet

COLUMN_TYPES: Mapping[str, Any] = {
    "int64": arrow.int64(),
    "double": arrow.float64(),
    "string": arrow.string(),
    "bool": arrow.bool_(),
}


def write_parquet(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as Parquet: units with the columns, `FlightData.documents` with the file."""
    with parquet.ParquetWriter(file, _schema(flight), compression="zstd") as writer:
        for table in _tables(flight):
            writer.write_table(table)


def write_csv(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as CSV: a header line, then numbers that read back to the same bits."""
    file.write((",".join(_schema(flight).names) + "\n").encode())
    # names need no quotes: neither fields nor aircraft may contain a comma
    options = csv.WriteOptions(include_header=False, quoting_style="none")
    for table in _tables(flight):
        names = table["aircraft"].cast(arrow.string())
        csv.write_csv(table.set_column(1, "aircraft", names), file, options)


def _schema(flight: FlightData) -> Any:  # noqa: ANN401 - pyarrow has no types
    fields = [
        arrow.field("time_s", arrow.float64(), metadata={"unit": "s"}),
        arrow.field("aircraft", arrow.dictionary(arrow.int32(), arrow.string())),
    ]
    for each in QUANTITIES.values():
        kind = arrow.uint32() if each.integer else arrow.float64()
        if each.source == "lost":
            kind = arrow.bool_()
        unit = {"unit": each.unit} if each.unit else None
        fields += [arrow.field(name, kind, metadata=unit) for name in each.columns(flight.names)]
    return arrow.schema(fields, metadata=flight.documents())


def _tables(flight: FlightData) -> Iterator[Any]:
    """Make the table in parts that fit into memory; at least one part, which may be empty."""
    schema, names = _schema(flight), flight.names
    step = max(1, _ROWS // len(names))
    for start in range(0, max(1, flight.time_s.size), step):
        rows = slice(start, start + step)
        time_s = flight.time_s[rows]
        aircraft = np.tile(np.arange(len(names), dtype=np.int32), time_s.size)
        columns = [
            arrow.array(np.repeat(time_s, len(names))),
            arrow.DictionaryArray.from_arrays(aircraft, arrow.array(names, arrow.string())),
        ]
        for each in QUANTITIES.values():
            values = flight.values(each, rows)
            absent = aircraft == 0 if each.followers_only else np.zeros(aircraft.size, dtype=bool)
            for other in range(len(names) if each.per_aircraft else 1):
                of_column = values[..., other] if each.per_aircraft else values
                kind = schema.field(len(columns)).type
                columns.append(_array(of_column.reshape(-1), absent, kind))
        yield arrow.Table.from_arrays(columns, schema=schema)


def _array(values: Numbers, absent: Numbers, kind: Any) -> Any:  # noqa: ANN401
    """Convert a column; null where it is absent or NaN."""
    missing = absent | np.isnan(values) if values.dtype.kind == "f" else absent
    if kind == arrow.uint32():
        values = np.where(missing, 0, values).astype(np.uint32)
    return arrow.array(values, kind, mask=missing)


def write_columns(
    file: IO[bytes],
    fields: Mapping[str, str],
    groups: Iterable[Sequence[Sequence[Any]]],
    metadata: Mapping[str, str],
) -> None:
    """Write any table as Parquet, one group of rows at a time.

    Args:
        file: the open file.
        fields: the type of each column by its name, a key of `COLUMN_TYPES`.
        groups: the columns of each group of rows; None is a missing value.
        metadata: texts to be stored with the table.
    """
    schema = arrow.schema(
        [arrow.field(name, COLUMN_TYPES[kind]) for name, kind in fields.items()],
        metadata=dict(metadata),
    )
    with parquet.ParquetWriter(file, schema, compression="zstd") as writer:
        for group in groups:
            columns = [arrow.array(c, field.type) for c, field in zip(group, schema, strict=True)]
            writer.write_table(arrow.Table.from_arrays(columns, schema=schema))


def read_columns(
    path: Path, names: Iterable[str] | None = None
) -> tuple[dict[str, Numbers], dict[str, str]]:
    """Read a table and its metadata.

    Args:
        path: the file.
        names: the columns to read, unknown ones are ignored; None: all.

    Returns:
        The columns (rows,) by name, a missing double as NaN and a missing text as None; and the
        texts stored with the table.

    Raises:
        ValueError: It is not a Parquet file.
        OSError: It cannot be read.
    """
    try:
        with parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            wanted = schema.names if names is None else [n for n in schema.names if n in set(names)]
            table = file.read(columns=wanted)
    except arrow.ArrowInvalid as error:
        raise ValueError(f"is not a Parquet file: {error}") from None
    metadata = {key.decode(): text.decode() for key, text in (schema.metadata or {}).items()}
    return {name: table[name].to_numpy(zero_copy_only=False) for name in wanted}, metadata


def column_names(path: Path) -> tuple[str, ...]:
    """Read the column names of a Parquet file.

    Raises:
        ValueError: It is not a Parquet file.
        OSError: It cannot be read.
    """
    try:
        return tuple(parquet.read_schema(path).names)
    except arrow.ArrowInvalid as error:
        raise ValueError(f"is not a Parquet file: {error}") from None
