"""Begin, end, condition and declaration of faults."""

import numpy as np
import pytest
from fault_samples import fault_manager, step, truth

from testbed.core.records import AIRCRAFT, allocate
from testbed.scenario.faults import (
    AutopilotFrozen,
    BatteryLow,
    Condition,
    EngineOut,
    GpsJump,
    SurfaceStuck,
    ThrustLoss,
    TransmitterOff,
)


def test_fault_begins_and_ends_at_its_times():
    faults = fault_manager(EngineOut(kind="engine-out", at_s=10.0, duration_s=5.0))
    assert step(faults, 9.98) == []
    assert faults.state.power.tolist() == [1.0, 1.0, 1.0, 1.0]
    assert step(faults, 10.0) == [(10.0, "warning", "uav2", "engine out")]
    assert faults.state.power.tolist() == [1.0, 1.0, 0.0, 1.0]
    assert faults.active.tolist() == [False, False, True, False]
    assert step(faults, 14.98) == []
    assert step(faults, 15.0) == [(15.0, "info", "uav2", "engine out: ended")]
    assert faults.state.power.tolist() == [1.0, 1.0, 1.0, 1.0]
    assert step(faults, 20.0) == []  # it does not begin again


@pytest.mark.parametrize(
    ("condition", "before", "then"),
    [
        ({"quantity": "altitude_m", "above": 120.0}, truth(120.0), truth(120.1)),
        ({"quantity": "airspeed_mps", "below": 18.0}, truth(airspeed=18.0), truth(airspeed=17.9)),
        ({"quantity": "bank_deg", "above": 20.0}, truth(bank=0.34), truth(bank=-0.36)),
    ],
)
def test_condition_holds_from_its_time_on_and_once(condition, before, then):
    faults = fault_manager(
        AutopilotFrozen(
            kind="autopilot-frozen", at_s=5.0, duration_s=1.0, when=Condition(**condition)
        )
    )
    assert step(faults, 4.0, then) == []
    assert step(faults, 5.0, before) == []
    assert [each[3] for each in step(faults, 6.0, then)] == ["autopilot frozen"]
    assert faults.state.frozen[2]
    assert [each[3] for each in step(faults, 7.0, then)] == ["autopilot frozen: ended"]
    assert step(faults, 8.0, then) == []


def test_faults_of_one_aircraft_combine():
    faults = fault_manager(
        ThrustLoss(kind="thrust-loss", at_s=1.0, remaining=0.5),
        ThrustLoss(kind="thrust-loss", at_s=2.0, remaining=0.5, duration_s=3.0),
        GpsJump(kind="gps-jump", at_s=1.0, offset_m=(1.0, 2.0, 3.0)),
        GpsJump(kind="gps-jump", at_s=1.0, offset_m=(10.0, 0.0, 0.0)),
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=1.0, position=0.25),
    )
    step(faults, 2.0)
    assert faults.state.power[2] == 0.25
    assert faults.state.gps_jump[2].tolist() == [11.0, 2.0, 3.0]
    assert faults.state.stuck[2].tolist() == [False, False, True, False, False]
    assert faults.state.stuck_at[2, 2] == 0.25
    step(faults, 5.0)
    assert faults.state.power[2] == 0.5


def test_battery_is_emptied_once():
    faults = fault_manager(BatteryLow(kind="battery-low", at_s=1.0, state_of_charge=0.2))
    step(faults, 1.0)
    assert faults.state.charge[2] == 0.2
    step(faults, 1.02)
    assert np.isnan(faults.state.charge).all()


def test_messages_declare_a_failure_after_the_delay():
    faults = fault_manager(EngineOut(kind="engine-out", at_s=10.0, duration_s=5.0))
    step(faults, 10.0)
    measured = np.array([[0.0, 0.0, 11.96, 0.0], [0.0, 0.0, 12.0, 0.0], [0.0, 0.0, np.nan, 0.0]])
    assert faults.bind_declared()(measured)[:, 2].tolist() == [False, True, False]
    step(faults, 15.0)
    assert faults.bind_declared()(np.array([[0.0, 0.0, 16.0, 0.0]]))[0].tolist() == [
        False,
        False,
        True,
        False,
    ]
    # messages from before the declaration stay what they were
    assert faults.bind_declared()(np.array([[0.0, 0.0, 11.96, 0.0]]))[0].tolist() == [False] * 4


def test_fault_ending_before_the_delay_is_undeclared():
    faults = fault_manager(EngineOut(kind="engine-out", at_s=10.0, duration_s=1.0))
    step(faults, 10.0)
    step(faults, 11.0)
    assert not faults.bind_declared()(np.full((1, 4), 30.0)).any()


def test_fault_of_a_lost_aircraft_does_not_begin():
    faults = fault_manager(EngineOut(kind="engine-out", at_s=10.0))
    lost = np.array([False, False, True, False])
    assert step(faults, 10.0, lost=lost) == []
    assert not faults.active.any()


def test_later_of_two_stuck_positions_applies():
    faults = fault_manager(
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=2.0, position=0.5),
        SurfaceStuck(kind="surface-stuck", surface="rudder", at_s=1.0, position=0.25),
    )
    step(faults, 1.0)
    step(faults, 2.0)
    assert faults.state.stuck_at[2, 2] == 0.5


def test_battery_is_read_while_a_condition_waits():
    """Batteries are read from 5 s on, up to the beginning; an unknown charge meets no condition."""
    condition = Condition(quantity="state_of_charge", below=0.3)
    faults = fault_manager(TransmitterOff(kind="transmitter-off", at_s=5.0, when=condition))
    aircraft = allocate(AIRCRAFT, 4)
    reads = faults.battery_call(aircraft)
    assert not reads(4.98)
    assert reads(5.0)
    assert step(faults, 5.0, charge=np.nan) == step(faults, 5.0, charge=0.3) == []
    aircraft["lost"][2] = True
    assert not reads(5.0)
    aircraft["lost"][2] = False
    assert [each[3] for each in step(faults, 6.0, charge=0.29)] == ["transmitter off"]
    assert not reads(6.02)
