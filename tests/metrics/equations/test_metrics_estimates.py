"""Metrics of estimates: known samples, and a second computation over the whole run."""

import math

import numpy as np
import pytest
from test_metrics import (
    FRAME_RATE_HZ,
    SPAN,
    make_sample,
    measure,
    random_run,
    run_info,
    short_spans,
)

from testbed.metrics.facts import describe_estimates, exact

assert short_spans  # a fixture
KINDS = ("horizontal_m", "height_m", "velocity_mps", "tilt_deg", "heading_deg", "airspeed_mps")


def with_estimates(sample, *, position=0.0, velocity=0.0, euler=0.0, airspeed=0.0, estimated=None):
    """Add errors to the estimates of a sample, each broadcast over the aircraft."""
    truth = sample.truth
    estimate = truth._replace(
        position_ned=truth.position_ned + position,
        velocity_ned=truth.velocity_ned + velocity,
        euler=truth.euler + euler,
        airspeed=truth.airspeed + airspeed,
    )
    formation = sample.formation
    if estimated is not None:
        formation = formation._replace(estimated_error_ned=np.array(estimated, dtype=float))
    return sample._replace(estimate=estimate, formation=formation)


def still(k, followers=2, **more):
    return make_sample(k, np.ones((followers, 3)), **more)


def test_estimate_errors_of_known_samples():
    # a 3-4-5 triangle level, 2 m up, in turn with none at all: RMS are 1/√2 of these
    samples = [
        with_estimates(
            still(k),
            position=[3.0, -4.0, 2.0] if k % 2 else 0.0,
            velocity=[2.0, -1.0, 2.0] if k % 2 else 0.0,
            euler=np.radians([0.6, -0.8, 4.0]) if k % 2 else 0.0,
            airspeed=-1.5 if k % 2 else 0.0,
        )
        for k in range(50)
    ]
    errors = measure(samples, run_info())["estimate_error"]
    assert list(errors) == ["leader", "uav1", "uav2"]
    whole = np.array([5.0, 2.0, 3.0, 1.0, 4.0, 1.5])
    expected = dict(zip(KINDS, whole / math.sqrt(2.0), strict=True))
    for numbers in errors.values():
        largest = numbers.pop("max_horizontal_m")
        # positions of 100 m know differences to 1e-14 m, angles of 9 rad theirs to 1e-15 rad
        assert largest == pytest.approx(5.0, abs=1e-12)
        assert numbers == pytest.approx(expected, abs=1e-12)


def test_angle_errors_are_below_half_a_turn():
    samples = [with_estimates(still(k), euler=[0.0, 0.0, 2.0 * math.pi - 0.1]) for k in range(20)]
    errors = measure(samples, run_info())["estimate_error"]["uav1"]
    assert errors["heading_deg"] == pytest.approx(math.degrees(0.1), rel=1e-12)
    rolled = [with_estimates(still(k), euler=[-2.0 * math.pi - 0.2, 0.0, 0.0]) for k in range(20)]
    errors = measure(rolled, run_info())["estimate_error"]["uav1"]
    assert errors["tilt_deg"] == pytest.approx(math.degrees(0.2), rel=1e-12)


def test_relative_error_ignores_a_common_offset():
    # 30 m for all; uav1 is off by another 1 m north in turn with 1 m south
    samples = []
    for k in range(40):
        own = np.zeros((3, 3))
        own[1, 0] = 1.0 if k % 2 else -1.0
        samples.append(with_estimates(still(k), position=own + [30.0, 0.0, 0.0]))
    summary = measure(samples, run_info())
    assert summary["relative_position_error_m"]["uav1"] == pytest.approx(1.0, abs=1e-12)
    assert summary["relative_position_error_m"]["uav2"] == pytest.approx(0.0, abs=1e-12)
    assert summary["estimate_error"]["uav2"]["horizontal_m"] == pytest.approx(30.0, rel=1e-12)


def test_estimated_rms_beside_the_true_one():
    # estimated: uav1 in its slot, uav2 3 m off half the time; in truth both are √3 m off
    samples = [
        with_estimates(
            still(k), position=1.0, estimated=[[0.0, 0.0, 0.0], [3.0 * (k % 2), 0.0, 0.0]]
        )
        for k in range(100)
    ]
    summary = measure(samples, run_info(windows={"all": (0.0, 4.0), "never": (5.0, 6.0)}))
    window = summary["windows"]["all"]
    assert window["rms_m"]["uav1"] == pytest.approx(math.sqrt(3.0), rel=1e-13)
    assert window["estimated_rms_m"]["uav1"] == 0.0
    assert window["estimated_rms_m"]["uav2"] == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-13)
    mean = 1.5 / math.sqrt(2.0)
    assert window["estimated_mean_rms_m"] == pytest.approx(mean, rel=1e-13)
    assert summary["windows"]["never"]["estimated_mean_rms_m"] is None


@pytest.mark.parametrize("count", [1, SPAN + 3])
def test_exact_estimates_have_no_error(count):
    summary = measure(random_run(count, 3), run_info(3, {"all": (0.0, 100.0)}))
    window = summary["windows"]["all"]
    assert window["estimated_rms_m"] == window["rms_m"]
    assert window["estimated_mean_rms_m"] == window["mean_rms_m"]
    numbers = [value for each in summary["estimate_error"].values() for value in each.values()]
    assert numbers == [0.0] * 28
    assert list(summary["relative_position_error_m"].values()) == [0.0] * 3
    assert exact(summary["estimate_error"])
    assert not describe_estimates(summary["estimate_error"], summary["relative_position_error_m"])


def test_estimates_change_no_other_number():
    samples = random_run(SPAN + 60, 3)
    info = run_info(3, {"all": (0.0, 100.0)})
    erring = [
        with_estimates(sample, position=1.0, euler=0.1, estimated=np.ones((3, 3)))
        for sample in samples
    ]
    plain, other = measure(samples, info), measure(erring, info)
    for summary in (plain, other):
        del summary["estimate_error"], summary["relative_position_error_m"]
        del summary["ringing"]  # it is not looked for where estimates have errors
        for key in ("estimated_rms_m", "estimated_mean_rms_m"):
            del summary["windows"]["all"][key]
    assert plain == other


@pytest.mark.parametrize("begin", [0, 100, SPAN - 1, SPAN, SPAN + 1, 2 * SPAN + 5])
def test_estimates_that_err_from_a_sample_on(begin):
    """A second computation over the whole run gives the same numbers."""
    rng = np.random.default_rng(begin)
    samples, errors, errors_ned = [], [], []
    for k, sample in enumerate(random_run(2 * SPAN + 40, 3)):
        position, velocity, euler = rng.normal(0.0, 0.4, (3, 4, 3)) * (k >= begin)
        airspeed = rng.normal(0.0, 1.0, 4) * (k >= begin)
        estimated = rng.normal(0.0, 2.0, (3, 3)) if k >= begin else sample.formation.error_ned
        errors.append((position, velocity, euler, airspeed))
        errors_ned.append(estimated)
        if k >= begin:
            sample = with_estimates(
                sample,
                position=position,
                velocity=velocity,
                euler=euler,
                airspeed=airspeed,
                estimated=estimated,
            )
        samples.append(sample)
    summary = measure(samples, run_info(3, {"late": (8.0, 100.0)}))
    position, velocity, euler, airspeed = (np.stack(each) for each in zip(*errors, strict=True))
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
        rms = [math.sqrt(math.fsum(each[:, i] ** 2) / len(samples)) for each in wanted]
        # estimates less truths: positions of 500 m lose 1e-13 m, angles less
        assert list(numbers.values())[:6] == pytest.approx(rms, rel=1e-9)
        largest = wanted[0][:, i].max()
        assert numbers["max_horizontal_m"] == pytest.approx(largest, rel=1e-9)
    between = np.linalg.norm(position[:, 1:] - position[:, :1], axis=-1)
    relative = np.sqrt(np.mean(between**2, axis=0))
    assert list(summary["relative_position_error_m"].values()) == pytest.approx(relative, rel=1e-9)
    late = np.linalg.norm(np.stack(errors_ned)[8 * FRAME_RATE_HZ :], axis=-1)
    estimated = np.sqrt(np.mean(late**2, axis=0))
    window = summary["windows"]["late"]
    assert list(window["estimated_rms_m"].values()) == pytest.approx(estimated, rel=1e-13)


def test_estimates_count_until_lost():
    # off by 2 m level while they fly; of a lost one the estimate is wild, and then not a number
    samples = []
    for k in range(100):
        wild = np.zeros((3, 1)) if k < 50 else np.array([[0.0], [math.nan if k > 70 else 1e6], [0]])
        errors = [2.0, 0.0, 0.0] * np.array([[0.0], [1.0], [1.0]]) + wild
        sample = still(k, lost=(1,) if k >= 50 else ())
        estimated = sample.formation.error_ned + errors[1:]
        samples.append(with_estimates(sample, position=errors, estimated=estimated))
    summary = measure(samples, run_info(windows={"all": (0.0, 4.0)}))
    errors = summary["estimate_error"]
    assert errors["uav1"]["horizontal_m"] == pytest.approx(2.0, rel=1e-12)
    assert errors["uav1"]["max_horizontal_m"] == pytest.approx(2.0, rel=1e-12)
    assert errors["uav1"]["height_m"] == 0.0
    assert summary["relative_position_error_m"] == pytest.approx(
        {"uav1": 2.0, "uav2": 2.0}, rel=1e-12
    )
    estimated = summary["windows"]["all"]["estimated_rms_m"]
    assert estimated == pytest.approx(dict.fromkeys(("uav1", "uav2"), math.sqrt(11.0)), rel=1e-12)


def test_nan_estimate_gives_none_and_is_named():
    nothing = [[0.0], [math.nan], [0.0]] * np.ones(3)
    samples = [with_estimates(still(k), position=nothing if k == 7 else 1.0) for k in range(20)]
    summary = measure(samples, run_info())
    assert summary["estimate_error"]["uav1"]["horizontal_m"] is None
    assert summary["estimate_error"]["uav1"]["airspeed_mps"] == 0.0
    assert summary["relative_position_error_m"]["uav1"] is None
    assert summary["estimate_error"]["uav2"]["horizontal_m"] > 1.3
    lines = describe_estimates(summary["estimate_error"], summary["relative_position_error_m"])
    assert lines[-1] == "NaN: uav1"


def numbers(**some):
    return dict.fromkeys((*KINDS, "max_horizontal_m"), 0.0) | some


def test_lines_on_estimates():
    # 3 m and 4 m of two that err: √(25/2) m together
    errors = {
        "leader": numbers(),
        "uav1": numbers(horizontal_m=3.0, height_m=0.5, heading_deg=2.0),
        "uav2": numbers(horizontal_m=4.0, height_m=0.5, heading_deg=2.0),
    }
    assert describe_estimates(errors, {"uav1": 3.0, "uav2": 4.0}) == [
        "horizontal 3.54 m, height 0.50 m",
        "heading 2.0°",
        "relative to leader 3.54 m, max 4.00 m (uav2)",
        "over the 2 of 3 aircraft with errors",
    ]
    of_all = dict.fromkeys(("leader", "uav1"), dict.fromkeys(numbers(), 1.25))
    assert describe_estimates(of_all, {"uav1": 0.5}) == [
        "horizontal 1.25 m, height 1.25 m",
        "velocity 1.25 m/s, airspeed 1.25 m/s",
        "tilt 1.2°, heading 1.2°",
        "relative to leader 0.50 m",
    ]


def test_relative_error_ends_with_the_leader():
    """Of a constant 3 m, of which samples without a slot are no part: neither of sum nor count."""
    samples = [
        with_estimates(
            still(k, lost=(0,) if k >= 30 else (2,) if k >= 20 else ()),
            # that of the leader is 1 m; after its loss 50 m
            position=[[0.0, 1.0 if k < 30 else 50.0, 0.0], [0.0, 4.0, 0.0], [0.0, 4.0, 0.0]],
        )
        for k in range(80)
    ]
    relative = measure(samples, run_info())["relative_position_error_m"]
    # positions of 100 m know differences to 1e-14 m
    assert relative == pytest.approx({"uav1": 3.0, "uav2": 3.0}, abs=1e-12)
