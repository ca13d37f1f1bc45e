"""Flights, messages and missions across the 180th meridian."""

import math

import numpy as np
import pytest
from mavlink_control import RecordingControl, sample
from record_flight import decoded, record
from run_flight import Collector, short

from testbed.ardupilot.sitl_process import command_line
from testbed.core.records import NedOrigin
from testbed.flight.loop import fly
from testbed.guidance.flight_plan import GuidanceMission, WaypointLeg
from testbed.mavlink.mission_plans import items_from_mission, plan_from_items
from testbed.mavlink.telemetry_motion import global_position_int, gps_raw_int
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.telemetry_status import home_position
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import FlightMode, Rejection
from testbed.plan.world import build
from testbed.scenario import load_scenario
from testbed.scenario.problems import ScenarioError

PLACE = -179.9995  # degrees; 44 m east of the meridian at a latitude of 38°
RADIUS = 6378137.0 / math.sqrt(1.0 - 6.69437999014e-3 * math.sin(math.radians(38.0)) ** 2) + 300.0


def scenario(longitude):
    changes = (f"scenario.origin.longitude_deg={longitude}", "network.encoding=follow-target")
    return short(*changes, seconds=3.0)


@pytest.fixture(scope="module")
def flown():
    """Fly east from two longitudes; return the samples and the run's description of each."""
    found = {}
    for longitude in (0.0, PLACE):
        collector, world = Collector(), build(scenario(longitude))
        assert fly(world, [collector], lambda now, due: False) == "completed"
        found[longitude] = collector.frames, world.info
    return found


def east_of_origin(longitude):
    """Return the distance east of the origin, m, from a longitude, deg, by a direction."""
    angle = math.radians(longitude - PLACE)
    east = math.atan2(math.sin(angle), math.cos(angle))
    return east * RADIUS * math.cos(math.radians(38.0))


def test_flight_equals_that_at_longitude_0(flown):
    ones, others = (flown[longitude][0] for longitude in (0.0, PLACE))
    for one, other in zip(ones, others, strict=True):
        assert other.truth.position_ned == pytest.approx(one.truth.position_ned, abs=1e-6)
        assert other.formation.error_ned == pytest.approx(one.formation.error_ned, abs=1e-6)
        assert other.command.roll == pytest.approx(one.command.roll, abs=1e-6)


def test_positions_in_messages_cross_the_meridian(flown, tmp_path):
    frames, info = flown[PLACE]
    origin, longitudes = info.origin, []
    for frame in frames:
        snapshot = TelemetrySnapshot(frame, origin)
        context = VehicleContext(RecordingControl(), 1, 0, origin)
        place, fix = global_position_int(context, snapshot), gps_raw_int(context, snapshot)
        assert place["lon"] == fix["lon"]
        longitudes.append(place["lon"])
        east = frame.estimate.position_ned[0, 1]
        assert east_of_origin(place["lon"] * 1e-7) == pytest.approx(east, abs=0.006)
    path = record(tmp_path / "run.mcap", frames, info)
    fixes = [message.longitude for topic, _, message in decoded(path) if topic == "/leader/fix"]
    for longitude, frame in zip(fixes, frames[::5], strict=True):
        east = frame.estimate.position_ned[0, 1]
        assert east_of_origin(longitude) == pytest.approx(east, abs=1e-6)
    for found in (np.array(longitudes) * 1e-7, np.array(fixes)):
        assert -180.0 <= found.min() < -179.999 and 179.999 < found.max() < 180.0


def test_home_at_180_is_minus_180():
    origin = NedOrigin(38.0, 180.0, 300.0)
    context = VehicleContext(RecordingControl(), 1, 0, origin)
    home = home_position(context, TelemetrySnapshot(sample(), origin))
    assert home["longitude"] == -1_800_000_000
    line = command_line("arduplane", 0, origin, 90.0, "file")
    assert line[line.index("--home") + 1] == "38,-180,300,90"


def test_mission_across_the_meridian_is_flown_there():
    origin, points = NedOrigin(38.0, PLACE, 300.0), ((0.0, -500.0, 100.0), (300.0, 500.0, 100.0))
    params = GuidanceMission(legs=(WaypointLeg(points),), airspeed=22.0)
    items = items_from_mission(params, origin)
    assert 179.99 < items[1].y < 180.0 and -180.0 <= items[2].y < -179.99
    plan = plan_from_items(items, (0.0, 0.0, 100.0), params, 60.0, origin)
    assert not isinstance(plan, Rejection), plan
    ends = [segment.end for segment in plan.plan.segments[:2]]
    assert np.allclose(ends, points, atol=1e-6)


def test_loiter_point_across_the_meridian_is_near():
    world = build(scenario(PLACE), commanded=True)
    session = world.external_control.vehicles[0]
    assert session.set_mode(FlightMode.GUIDED) is None
    assert session.set_loiter_point(38.0, 179.999, 100.0, None) is None
    assert session.set_loiter_point(38.0, -178.0, 100.0, None) is not None  # 132 km


def test_latitude_beyond_85_is_refused_with_reason():
    with pytest.raises(ScenarioError, match=r"at most 85: .*parallels shrink"):
        load_scenario("simulation-3", ["scenario.origin.latitude_deg=86"])
