"""Where aircraft were in the air: what of a trail of vortices does not depend on what it does."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, Truths


class Trails(NamedTuple):
    """Where N aircraft were in the air, in rings of K places; written in place."""

    position: Array  # (N, K, 3) m, in the frame that the mean wind carries
    forward: Array  # (N, K, 3) unit vector of flight through the air
    right: Array  # (N, K, 3) unit vector across it, along the wing
    circulation: Array  # Γ (N, K) m²/s
    path: Array  # (N, K) m flown
    tick: NDArray[np.int64]  # (K,)
    newest: NDArray[np.int64]  # (1,) the row of the present, which is one of the K


class Places(NamedTuple):
    """The place of N trails abeam of N followers."""

    position: Array  # (N, N, 3) m: follower, shedder
    forward: Array  # (N, N, 3)
    right: Array  # (N, N, 3)
    circulation: Array  # (N, N) m²/s, as shed
    ahead: Array  # (N, N) m along the trail to the wing that shed it; negative: the wing is behind
    age: Array  # (N, N) s
    found: Truths  # (N, N)


def unit(vector: Array) -> Array:
    """Vectors (..., 3) of length one; of none where there is no direction."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.maximum(length, np.finfo(float).tiny))


def straight(
    position: Array,
    velocity: Array,
    forward: Array,
    right: Array,
    circulation: Array,
    *,
    kept: int,
    dt: float,
    memory_s: float,
) -> Trails:
    """The trails of aircraft that have flown straight on to where they are, which is tick 0.

    Args:
        position: (N, 3) m.
        velocity: (N, 3) m/s, through the air.
        forward: (N, 3) unit vector.
        right: (N, 3) unit vector.
        circulation: (N,) m²/s.
        kept: ticks between the places of a trail.
        dt: s, one tick.
        memory_s: that the trails reach back, at least.
    """
    places = math.ceil(memory_s / (kept * dt)) + 2
    tick = kept * np.arange(-places, 0)
    return Trails(
        position=position[:, None, :] + velocity[:, None, :] * (tick * dt)[:, None],
        forward=np.repeat(forward[:, None], places, axis=1),
        right=np.repeat(right[:, None], places, axis=1),
        circulation=np.repeat(circulation[:, None], places, axis=1),
        path=np.linalg.norm(velocity, axis=-1)[:, None] * (tick * dt),
        tick=tick,
        newest=np.array([places - 1]),
    )


def remember(
    trails: Trails,
    kept: int,
    tick: int,
    position: Array,
    forward: Array,
    right: Array,
    circulation: Array,
) -> None:
    """Write the present into the trails; what it replaces stays if it is time to keep it."""
    row = int(trails.newest[0])
    if trails.tick[row] - trails.tick[row - 1] >= kept:
        row = (row + 1) % len(trails.tick)
        trails.newest[0] = row
    trails.position[:, row] = position
    trails.forward[:, row] = forward
    trails.right[:, row] = right
    trails.circulation[:, row] = circulation
    flown = np.linalg.norm(position - trails.position[:, row - 1], axis=-1)
    trails.path[:, row] = trails.path[:, row - 1] + flown
    trails.tick[row] = tick


def abeam(trails: Trails, dt: float, position: Array) -> Places:
    """The place of each trail where it passes followers at `position` (N, 3) m, newest first.

    There the follower lies across the flight direction; between two places that are kept, on the
    straight line. A follower ahead of the wing is given the wing itself.
    """
    places = len(trails.tick)
    order = (trails.newest[0] - np.arange(places)) % places
    to = position[:, None, None, :] - trails.position[None, :, order]
    along = (to * trails.forward[None, :, order]).sum(axis=-1)  # (N, N, K)
    passed = along >= 0.0
    older = passed.argmax(axis=-1)
    newer = np.maximum(older - 1, 0)
    least = np.take_along_axis(along, newer[..., None], axis=-1)[..., 0]
    most = np.take_along_axis(along, older[..., None], axis=-1)[..., 0]
    past = older > 0
    share = np.where(past, least / np.where(past, least - most, 1.0), 0.0)
    column = np.arange(len(position))

    def between(values: Array) -> Array:
        first, last = values[column, order[newer]], values[column, order[older]]
        part = share if first.ndim == 2 else share[..., None]
        return np.asarray(first + part * (last - first))

    forward = unit(between(trails.forward))
    right = between(trails.right)
    right = right - (right * forward).sum(axis=-1, keepdims=True) * forward
    path, ticks = between(trails.path), trails.tick.astype(np.float64)
    tick = ticks[order[newer]] + share * (ticks[order[older]] - ticks[order[newer]])
    return Places(
        position=between(trails.position),
        forward=forward,
        right=unit(right),
        circulation=between(trails.circulation),
        ahead=np.where(past, trails.path[:, order[0]] - path, -along[..., 0]),
        age=(ticks[order[0]] - tick) * dt,
        found=passed.any(axis=-1),
    )
