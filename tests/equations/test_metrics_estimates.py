"""What estimates were worth, worked out by hand and by a second route."""

import math

import numpy as np
import pytest
from test_metrics import FRAME_RATE_HZ, a_frame, measure, random_run, run_info

from testbed.metrics.estimates import describe, exact
from testbed.metrics.tally import BLOCK

KINDS = ("horizontal_m", "height_m", "velocity_mps", "tilt_deg", "heading_deg", "airspeed_mps")


def believing(frame, *, position=0.0, velocity=0.0, euler=0.0, airspeed=0.0, believed=None):
    """The frame with estimates off by these, each broadcast over the aircraft."""
    truth = frame.truth
    estimate = truth._replace(
        position_ned=truth.position_ned + position,
        velocity_ned=truth.velocity_ned + velocity,
        euler=truth.euler + euler,
        airspeed=truth.airspeed + airspeed,
    )
    formation = frame.formation
    if believed is not None:
        formation = formation._replace(believed_ned=np.array(believed, dtype=float))
    return frame._replace(estimate=estimate, formation=formation)


def still(k, followers=2, **more):
    return a_frame(k, np.ones((followers, 3)), **more)


def test_the_errors_of_an_estimate_by_hand():
    # a 3-4-5 triangle level, 2 m up, in turn with none at all: RMS are 1/√2 of these
    seen = [
        believing(
            still(k),
            position=[3.0, -4.0, 2.0] if k % 2 else 0.0,
            velocity=[2.0, -1.0, 2.0] if k % 2 else 0.0,
            euler=np.radians([0.6, -0.8, 4.0]) if k % 2 else 0.0,
            airspeed=-1.5 if k % 2 else 0.0,
        )
        for k in range(50)
    ]
    off = measure(seen, run_info())["estimate_error"]
    assert list(off) == ["leader", "uav1", "uav2"]
    whole = np.array([5.0, 2.0, 3.0, 1.0, 4.0, 1.5])
    expected = dict(zip(KINDS, whole / math.sqrt(2.0), strict=True))
    for numbers in off.values():
        largest = numbers.pop("largest_horizontal_m")
        # positions of 100 m know differences to 1e-14 m, angles of 9 rad theirs to 1e-15 rad
        assert largest == pytest.approx(5.0, abs=1e-12)
        assert numbers == pytest.approx(expected, abs=1e-12)


def test_a_heading_is_off_by_less_than_half_a_turn():
    seen = [believing(still(k), euler=[0.0, 0.0, 2.0 * math.pi - 0.1]) for k in range(20)]
    off = measure(seen, run_info())["estimate_error"]["uav1"]
    assert off["heading_deg"] == pytest.approx(math.degrees(0.1), rel=1e-12)
    rolled = [believing(still(k), euler=[-2.0 * math.pi - 0.2, 0.0, 0.0]) for k in range(20)]
    off = measure(rolled, run_info())["estimate_error"]["uav1"]
    assert off["tilt_deg"] == pytest.approx(math.degrees(0.2), rel=1e-12)


def test_what_all_have_in_common_a_formation_does_not_feel():
    # 30 m for everyone; uav1 is off by another 1 m north in turn with 1 m south
    seen = []
    for k in range(40):
        own = np.zeros((3, 3))
        own[1, 0] = 1.0 if k % 2 else -1.0
        seen.append(believing(still(k), position=own + [30.0, 0.0, 0.0]))
    summary = measure(seen, run_info())
    assert summary["relative_position_m"]["uav1"] == pytest.approx(1.0, abs=1e-12)
    assert summary["relative_position_m"]["uav2"] == pytest.approx(0.0, abs=1e-12)
    assert summary["estimate_error"]["uav2"]["horizontal_m"] == pytest.approx(30.0, rel=1e-12)


def test_what_is_believed_stands_beside_what_is():
    # uav1 believes to be in its slot and is √3 m off; uav2 believes to be 3 m off in half its time
    seen = [
        believing(still(k), position=1.0, believed=[[0.0, 0.0, 0.0], [3.0 * (k % 2), 0.0, 0.0]])
        for k in range(100)
    ]
    summary = measure(seen, run_info(portions={"all": (0.0, 4.0), "never": (5.0, 6.0)}))
    portion = summary["portions"]["all"]
    assert portion["rms_m"]["uav1"] == pytest.approx(math.sqrt(3.0), rel=1e-13)
    assert portion["believed_rms_m"]["uav1"] == 0.0
    assert portion["believed_rms_m"]["uav2"] == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-13)
    mean = 1.5 / math.sqrt(2.0)
    assert portion["believed_mean_rms_m"] == pytest.approx(mean, rel=1e-13)
    assert summary["portions"]["never"]["believed_mean_rms_m"] is None


@pytest.mark.parametrize("count", [1, BLOCK + 3])
def test_exact_estimates_are_off_by_nothing_and_believed_is_true(count):
    summary = measure(list(random_run(count, 3)), run_info(3, {"all": (0.0, 100.0)}))
    portion = summary["portions"]["all"]
    assert portion["believed_rms_m"] == portion["rms_m"]
    assert portion["believed_mean_rms_m"] == portion["mean_rms_m"]
    numbers = [value for each in summary["estimate_error"].values() for value in each.values()]
    assert numbers == [0.0] * 28
    assert list(summary["relative_position_m"].values()) == [0.0] * 3
    assert exact(summary["estimate_error"])
    assert not describe(summary["estimate_error"], summary["relative_position_m"])


def test_estimates_change_no_other_number():
    seen = list(random_run(BLOCK + 60, 3))
    info = run_info(3, {"all": (0.0, 100.0)})
    erring = [believing(frame, position=1.0, euler=0.1, believed=np.ones((3, 3))) for frame in seen]
    plain, other = measure(seen, info), measure(erring, info)
    for summary in (plain, other):
        del summary["estimate_error"], summary["relative_position_m"]
        for key in ("believed_rms_m", "believed_mean_rms_m"):
            del summary["portions"]["all"][key]
    assert plain == other


@pytest.mark.parametrize("begin", [0, 100, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 5])
def test_a_second_route_over_estimates_that_begin_to_err(begin):
    rng = np.random.default_rng(begin)
    seen, off, felt = [], [], []
    for k, frame in enumerate(random_run(2 * BLOCK + 40, 3)):
        position, velocity, euler = rng.normal(0.0, 0.4, (3, 4, 3)) * (k >= begin)
        airspeed = rng.normal(0.0, 1.0, 4) * (k >= begin)
        believed = rng.normal(0.0, 2.0, (3, 3)) if k >= begin else frame.formation.error_ned
        off.append((position, velocity, euler, airspeed))
        felt.append(believed)
        if k >= begin:
            frame = believing(
                frame,
                position=position,
                velocity=velocity,
                euler=euler,
                airspeed=airspeed,
                believed=believed,
            )
        seen.append(frame)
    summary = measure(seen, run_info(3, {"late": (8.0, 100.0)}))
    position, velocity, euler, airspeed = (np.stack(each) for each in zip(*off, strict=True))
    angles = np.degrees(euler)
    wanted = [
        np.hypot(position[..., 0], position[..., 1]),
        np.abs(position[..., 2]),
        np.linalg.norm(velocity, axis=-1),
        np.linalg.norm(angles[..., :2], axis=-1),
        angles[..., 2],
        airspeed,
    ]
    for i, numbers in enumerate(summary["estimate_error"].values()):
        rms = [math.sqrt(math.fsum(each[:, i] ** 2) / len(seen)) for each in wanted]
        # estimates less truths: positions of 500 m lose 1e-13 m, angles less
        assert list(numbers.values())[:6] == pytest.approx(rms, rel=1e-9)
        largest = wanted[0][:, i].max()
        assert numbers["largest_horizontal_m"] == pytest.approx(largest, rel=1e-9)
    between = np.linalg.norm(position[:, 1:] - position[:, :1], axis=-1)
    relative = np.sqrt(np.mean(between**2, axis=0))
    assert list(summary["relative_position_m"].values()) == pytest.approx(relative, rel=1e-9)
    late = np.linalg.norm(np.stack(felt)[8 * FRAME_RATE_HZ :], axis=-1)
    believed = np.sqrt(np.mean(late**2, axis=0))
    portion = summary["portions"]["late"]
    assert list(portion["believed_rms_m"].values()) == pytest.approx(believed, rel=1e-13)


def test_a_lost_aircraft_counts_until_it_was_lost():
    # off by 2 m level while they fly; of a lost one the estimate is wild, and then not a number
    seen = []
    for k in range(100):
        wild = np.zeros((3, 1)) if k < 50 else np.array([[0.0], [math.nan if k > 70 else 1e6], [0]])
        off = [2.0, 0.0, 0.0] * np.array([[0.0], [1.0], [1.0]]) + wild
        frame = still(k, lost=(1,) if k >= 50 else ())
        believed = frame.formation.error_ned + off[1:]
        seen.append(believing(frame, position=off, believed=believed))
    summary = measure(seen, run_info(portions={"all": (0.0, 4.0)}))
    off = summary["estimate_error"]
    assert off["uav1"]["horizontal_m"] == pytest.approx(2.0, rel=1e-12)
    assert off["uav1"]["largest_horizontal_m"] == pytest.approx(2.0, rel=1e-12)
    assert off["uav1"]["height_m"] == 0.0
    assert summary["relative_position_m"] == pytest.approx({"uav1": 2.0, "uav2": 2.0}, rel=1e-12)
    believed = summary["portions"]["all"]["believed_rms_m"]
    assert believed == pytest.approx(dict.fromkeys(("uav1", "uav2"), math.sqrt(11.0)), rel=1e-12)


def test_an_estimate_that_is_not_a_number_gives_none_and_is_named():
    nothing = [[0.0], [math.nan], [0.0]] * np.ones(3)
    seen = [believing(still(k), position=nothing if k == 7 else 1.0) for k in range(20)]
    summary = measure(seen, run_info())
    assert summary["estimate_error"]["uav1"]["horizontal_m"] is None
    assert summary["estimate_error"]["uav1"]["airspeed_mps"] == 0.0
    assert summary["relative_position_m"]["uav1"] is None
    assert summary["estimate_error"]["uav2"]["horizontal_m"] > 1.3
    lines = describe(summary["estimate_error"], summary["relative_position_m"])
    assert lines[-1] == "not a number: uav1"


def numbers(**some):
    return dict.fromkeys((*KINDS, "largest_horizontal_m"), 0.0) | some


def test_the_lines_people_read():
    # 3 m and 4 m of two that err: √(25/2) m together
    off = {
        "leader": numbers(),
        "uav1": numbers(horizontal_m=3.0, height_m=0.5, heading_deg=2.0),
        "uav2": numbers(horizontal_m=4.0, height_m=0.5, heading_deg=2.0),
    }
    assert describe(off, {"uav1": 3.0, "uav2": 4.0}) == [
        "3.54 m horizontal, 0.50 m height, heading 2.0°",
        "relative to the leader 3.54 m, at worst 4.00 m (uav2)",
        "over the 2 of 3 aircraft that err",
    ]
    of_all = dict.fromkeys(("leader", "uav1"), dict.fromkeys(numbers(), 1.25))
    assert describe(of_all, {"uav1": 0.5}) == [
        "1.25 m horizontal, 1.25 m height, 1.25 m/s",
        "airspeed 1.25 m/s, tilt 1.2°, heading 1.2°",
        "relative to the leader 0.50 m",
    ]
