"""Several kinds of vehicles together: what all are is what each is, whoever keeps its records."""

import numpy as np
import pytest

from testbed.sim.mixed import Mixed
from testbed.state import AirData, VehicleState

ROWS = {
    "one after the other": ([0, 1], [2, 3, 4]),
    "the last first": ([3, 4], [0, 1, 2]),
    "in turns": ([0, 2, 4], [1, 3]),
}


class Part:
    """Vehicles that are anywhere; records stay from look to look, or are made anew."""

    def __init__(self, n, rng):
        self._rng, self.stays = rng, True
        self._state = VehicleState(*np.empty((5, n, 3)), *np.empty((2, n)))
        self._air = AirData(*np.empty((3, n)), *np.empty((2, n, 3)), *np.empty((3, n)))

    def read(self):
        return self._look("_state")

    def air(self):
        return self._look("_air")

    def _look(self, name):
        record = getattr(self, name)
        if not self.stays:
            record = type(record)(*(each.copy() for each in record))
            setattr(self, name, record)
        for each in record:
            each[...] = self._rng.normal(size=each.shape)
        return record

    def lost(self, state):
        return state.airspeed > 0.0


@pytest.mark.parametrize("rows", ROWS.values(), ids=ROWS)
def test_what_all_are_is_what_each_is(rows):
    rng = np.random.default_rng(12)
    parts = [Part(len(each), rng) for each in rows]
    mixed = Mixed([*zip(rows, parts, strict=True)])
    for look in range(12):
        for number, part in enumerate(parts):
            part.stays = look not in (5 + number, 8)
        for seen, kept in ((mixed.read(), "_state"), (mixed.air(), "_air")):
            for field in seen._fields:
                for own, part in zip(rows, parts, strict=True):
                    theirs = getattr(getattr(part, kept), field)
                    np.testing.assert_array_equal(getattr(seen, field)[own], theirs)
    state = mixed.read()
    for part in parts:  # numbers that do not lie one behind the other
        rates = np.empty((len(part.read().airspeed), 4))[:, :3]
        part._state = part._state._replace(rates_body=rates)
    for _ in range(4):
        state = mixed.read()
        for own, part in zip(rows, parts, strict=True):
            np.testing.assert_array_equal(state.rates_body[own], part._state.rates_body)
    np.testing.assert_array_equal(mixed.lost(state), state.airspeed > 0.0)
