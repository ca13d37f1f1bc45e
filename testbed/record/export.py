"""A run written in other formats than its log's."""

from __future__ import annotations

from typing import IO, Any

import numpy as np

from testbed.record.flight import Flight


def write_npz(flight: Flight, file: IO[bytes]) -> None:
    """Write a run as NumPy arrays by name, which `numpy.load` reads without pickle.

    Arrays are those of `Flight`, (K, N) and (K, N, N); beside them are `time_s` (K,), `aircraft`
    (N,) and, as texts, `scenario.resolved.yaml`, `metrics.json`, `events.json` and `run.json`.
    """
    arrays: dict[str, Any] = {"time_s": flight.time_s, "aircraft": np.array(flight.names)}
    arrays |= {name: flight[name] for name in flight.keys()}
    arrays |= {name: np.array(text) for name, text in flight.facts().items()}
    np.savez_compressed(file, **arrays)
