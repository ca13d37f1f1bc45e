"""Parquet: the only module that imports pyarrow.

A table of a run has one row for each sample and aircraft, in order of time and then of the run's
names. Quantities about each aircraft have one column per aircraft, named before the unit:
`formation_age_leader_s`. A missing number is null.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from testbed.core.errors import InputError, needs_extra
from testbed.core.input_files import MAX_PARQUET_BYTES, open_regular
from testbed.logs.flight_data import FlightData, Numbers, table_parts

with needs_extra("study", "Parquet"):
    import pyarrow as arrow
    from pyarrow import parquet

# of a file that is read: 100,000 runs with 1,000 numbers each
_MAX_VALUES = 100_000_000
_MAX_UNCOMPRESSED_BYTES = 4_000_000_000
_MAX_REASON = 200  # characters of a library's error

COLUMN_TYPES: Mapping[str, Any] = {
    "int64": arrow.int64(),
    "double": arrow.float64(),
    "string": arrow.string(),
    "bool": arrow.bool_(),
}


def write_parquet(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as Parquet: units with the columns, `FlightData.documents` with the file."""
    with _writer(file, _schema(flight)) as writer:
        for table in _tables(flight):
            writer.write_table(table)


def _writer(file: IO[bytes], schema: Any) -> Any:  # noqa: ANN401
    """Open a Parquet writer whose pages have checksums."""
    return parquet.ParquetWriter(file, schema, compression="zstd", write_page_checksum=True)


def _schema(flight: FlightData) -> Any:  # noqa: ANN401 - pyarrow has no types
    fields = [
        arrow.field("time_s", arrow.float64(), metadata={"unit": "s"}),
        arrow.field("aircraft", arrow.dictionary(arrow.int32(), arrow.string())),
    ]
    for each in flight.quantities.values():
        kind = arrow.uint32() if each.integer else arrow.float64()
        if each.source == "lost":
            kind = arrow.bool_()
        notes = ({"unit": each.unit} if each.unit else {}) | each.flag_attributes
        fields += [arrow.field(name, kind, metadata=notes) for name in each.columns(flight.names)]
    return arrow.schema(fields, metadata=flight.documents())


def _tables(flight: FlightData) -> Iterator[Any]:
    """Make the table in parts that fit into memory; at least one part, which may be empty."""
    schema, names = _schema(flight), arrow.array(flight.names, arrow.string())
    for time_s, aircraft, values in table_parts(flight):
        columns = [arrow.array(time_s), arrow.DictionaryArray.from_arrays(aircraft, names)]
        for column, missing in values:
            kind = schema.field(len(columns)).type
            columns.append(arrow.array(column, kind, mask=missing))
        yield arrow.Table.from_arrays(columns, schema=schema)


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
    with _writer(file, schema) as writer:
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
        InputError: It cannot be read, is not a Parquet file, or has too many values.
    """
    with _reading(path) as file:
        schema = file.schema_arrow
        repeated = [name for name, count in Counter(schema.names).items() if count > 1]
        if repeated:
            raise ValueError(f"has several columns {repeated[0]}")
        metadata = {key.decode(): text.decode() for key, text in (schema.metadata or {}).items()}
        wanted = schema.names if names is None else [n for n in schema.names if n in set(names)]
        _refuse_size(file, len(wanted))
        table = file.read(columns=wanted, use_threads=False)
        columns = {name: table[name].to_numpy(zero_copy_only=False) for name in wanted}
    return columns, metadata


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """Open a Parquet file; all errors in it are errors of the input.

    It is read without threads, which would still be there when the program ends, and can abort it.
    """
    checked = {"page_checksum_verification": True, "pre_buffer": False}  # that one has threads
    with open_regular(path, MAX_PARQUET_BYTES) as stream:
        try:
            with parquet.ParquetFile(stream, **checked) as file:
                yield file
        except MemoryError as error:  # also of a size that a damaged page claims
            reason = str(error) or "an allocation failed"
            raise InputError(
                f"{path}: not enough memory to read it: {reason} (end other programs, or write the "
                "file again, which may be damaged)"
            ) from error
        except (arrow.ArrowException, OSError, ValueError, OverflowError) as error:
            reason = " ".join(str(error).split())[:_MAX_REASON]
            raise InputError(f"{path}: is not a Parquet file: {reason}") from error


def _refuse_size(file: Any, columns: int) -> None:  # noqa: ANN401
    """Refuse more values, or larger texts, than any study has.

    Raises:
        ValueError: With the numbers.
    """
    facts = file.metadata
    groups = (facts.row_group(index) for index in range(facts.num_row_groups))
    uncompressed = sum(max(group.total_byte_size, 0) for group in groups)
    if facts.num_rows * max(columns, 1) > _MAX_VALUES or uncompressed > _MAX_UNCOMPRESSED_BYTES:
        raise ValueError(
            f"{facts.num_rows:,} rows of {columns} columns in {uncompressed:,} bytes; at most "
            f"{_MAX_VALUES:,} values and {_MAX_UNCOMPRESSED_BYTES:,} bytes are read"
        )


def column_names(path: Path) -> tuple[str, ...]:
    """Read the column names of a Parquet file.

    Raises:
        InputError: It cannot be read, or is not a Parquet file.
    """
    with _reading(path) as file:
        return tuple(file.schema_arrow.names)
