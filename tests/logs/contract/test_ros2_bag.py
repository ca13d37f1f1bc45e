"""Bags of ROS 2: read back by a second library, in the axes of REP 103."""

import math
from dataclasses import replace

import mcap.reader
import numpy as np
import pytest
import views_flight
import yaml
from commands import call_command
from mcap_ros2.decoder import DecoderFactory
from record_flight import record, run_info, run_samples
from rosbags.highlevel import AnyReader

from testbed.core.frames import (
    GRAVITY,
    euler_enu_flu,
    quaternion_xyzw,
    rotation_ned_body,
)
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import Event, NedOrigin
from testbed.logs.file_record import RECORD_NAME

AIRCRAFT, SECONDS, HZ, LOST_AT = 3, 2, 25, 30
DATE_LINE = NedOrigin(38.0, 180.0, 300.0)
NED_TO_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_TO_FLU = np.diag([1, -1, -1])


def flight():
    for k, sample in enumerate(views_flight.samples(AIRCRAFT, SECONDS)):
        lost = np.arange(AIRCRAFT) == (2 if k >= LOST_AT else -1)
        truth = sample.truth._replace(rates_body=np.tile([0.1, 0.2, 0.3], (AIRCRAFT, 1)))
        estimate = truth._replace(position_ned=truth.position_ned + [1.0, 2.0, 3.0])
        events = (Event(sample.time_s, "warning", "uav2", "lost"),) if k == LOST_AT else ()
        yield sample._replace(truth=truth, estimate=estimate, lost=lost, events=events)


@pytest.fixture(scope="module")
def seen():
    return list(flight())


@pytest.fixture(scope="module")
def bag(tmp_path_factory, seen):
    folder = tmp_path_factory.mktemp("run")
    info = replace(views_flight.info(AIRCRAFT, SECONDS), origin=DATE_LINE)
    path = record(folder / "run.mcap", seen, info)
    arguments = ("export", path, "--format", "ros2")
    done = call_command(*arguments, cwd=folder, code=0, columns=120)
    assert "run.ros2" in done.stderr and "does not allow" not in done.stderr
    again = call_command(*arguments, cwd=folder, code=2, columns=120)
    assert "it exists; remove it or write another name" in again.stderr
    named = call_command(*arguments, "--out", "run.ros2", cwd=folder, code=2, columns=120)
    assert "--out run.ros2: it exists; remove it" in named.stderr
    assert {each.name for each in folder.iterdir()} == {"run.mcap", "run.ros2", RECORD_NAME}
    return folder / "run.ros2"


def test_export_prints_which_name_became_which(tmp_path):
    """`uav_1` keeps its name beside `uav-1`; the fixture has names that ROS 2 allows, no line."""
    names = ("leader", "uav-1", "uav_1", "2nd")
    path = record(tmp_path / "run.mcap", list(run_samples(3)), run_info(names=names))
    done = call_command("export", path, "--format", "ros2", cwd=tmp_path, code=0, columns=160)
    line = "names that ROS 2 does not allow: uav-1 is /uav_1_2, 2nd is /aircraft_2nd"
    assert line in done.stderr
    with (tmp_path / "run.ros2" / "run.ros2.mcap").open("rb") as file:
        summary = mcap.reader.make_reader(file).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert {f"/{name}/odom" for name in ("leader", "uav_1", "uav_1_2", "aircraft_2nd")} <= topics


@pytest.fixture(scope="module")
def found(bag):
    """Messages by topic, decoded by mcap-ros2-support."""
    topics = {}
    with (bag / "run.ros2.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
            topics.setdefault(channel.topic, []).append((message.log_time, content))
    return topics


def rotation(q):
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def vector(value):
    return np.array([value.x, value.y, value.z])


def test_euler_angles_are_those_of_the_turned_axes():
    rng = np.random.default_rng(3)
    for euler in rng.uniform(-1.5, 1.5, (20, 3)):
        x, y, z, w = quaternion_xyzw(euler_enu_flu(euler))
        q = type("Q", (), {"x": x, "y": y, "z": z, "w": w})
        expected = NED_TO_ENU @ rotation_ned_body(euler) @ FRD_TO_FLU
        np.testing.assert_allclose(rotation(q), expected, atol=1e-12)


def test_odometry_is_the_motion_in_axes_of_rep_103(found, seen):
    k, i = 40, 1
    truth = seen[k].truth
    stamp, odometry = found["/uav1/odom"][k]
    assert stamp == k * 40_000_000
    header = odometry.header
    assert header.stamp.sec * 10**9 + header.stamp.nanosec == stamp
    assert (header.frame_id, odometry.child_frame_id) == ("map", "uav1/base_link")
    position = vector(odometry.pose.pose.position)
    np.testing.assert_allclose(position, NED_TO_ENU @ truth.position_ned[i], atol=1e-12)
    attitude = rotation_ned_body(truth.euler[i])
    turned = NED_TO_ENU @ attitude @ FRD_TO_FLU
    np.testing.assert_allclose(rotation(odometry.pose.pose.orientation), turned, atol=1e-12)
    velocity = FRD_TO_FLU @ attitude.T @ truth.velocity_ned[i]
    np.testing.assert_allclose(vector(odometry.twist.twist.linear), velocity, atol=1e-12)
    np.testing.assert_allclose(vector(odometry.twist.twist.angular), [0.1, -0.2, -0.3])
    estimate = found["/uav1/estimate"][k][1].pose
    np.testing.assert_allclose(vector(estimate.pose.position) - position, [2, 1, -3], atol=1e-9)
    covariance = np.array(estimate.covariance).reshape(6, 6)[:3, :3]
    np.testing.assert_allclose(covariance, np.outer([2, 1, -3], [2, 1, -3]), atol=1e-9)


def test_accelerometer_measures_gravity_upward(found, seen):
    _, imu = found["/leader/imu"][10]
    assert imu.header.frame_id == "leader/base_link"
    attitude = rotation_ned_body(seen[10].truth.euler[0])
    expected = FRD_TO_FLU @ attitude.T @ [0, 0, -GRAVITY]
    np.testing.assert_allclose(vector(imu.linear_acceleration), expected, atol=1e-12)
    assert expected[2] > 9.0


def test_fix_is_the_estimate_with_its_covariance(found, seen):
    assert len(found["/uav2/fix"]) == 5 * SECONDS
    stamp, fix = found["/uav2/fix"][3]
    position = seen[15].estimate.position_ned[2]
    expected = geodetic_from_ned(position, DATE_LINE)
    np.testing.assert_array_equal([fix.latitude, fix.longitude, fix.altitude], expected)
    # a degree of longitude is 87.8 km at this latitude
    east = 87.8e3 * math.remainder(fix.longitude - 180.0, 360.0)
    assert east == pytest.approx(position[1], rel=0.01)
    assert all(-180.0 <= each.longitude < 180.0 for _, each in found["/uav2/fix"])
    assert fix.position_covariance_type == 1
    np.testing.assert_allclose(fix.position_covariance[:3], [4, 2, -6], atol=1e-9)


def test_frames_slots_and_markers_agree(found, seen):
    _, message = found["/tf"][40]
    frames = {each.child_frame_id: each for each in message.transforms}
    assert set(frames) == {
        *("leader/base_link", "uav1/base_link", "uav2/base_link"),
        *("uav1/slot", "uav2/slot", "formation"),
    }
    assert {each.header.frame_id for each in message.transforms} == {"map"}
    slot = NED_TO_ENU @ seen[40].formation.slot_ned[0]
    np.testing.assert_allclose(vector(frames["uav1/slot"].transform.translation), slot)
    np.testing.assert_allclose(vector(found["/uav1/slot"][40][1].pose.position), slot)
    [link] = found["/links"][8][1].markers
    ends = np.array([vector(point) for point in link.points])
    frame = frames[link.header.frame_id].transform
    ends = ends @ rotation(frame.rotation).T + vector(frame.translation)
    aircraft = seen[40].truth.position_ned @ NED_TO_ENU.T
    distance = np.linalg.norm(ends[:, None] - aircraft, axis=-1)
    assert distance.min(axis=1).max() < 1e-6
    assert len(link.colors) == len(link.points)


def test_models_are_true_to_scale_until_loss(found):
    first, after = found["/models"]
    markers = {(each.ns, each.id): each for each in first[1].markers}
    assert {number for group, number in markers if group == "slots"} == {1, 2}
    points = np.array([vector(point) for point in markers["base_link", 0].points])
    assert np.ptp(points[:, 1]) == pytest.approx(2.795, rel=0.01)
    assert points[points[:, 0] < -0.8, 2].max() > 0.3  # the fin is behind, and points up
    assert after[0] == LOST_AT * 40_000_000
    assert [(each.ns, each.id, each.action) for each in after[1].markers] == [("slots", 2, 2)]
    [(_, line)] = found["/rosout"]
    assert (line.level, line.name, line.msg) == (30, "uav2", "lost")


def test_bag_is_complete_for_ros2_bag(bag, found):
    """By metadata.yaml, by the index of the file, and by the reader of rosbags."""
    described = yaml.safe_load((bag / "metadata.yaml").read_text())
    described = described["rosbag2_bagfile_information"]
    assert described["storage_identifier"] == "mcap"
    assert described["relative_file_paths"] == ["run.ros2.mcap"]
    topics = described["topics_with_message_count"]
    counts = {each["topic_metadata"]["name"]: each["message_count"] for each in topics}
    assert counts == {topic: len(each) for topic, each in found.items()}
    with (bag / "run.ros2.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == sum(counts.values())
    with AnyReader([bag]) as reader:
        assert reader.message_count == sum(counts.values())
        connection = next(c for c in reader.connections if c.topic == "/models")
        assert connection.msgtype == "visualization_msgs/msg/MarkerArray"
        [durability] = {qos.durability.name for qos in connection.ext.offered_qos_profiles}
        assert durability == "TRANSIENT_LOCAL"
