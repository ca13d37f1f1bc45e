"""Rows of a compiled aircraft without a fleet: placed, advanced with controls and wind."""

import numpy as np
import pytest

from testbed.compiled.compiled_aircraft import CompiledAircraft
from testbed.compiled.compiled_fleet import find_engine, make_compiled_fleet, place_row
from testbed.core.errors import InputError
from testbed.core.library import library
from testbed.core.records import NedOrigin
from testbed.vehicle.fleet import place_model
from testbed.vehicle.trim import InitialState

FOLDER, RATE_HZ = library() / "aircraft" / "rascal110", 200
START, ORIGIN = InitialState((0.0, 0.0, -300.0), course=0.3), NedOrigin()


def test_a_row_is_that_of_a_fleet():
    """Held controls from the first step on, with no lead of the first one."""
    aircraft = find_engine(FOLDER, RATE_HZ).compiled
    fleet, _ = make_compiled_fleet([FOLDER], [START], ORIGIN, RATE_HZ, "compiled")
    placed = place_row(FOLDER, START, ORIGIN, RATE_HZ)
    rows = np.tile(placed.row, (3, 1))
    np.testing.assert_array_equal(fleet.kinds[0].state, rows[:1])
    fleet.step(None, 50)
    assert not aircraft.advance(rows, 1.0 / RATE_HZ, 50).any()
    np.testing.assert_array_equal(rows, np.repeat(fleet.kinds[0].state, 3, axis=0))
    assert not np.array_equal(rows[0], placed.row)


def test_each_row_has_its_controls_and_wind():
    aircraft = find_engine(FOLDER, RATE_HZ).compiled
    rows = np.tile(place_row(FOLDER, START, ORIGIN, RATE_HZ).row, (3, 1))
    names = [f"fcs/{each}-cmd-norm" for each in ("aileron", "elevator", "rudder", "throttle")]
    controls = rows[:, [aircraft.columns[name] for name in names]]  # not in C order
    wind = np.zeros((3, 7))
    controls[1, 0] += 0.1
    wind[2, 2] = -10.0  # ft/s, a gust upwards
    status = aircraft.advance(rows, 1.0 / RATE_HZ, 40, controls=controls, wind=wind)
    assert status.tolist() == [0, 0, 0]
    assert len(aircraft.run_rows.signatures) == 1  # nothing was compiled for another order
    roll_rate = rows[:, aircraft.columns["velocities/pi-rad_sec"]]
    assert roll_rate[1] > 0.05 > abs(roll_rate[0])
    alpha = rows[:, aircraft.columns["aero/alpha-rad"]]
    assert alpha[2] > alpha[0] + 0.01


def test_arrays_of_another_shape_are_refused():
    """Compiled code would read, and write, what lies behind them."""
    aircraft = find_engine(FOLDER, RATE_HZ).compiled
    rows = np.tile(place_row(FOLDER, START, ORIGIN, RATE_HZ).row, (3, 1))
    before = rows.copy()
    for wrong in (rows[:, :-1], rows.astype("f4"), rows[::2], rows[0]):
        with pytest.raises(InputError, match=r"^state: has the shape .* \(write np\.ascont"):
            aircraft.advance(wrong, 1.0 / RATE_HZ, 1)
    with pytest.raises(InputError, match=r"^controls: has the shape \(3, 3\) \(write \(3, 4\)\)"):
        aircraft.advance(rows, 1.0 / RATE_HZ, 1, controls=np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"^wind: has the shape \(7,\) \(write \(3, 7\)\)"):
        aircraft.advance(rows, 1.0 / RATE_HZ, 1, wind=np.zeros(7))
    np.testing.assert_array_equal(rows, before)


def test_motion_of_rows_is_that_of_jsbsim():
    """JSBSim's own properties of the aircraft where it is placed."""
    placed = place_row(FOLDER, START, ORIGIN, RATE_HZ)
    (motion,) = CompiledAircraft.motion(placed.row[np.newaxis], ORIGIN)
    model = place_model(FOLDER, START, ORIGIN, RATE_HZ).model
    for axis, name in enumerate(("phi", "theta", "psi")):
        angle = model.node(f"attitude/{name}-rad").get_double_value()
        assert abs(motion["euler"][axis] - angle) < 1e-12
    height_ft = model.node("position/geod-alt-ft").get_double_value()
    assert abs(0.3048 * height_ft - ORIGIN.elevation_m + motion["position_ned"][2]) < 1e-6
    turned = CompiledAircraft.motion(placed.row[np.newaxis], NedOrigin(38.001))
    assert turned["position_ned"][0, 0] < motion["position_ned"][0] - 100.0
