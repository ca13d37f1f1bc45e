"""Runs as MATLAB files."""

from __future__ import annotations

import io
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from testbed.core.errors import InputError

if TYPE_CHECKING:
    from testbed.logs.flight_data import FlightData

_HEADER = b"MATLAB 5.0 MAT-file, written by testbed"  # SciPy's has the time of writing
_HEADER_SIZE = 116


def write_mat(flight: FlightData, file: IO[bytes]) -> None:
    """Write a run as a MATLAB file of version 5, which MATLAB and Octave load.

    The variables are the arrays of `FlightData`, samples × aircraft and samples × aircraft ×
    aircraft; `time_s` is a column, `aircraft` a cell array of names, and the texts of
    `FlightData.documents` have underscores for the dots of their names. The same run gives the same
    bytes.

    Raises:
        InputError: an array is larger than such a file can hold, 2 GB.
    """
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    variables: dict[str, Any] = {
        "time_s": flight.time_s,
        "aircraft": np.array(flight.names, dtype=object),
    }
    variables |= {name: flight[name] for name in flight.keys()}
    variables |= {name.replace(".", "_"): text for name, text in flight.documents().items()}
    content = io.BytesIO()
    try:
        savemat(content, variables, do_compression=True, long_field_names=True, oned_as="column")
    except MatWriteError as error:
        raise InputError(f"--format mat: {error} (write --format npz)") from None
    data = content.getbuffer()
    data[:_HEADER_SIZE] = _HEADER.ljust(_HEADER_SIZE)
    file.write(data)
