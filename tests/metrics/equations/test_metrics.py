"""Metrics of a run: known samples, and a second computation over the whole run."""

import math
from functools import cache

import numpy as np
import pytest
from reference.frames import velocity_frame

from testbed.core import samples as core_samples
from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.records import (
    ActuatorCommand,
    AirData,
    Event,
    FbwaCommand,
    FormationState,
    LinkCounters,
    NedOrigin,
    RunInfo,
    Sample,
    VehicleState,
)
from testbed.metrics import accumulator
from testbed.metrics.facts import describe_wind
from testbed.metrics.observer import MetricsObserver

BASE_RATE_HZ, FRAME_RATE_HZ = 200, 25
SPAN = 256  # samples that are summed together here: longer than a block of 200, too
LONGEST = 3 * SPAN + 17  # samples of a random run


@pytest.fixture(autouse=True)
def short_spans(monkeypatch):
    """Four times as many samples take as much longer to make."""
    assert accumulator.SPAN > SPAN
    monkeypatch.setattr(accumulator, "SPAN", SPAN)


def run_info(followers=2, windows=None):
    names = ("leader", *(f"uav{i}" for i in range(1, followers + 1)))
    return RunInfo(
        scenario_name="by-hand",
        make_yaml=str,
        names=names,
        aircraft=("rascal110",) * len(names),
        wingspan_m=(2.8,) * len(names),
        origin=NedOrigin(),
        base_rate_hz=BASE_RATE_HZ,
        sample_rate_hz=FRAME_RATE_HZ,
        duration_s=100.0,
        seed=1,
        speed_bounds_mps=((16.0, 30.0),) * followers,
        kappa_mps=(3.6,) * followers,
        roll_limit_rad=(0.8,) * followers,
        leader_path_ned=np.zeros((0, 3)),
        windows=windows or {},
        versions={"testbed": "0"},
    )


@cache
def constants(n):
    """Arrays of all samples of so many followers, which none may change."""
    links = np.zeros((2, n, n + 1), dtype=np.uint32)
    out = np.zeros(n + 1), np.zeros(n), np.zeros((n + 1, 3)), links, np.full((n, n + 1), np.nan)
    for each in out:
        each.flags.writeable = False
    return out


def make_sample(
    k,
    errors,
    *,
    offsets=None,
    bank=0.0,
    limiter_flags=None,
    saturations=None,
    wind=(0.0, 0.0, 0.0),
    roll=0.0,
    throttle=0.0,
    lost=(),
):
    """Sample k: the leader flies north, slots lie at the offsets, followers err by the errors.

    Aircraft of the rows `lost` are lost; estimates are exact.
    """
    errors = np.array(errors, dtype=float).reshape(-1, 3)
    n = len(errors)
    offsets = 20.0 * np.eye(n, 3) if offsets is None else np.array(offsets, dtype=float)
    leader = np.array([22.0 * k / FRAME_RATE_HZ, 5.0, -100.0])
    slot = leader + offsets
    zeros, none, vectors, links, ages = constants(n)
    state = VehicleState(
        position_ned=np.vstack([leader, slot + errors]),
        velocity_ned=vectors,
        acceleration_ned=vectors,
        euler=np.array([[bank, 0.0, 0.0], *[[9.0] * 3] * n]),
        rates_body=vectors,
        airspeed=zeros,
        equivalent_airspeed=zeros,
    )
    tick = 8 * k
    return Sample(
        tick=tick,
        time_s=tick / BASE_RATE_HZ,
        truth=state,
        estimate=state,
        air=AirData(zeros, zeros, zeros, vectors + wind, vectors, zeros + roll, zeros, zeros),
        command=FbwaCommand(zeros, zeros, zeros + throttle),
        surfaces=ActuatorCommand(zeros, zeros, zeros, zeros),
        formation=FormationState(
            slot,
            errors,
            *[none] * 7,
            limiter_flags=np.array(limiter_flags or [0] * n, dtype=np.uint8),
            saturations=np.array(saturations or [0] * n, dtype=np.uint8),
            age_s=ages,
            slot_index=np.arange(1, n + 1, dtype=np.uint32),
            estimated_error_ned=errors,
        ),
        links=LinkCounters(*links),
        lost=np.array([each in lost for each in range(n + 1)]),
    )


def measure(samples, info, **options):
    meter = MetricsObserver(**options)
    meter.begin(info)
    for sample in samples:
        meter.observe(sample)
    return meter.summary()


def test_rms_errors_of_known_samples():
    # uav1 errs by 3 and 4 m in turn, 5 m from the leader: RMS sqrt((9 + 16) / 2) = 5 / sqrt(2),
    # a ratio of 1 / sqrt(2). uav2 errs by 2 m always, 10 m from the leader: 2 m, a ratio of 0.2.
    offsets = [[3.0, 4.0, 0.0], [0.0, 0.0, 10.0]]
    samples = [
        make_sample(k, [[0.0, 3.0 + k % 2, 0.0], [0.0, 2.0, 0.0]], offsets=offsets)
        for k in range(50)
    ]
    window = measure(samples, run_info(windows={"all": (0.0, 2.0)}))["windows"]["all"]
    # some roundings of double precision
    assert window["rms_m"]["uav1"] == pytest.approx(5.0 / math.sqrt(2.0), rel=1e-13)
    assert window["rms_m"]["uav2"] == pytest.approx(2.0, rel=1e-13)
    mean = (5.0 / math.sqrt(2.0) + 2.0) / 2.0
    assert window["mean_rms_m"] == pytest.approx(mean, rel=1e-13)
    percent = 100.0 * (1.0 / math.sqrt(2.0) + 0.2) / 2.0
    assert window["percent_error"] == pytest.approx(percent, rel=1e-12)
    assert window["max_error_m"] == {"uav1": 4.0, "uav2": 2.0}


def test_window_includes_its_start_and_not_its_end():
    # samples at 0, 0.04, ..., 3.96 s; error k metres in sample k; [1, 2) s is samples 25 to 49
    samples = [make_sample(k, [[float(k), 0.0, 0.0]]) for k in range(100)]
    window = measure(samples, run_info(1, {"one": (1.0, 2.0)}))["windows"]["one"]
    squares = sum(k * k for k in range(25, 50))
    assert window["rms_m"]["uav1"] == pytest.approx(math.sqrt(squares / 25.0), rel=1e-13)
    assert window["max_error_m"]["uav1"] == 49.0
    assert window["covered_s"] == 1.0
    assert window["complete"]


def test_adjacent_windows_share_no_sample():
    samples = [make_sample(k, [[1.0, 0.0, 0.0]]) for k in range(100)]
    windows = measure(samples, run_info(1, {"a": (0.0, 1.52), "b": (1.52, 4.0)}))["windows"]
    assert windows["a"]["covered_s"] == 38 / FRAME_RATE_HZ
    assert windows["b"]["covered_s"] == 62 / FRAME_RATE_HZ


def test_window_not_reached_has_no_numbers():
    samples = [make_sample(k, [[1.0, 0.0, 0.0]]) for k in range(75)]
    windows = measure(samples, run_info(1, {"half": (2.0, 4.0), "none": (5.0, 6.0)}))["windows"]
    assert windows["half"]["covered_s"] == 1.0
    assert not windows["half"]["complete"]
    assert windows["half"]["rms_m"] == {"uav1": 1.0}
    nothing = {"window_s": [5.0, 6.0], "covered_s": 0.0, "complete": False}
    nothing |= {"rms_m": {"uav1": None}, "mean_rms_m": None, "percent_error": None}
    nothing |= {"estimated_rms_m": {"uav1": None}, "estimated_mean_rms_m": None}
    nothing |= {"kappa_mps": {"uav1": None}, "slot_speed_mps": {"uav1": [None, None]}}
    nothing |= {"max_error_m": {"uav1": None}, "leader_bank_deg": None, "min_separation_m": None}
    assert windows["none"] == nothing


def test_nan_error_gives_no_rms():
    samples = [
        make_sample(k, [[math.nan if k > 30 else 1.0, 0, 0], [2.0, 0, 0]]) for k in range(50)
    ]
    summary = measure(samples, run_info(windows={"all": (0.0, 2.0)}))
    assert summary["windows"]["all"]["rms_m"] == {"uav1": None, "uav2": 2.0}
    assert summary["windows"]["all"]["mean_rms_m"] is None
    assert summary["min_separation_m"] is not None


def test_lost_follower_counts_until_lost():
    # 3 m off for 25 samples, 4 m for 25, and then on the ground, a kilometre away and not a number
    samples = []
    for k in range(100):
        own = [3.0 if k < 25 else 4.0, 0.0, 0.0] if k < 50 else [1000.0 if k < 60 else math.nan] * 3
        lost = (1,) if k >= 50 else ()
        samples.append(
            make_sample(k, [own, [0.0, 2.0, 0.0]], lost=lost, throttle=0.5 if k < 50 else 0.0)
        )
    windows = {"all": (0.0, 4.0), "late": (3.0, 4.0)}
    summary = measure(samples, run_info(windows=windows))
    both, late = summary["windows"]["all"], summary["windows"]["late"]
    assert summary["lost_at_s"] == {"leader": None, "uav1": 2.0, "uav2": None}
    assert both["rms_m"]["uav1"] == pytest.approx(math.sqrt(12.5), rel=1e-13)
    assert both["rms_m"]["uav2"] == pytest.approx(2.0, rel=1e-13)
    assert both["mean_rms_m"] == pytest.approx((math.sqrt(12.5) + 2.0) / 2.0, rel=1e-13)
    # slots are 20 m from the leader
    percent = 100.0 * (math.sqrt(12.5) + 2.0) / 2.0 / 20.0
    assert both["percent_error"] == pytest.approx(percent, rel=1e-13)
    assert both["max_error_m"] == {"uav1": 4.0, "uav2": 2.0}
    assert summary["max_error_m"] == {"uav1": 4.0, "uav2": 2.0}
    assert both["complete"]
    assert late["rms_m"] == {"uav1": None, "uav2": 2.0}
    assert late["mean_rms_m"] == late["estimated_mean_rms_m"] == 2.0
    assert late["max_error_m"]["uav1"] is None
    # of the time it flew
    assert summary["mean_throttle"]["uav1"] == pytest.approx(0.5, rel=1e-13)
    assert summary["mean_throttle"]["uav2"] == pytest.approx(0.25, rel=1e-13)


def test_lost_leader_ends_errors_of_followers():
    samples = [
        make_sample(
            k, np.full((2, 3), 1.0 if k < 50 else 500.0), lost=(0,) if k >= 50 else (), bank=k
        )
        for k in range(100)
    ]
    # the slots stop where the leader lies
    slot = samples[49].formation.slot_ned
    samples[50:] = [f._replace(formation=f.formation._replace(slot_ned=slot)) for f in samples[50:]]
    summary = measure(samples, run_info(windows={"all": (0.0, 4.0)}))
    window = summary["windows"]["all"]
    assert window["rms_m"] == pytest.approx(dict.fromkeys(("uav1", "uav2"), math.sqrt(3.0)))
    assert window["leader_bank_deg"] == summary["leader_bank_deg"] == math.degrees(49.0)
    # 22 m/s between bounds of 16 and 30, as long as there were slots; 1e-9: positions of 44 m
    assert summary["kappa_mps"]["uav1"] == pytest.approx(6.0, abs=1e-9)
    assert summary["recovery"]["uav1"]["in_slot_since_s"] is None


@pytest.mark.parametrize("at", [230, SPAN - 1, SPAN])
def test_separation_includes_the_sample_of_a_loss(at):
    """A collision counts, wreckage on the ground does not."""
    # uav2, 28 m from uav1, comes to 3 m and is lost by that; then others fly over it at 1 m
    samples = [
        make_sample(k, np.zeros((2, 3)), lost=(1, 2) if k >= at else ()) for k in range(at + 300)
    ]
    samples[at] = make_sample(at, [[0.0, 0.0, 0.0], [20.0, -20.0, 3.0]], lost=(1, 2))
    for k in range(at + 1, at + 300):
        samples[k] = make_sample(k, [[0.0, 0.0, 0.0], [20.0, -20.0, 1.0]], lost=(1, 2))
    summary = measure(samples, run_info())
    assert summary["min_separation_m"] == pytest.approx(3.0, rel=1e-12)
    assert summary["min_separation_at_s"] == at / FRAME_RATE_HZ
    assert summary["min_separation_between"] == ["uav1", "uav2"]
    assert summary["lost_at_s"] == {"leader": None} | dict.fromkeys(
        ("uav1", "uav2"), at / FRAME_RATE_HZ
    )


def test_separation_inside_and_outside_windows():
    """Of windows that overlap too; wherever a block of samples begins."""
    away = {30: 9.0, 60: 8.0, 90: 7.0, 110: 6.0}  # of the follower, whose slot is at 20 m

    def sample(k):
        return make_sample(k, [[away.get(k, 20.0) - 20.0, 0.0, 0.0]])

    spans = {"early": (1.0, 3.0), "late": (2.0, 4.0), "none": (9.0, 10.0)}  # samples 25 to 99
    summary = measure([sample(k) for k in range(150)], run_info(1, spans))
    inside = {name: each["min_separation_m"] for name, each in summary["windows"].items()}
    assert inside == {"early": pytest.approx(8.0), "late": pytest.approx(7.0), "none": None}
    assert summary["min_separation_outside_windows_m"] == summary["min_separation_m"]
    assert summary["min_separation_m"] == pytest.approx(6.0)
    everywhere = measure([sample(k) for k in range(150)], run_info(1, {"all": (0.0, 10.0)}))
    assert everywhere["windows"]["all"]["min_separation_m"] == pytest.approx(6.0)
    assert everywhere["min_separation_outside_windows_m"] is None


def test_flags_of_a_lost_follower_do_not_count():
    limiter_flags, saturations = (
        [int(LimiterFlag.OUTSIDE_SPEED_SET)] * 2,
        [int(Saturation.PITCH)] * 2,
    )
    flags = {"limiter_flags": limiter_flags, "saturations": saturations}
    samples = [make_sample(0, np.zeros((2, 3)))]
    samples += [make_sample(k, np.zeros((2, 3)), lost=(2,), **flags) for k in range(1, 11)]
    summary = measure(samples, run_info())
    assert [summary["limiter_flags"][name]["samples"] for name in ("uav1", "uav2")] == [10, 0]
    assert [summary["saturations"][name]["samples"] for name in ("uav1", "uav2")] == [10, 0]
    assert summary["left_speed_set"]["uav2"] == {"times": 0, "first_s": None}
    assert summary["recovery"]["uav2"]["last_saturated_s"] is None


def test_lost_follower_in_its_slot_does_not_join():
    samples = [make_sample(k, [[0.0, 0.0, 0.0]], lost=(1,) if k >= 50 else ()) for k in range(400)]
    summary = measure(samples, run_info(1))
    assert summary["joined_at_s"]["uav1"] is None
    assert summary["recovery"]["uav1"]["in_slot_since_s"] is None


def test_wind_counts_until_lost():
    samples = [
        make_sample(
            k, [[0.0, 0.0, 0.0]], wind=(4.0, 0.0, 0.0) if k < 30 else (90.0, 0.0, 0.0), roll=k
        )
        for k in range(60)
    ]
    samples[30:] = [sample._replace(lost=np.array([False, True])) for sample in samples[30:]]
    wind = measure(samples, run_info(1))["wind"]
    assert wind["uav1"]["mean_ned_mps"] == pytest.approx([4.0, 0.0, 0.0], rel=1e-13)
    assert wind["uav1"]["max_mps"] == 4.0
    assert wind["uav1"]["max_wake_delta_cl"] == 29.0
    assert wind["leader"]["mean_ned_mps"] == pytest.approx([47.0, 0.0, 0.0], rel=1e-13)


def joined(distances):
    samples = [make_sample(k, [[distance, 0.0, 0.0]]) for k, distance in enumerate(distances)]
    summary = measure(samples, run_info(1))
    return summary["joined_at_s"]["uav1"], summary["recovery"]["uav1"]["in_slot_since_s"]


def test_joined_from_the_first_5_s_in_the_slot():
    out, inside = 6.0, 5.0  # 5 m is inside
    five = 5 * FRAME_RATE_HZ
    assert joined([out] * 10 + [inside] * (five + 1)) == (0.4, 0.4)
    assert joined([out] * 10 + [inside] * five) == (None, 0.4)  # 5 s are not over
    assert joined([inside] * five + [out] + [inside] * (five + 1)) == (5.04, 5.04)
    assert joined([inside] * (five + 1) + [out] * 3 + [inside]) == (0.0, 5.16)
    assert joined([inside] * (five + 1) + [out]) == (0.0, None)


@pytest.mark.parametrize("start", [SPAN - 126, SPAN - 125, SPAN - 1, SPAN, SPAN + 1])
def test_joining_across_blocks_equals_a_plain_count(start):
    # the same rule sample by sample, without blocks
    distances = [9.0] * start + [1.0] * 200 + [9.0] * 3 + [1.0] * 300
    assert joined(distances) == (start / FRAME_RATE_HZ, (start + 203) / FRAME_RATE_HZ)


def test_separation_has_pair_and_time():
    # slots 20 m north and 20 m east of the leader: 28.28 m apart, until uav2 comes within 3 m of
    # uav1 in sample 300, which is in the second block
    samples = [make_sample(k, np.zeros((2, 3))) for k in range(600)]
    samples[300] = make_sample(300, [[0.0, 0.0, 0.0], [20.0, -20.0, 3.0]])
    summary = measure(samples, run_info())
    assert summary["min_separation_m"] == pytest.approx(3.0, rel=1e-12)
    assert summary["min_separation_at_s"] == 12.0
    assert summary["min_separation_between"] == ["uav1", "uav2"]
    alone = measure([make_sample(0, np.zeros((0, 3)))], run_info(0))
    assert alone["min_separation_m"] is None


def test_limiter_flags_and_saturations_by_kind():
    clamp, outside = LimiterFlag.SPEED_DESIRED_CLAMPED, LimiterFlag.OUTSIDE_SPEED_SET
    pitch, throttle = Saturation.PITCH, Saturation.THROTTLE
    samples = [
        make_sample(
            0, np.zeros((2, 3)), limiter_flags=[clamp | outside, 0], saturations=[pitch, 0]
        ),
        make_sample(
            1,
            np.zeros((2, 3)),
            limiter_flags=[outside, 0],
            saturations=[pitch | throttle, throttle],
        ),
        make_sample(2, np.zeros((2, 3))),
    ]
    summary = measure(samples, run_info())
    one = summary["limiter_flags"]["uav1"]
    assert (one["samples"], one["seconds"]) == (2, 0.08)
    assert one["by_kind"] == {
        "speed_desired_clamped": 1,
        "outside_speed_set": 2,
        "speed_command_clipped": 0,
        "leader_timeout": 0,
        "closing_limited": 0,
        "closing_limits_infeasible": 0,
        "inside_separation_margin": 0,
    }
    assert summary["limiter_flags"]["uav2"]["samples"] == 0
    assert summary["saturations"]["uav1"]["by_kind"] == {"pitch": 2, "roll": 0, "throttle": 1}
    assert summary["saturations"]["uav2"]["samples"] == 1
    assert summary["recovery"]["uav1"]["last_saturated_s"] == 0.04
    assert measure(samples[2:], run_info())["recovery"]["uav1"]["last_saturated_s"] is None


@cache
def ringing(start):
    return measure(ringing_run(start), run_info(1))["ringing"]["uav1"]


def ringing_run(start, count=SPAN + 200):
    """A follower whose bank oscillates about 0.5 rad from a sample on, with ζ = 0.05 at 1 Hz."""
    for k in range(count):
        sample, since = make_sample(k, np.zeros((1, 3))), max(k - start, 0) / FRAME_RATE_HZ
        pulse = 2.0 * math.pi
        euler = sample.truth.euler.copy()
        euler[1, 0] = 0.5 + 0.3 * math.exp(-0.05 * pulse * since) * math.sin(pulse * since)
        truth = sample.truth._replace(euler=euler)
        yield sample._replace(truth=truth, estimate=truth)


@pytest.mark.parametrize("start", [SPAN - 20, SPAN - 19, SPAN - 7, SPAN - 6])
def test_ringing_across_blocks(start):
    early, late = (ringing(k) for k in (100, start))
    assert early["seconds"] > 3.0 and early["damping_ratio"] == pytest.approx(0.05, abs=2e-3)
    moved = (start - 100) / FRAME_RATE_HZ
    assert late == {**early, "last_s": pytest.approx(early["last_s"] + moved)}


def test_leader_bank_is_the_largest_magnitude():
    banks = [0.1, -0.5, 0.3, 0.2]
    samples = [make_sample(k, np.zeros((2, 3)), bank=bank) for k, bank in enumerate(banks)]
    summary = measure(samples, run_info(windows={"late": (0.08, 1.0)}))
    assert summary["leader_bank_deg"] == pytest.approx(math.degrees(0.5), rel=1e-15)
    assert summary["windows"]["late"]["leader_bank_deg"] == pytest.approx(math.degrees(0.3))


STRAIGHT_S, RADIUS, SPEED = 12.0, 120.0, 22.0


def circling(count, offsets):
    """A leader that flies north for 12 s, then round a circle to the right, and its slots."""
    for k in range(count):
        time = k / FRAME_RATE_HZ
        turned = max(time - STRAIGHT_S, 0.0) * SPEED / RADIUS
        north = min(time, STRAIGHT_S) * SPEED + RADIUS * np.sin(turned)
        position = np.array([north, RADIUS * (1.0 - np.cos(turned)), -100.0])
        forward = np.array([[np.cos(turned), np.sin(turned), 0.0]])
        slot = position + np.array(offsets) @ velocity_frame(forward)[0].T
        sample = make_sample(k, np.zeros((len(slot), 3)))
        yield sample._replace(formation=sample.formation._replace(slot_ned=slot))


def test_kappa_on_a_circle():
    # uav1 flies inside, on 105 m, uav2 outside and behind, on √(140² + 20²) m
    offsets = [[0.0, 15.0, 0.0], [-20.0, -20.0, 4.0]]
    windows = {"straight": (1.0, 11.0), "circle": (13.0, 40.0)}
    summary = measure(circling(1000, offsets), run_info(windows=windows))
    x = SPEED / RADIUS / FRAME_RATE_HZ
    chord = np.sin(x) / x  # of the central difference: 9e-6 below one
    inner = chord * SPEED * 105.0 / RADIUS
    outer = chord * SPEED * math.hypot(140.0, 20.0) / RADIUS
    circle, straight = summary["windows"]["circle"], summary["windows"]["straight"]
    # places of 300 m are known to 6e-14 m, their differences over 0.08 s to 2e-12 m/s
    close = {"abs": 1e-11}
    assert circle["kappa_mps"]["uav1"] == pytest.approx(inner - 16.0, **close)
    assert circle["kappa_mps"]["uav2"] == pytest.approx(30.0 - outer, **close)
    assert circle["slot_speed_mps"]["uav1"] == pytest.approx([inner, inner], **close)
    assert circle["slot_speed_mps"]["uav2"] == pytest.approx([outer, outer], **close)
    for name in ("uav1", "uav2"):
        assert straight["slot_speed_mps"][name] == pytest.approx([SPEED, SPEED], **close)
        assert straight["kappa_mps"][name] == pytest.approx(6.0, **close)
        # between the two the slot is neither faster nor slower than on either
        assert summary["kappa_mps"][name] == pytest.approx(circle["kappa_mps"][name], **close)
        assert summary["kappa_at_s"][name] > STRAIGHT_S
    assert summary["slot_speed_mps"]["uav1"] == pytest.approx([inner, SPEED], **close)
    assert summary["kappa_assumed_mps"] == {"uav1": 3.6, "uav2": 3.6}


def test_kappa_beyond_the_bounds_is_negative():
    summary = measure(circling(400, [[0.0, 40.0, 0.0]]), run_info(1))
    assert summary["kappa_mps"]["uav1"] == pytest.approx(SPEED * 80.0 / RADIUS - 16.0, abs=2e-4)


@pytest.mark.parametrize("count", [2, 3, SPAN, SPAN + 1, SPAN + 2, 2 * SPAN + 5])
def test_slot_speeds_across_blocks(count):
    rng = np.random.default_rng(8)
    # 44 m from sample to sample over the right distance: 2 m of jitter are 25 m/s
    samples = [
        make_sample(k, np.zeros((3, 3)), offsets=rng.normal(0.0, 2.0, (3, 3))) for k in range(count)
    ]
    summary = measure(samples, run_info(3, {"late": (1.0, 90.0)}))
    slots = np.array([sample.formation.slot_ned for sample in samples])
    speed = np.array(
        [
            [math.dist(a, b) / 0.08 for a, b in zip(*pair, strict=True)]
            for pair in zip(slots[:-2], slots[2:], strict=True)
        ]
    ).reshape(-1, 3)
    for i, name in enumerate(("uav1", "uav2", "uav3")):
        if count == 2:
            assert summary["slot_speed_mps"][name] == [None, None]
            assert summary["kappa_mps"][name] is None
            assert summary["kappa_at_s"][name] is None
            continue
        margins = np.minimum(speed[:, i] - 16.0, 30.0 - speed[:, i])
        assert summary["kappa_mps"][name] == pytest.approx(margins.min(), abs=1e-10)
        assert summary["kappa_at_s"][name] == (margins.argmin() + 1) / FRAME_RATE_HZ
        ends = [speed[:, i].min(), speed[:, i].max()]
        assert summary["slot_speed_mps"][name] == pytest.approx(ends, abs=1e-10)
        late = summary["windows"]["late"]["kappa_mps"][name]
        if count > 27:  # samples 25 to count - 2
            assert late == pytest.approx(margins[24:].min(), abs=1e-10)
        else:
            assert late is None


def test_kappa_ignores_lost_slots():
    samples = list(circling(400, [[0.0, 15.0, 0.0]]))
    expected = measure(samples[:375], run_info(1))["kappa_mps"]["uav1"]
    lost = np.full((1, 3), math.nan)
    samples[375:] = [
        f._replace(formation=f.formation._replace(slot_ned=lost)) for f in samples[375:]
    ]
    assert measure(samples, run_info(1))["kappa_mps"]["uav1"] == expected


@pytest.mark.parametrize("start", [0, SPAN - 3, SPAN - 2, SPAN - 1, SPAN])
def test_leaving_the_speed_set_counts(start):
    """A start outside it does not count."""
    outside, other = int(LimiterFlag.OUTSIDE_SPEED_SET), int(LimiterFlag.SPEED_COMMAND_CLIPPED)
    # uav1 starts outside and enters once, as is proved; uav2 leaves twice, at samples 1 and 4
    first = [outside | other] * 3 + [other, 0, 0, 0]
    second = [0, outside, outside | other, 0, outside, outside, 0]
    limiter_flags = [[outside, 0]] * start + [
        list(each) for each in zip(first, second, strict=True)
    ]
    samples = [
        make_sample(k, np.zeros((2, 3)), limiter_flags=each) for k, each in enumerate(limiter_flags)
    ]
    summary = measure(samples, run_info())
    left = summary["left_speed_set"]
    assert left["uav1"] == {"times": 0, "first_s": None}
    assert left["uav2"] == {"times": 2, "first_s": (start + 1) / FRAME_RATE_HZ}
    assert summary["limiter_flags"]["uav2"]["by_kind"]["outside_speed_set"] == 4


def random_run(count, followers):
    return longest_run(followers)[:count]


@cache
def longest_run(followers):
    rng = np.random.default_rng(3)
    return [
        make_sample(
            k,
            rng.normal(0.0, 2.0, (followers, 3)),
            offsets=rng.normal(0.0, 30.0, (followers, 3)),
            bank=rng.normal(),
            saturations=rng.integers(0, 8, followers).tolist(),
        )
        for k in range(LONGEST)
    ]


@pytest.mark.parametrize("count", [1, SPAN - 1, SPAN, SPAN + 1, LONGEST])
def test_sums_over_blocks_equal_those_of_the_run(count):
    samples = random_run(count, 4)
    summary = measure(samples, run_info(4, {"all": (0.0, 1000.0)}))
    errors = np.array([[math.hypot(*e) for e in f.formation.error_ned] for f in samples])
    distances = np.array(
        [
            [math.dist(a, b) for a in f.truth.position_ned for b in f.truth.position_ned]
            for f in samples
        ]
    )
    distances = distances[distances > 0.0]
    chi = np.array(
        [[math.dist(s, f.truth.position_ned[0]) for s in f.formation.slot_ned] for f in samples]
    )
    window = summary["windows"]["all"]
    rms = [math.sqrt(math.fsum(column**2) / count) for column in errors.T]
    ratio = [math.sqrt(math.fsum(column**2) / count) for column in (errors / chi).T]
    # sums of at most 785 positive numbers in another order: 785 roundings of 1e-16 at worst
    assert list(window["rms_m"].values()) == pytest.approx(rms, rel=1e-13)
    assert window["percent_error"] == pytest.approx(100.0 * np.mean(ratio), rel=1e-13)
    assert list(summary["max_error_m"].values()) == pytest.approx(errors.max(axis=0), rel=1e-14)
    # positions of about 1000 m know their differences to 1e-13 m
    assert summary["min_separation_m"] == pytest.approx(distances.min(), abs=1e-12)


@pytest.mark.parametrize("count", [12, 130])
def test_block_lengths_change_no_bit(count, monkeypatch):
    samples, info = random_run(2 * SPAN + 50, 3), run_info(3, {"all": (0.0, 1000.0)})
    summary = measure(samples, info)
    monkeypatch.setattr(core_samples, "_BLOCK_AIRCRAFT_SAMPLES", 4 * count)
    assert measure(samples, info) == summary


def test_summary_during_a_run_changes_nothing():
    samples = random_run(1300, 3)  # more than are summed together
    info = run_info(3, {"all": (0.0, 1000.0)})
    meter = MetricsObserver()
    meter.begin(info)
    for k, sample in enumerate(samples):
        meter.observe(sample)
        if k % 97 == 0:
            assert meter.summary()["simulated_s"] == sample.time_s
    assert meter.summary() == measure(samples, info)


def test_events_and_published_numbers_are_copied():
    sample = make_sample(0, np.zeros((2, 3)))
    event = Event(0.0, "warning", "uav1", "a gust")
    samples = Sample(
        **{name: getattr(sample, name) for name in Sample.__annotations__ if name != "events"},
        events=(event,),
    )
    summary = measure([samples], run_info(), published={"source": "elsewhere"})
    assert summary["published"] == {"source": "elsewhere"}
    expected = {"time_s": 0.0, "level": "warning", "source": "uav1", "text": "a gust"}
    assert summary["events"] == [expected]


def test_summary_before_a_run_is_an_error():
    with pytest.raises(RuntimeError, match="begin"):
        MetricsObserver().summary()


def test_wind_of_known_samples():
    # 8 m/s from the east, and a gust of 1 m/s along it every second sample, as much down as up:
    # a mean of 7.5 m/s, with an RMS of 0.5 m/s along it and of 1 m/s vertically.
    samples = [
        make_sample(
            k, [[0.0, 1.0, 0.0]], wind=(0.0, k % 2 - 8.0, 2.0 * (k % 2) - 1.0), roll=-0.01 * k
        )
        for k in range(50)
    ]
    wind = measure(samples, run_info(followers=1))["wind"]
    assert list(wind) == ["leader", "uav1"]
    one = wind["uav1"]
    assert one["mean_ned_mps"] == pytest.approx([0.0, -7.5, 0.0], abs=1e-12)
    assert one["mean_mps"] == pytest.approx(7.5)
    assert one["from_deg"] == pytest.approx(90.0)
    assert one["gusts_rms_ned_mps"] == pytest.approx([0.0, 0.5, 1.0])
    assert one["max_mps"] == pytest.approx(math.sqrt(65.0))
    assert one["max_wake_delta_cl"] == pytest.approx(0.49)
    assert describe_wind(wind) == [
        "7.5 m/s from 90°",
        "gusts 0.35 m/s horizontal, 1.00 m/s vertical (RMS)",
    ]


def test_still_air_has_no_line():
    wind = measure([make_sample(0, [[0.0, 1.0, 0.0]])], run_info(followers=1))["wind"]
    assert describe_wind(wind) == []
    assert wind["uav1"]["gusts_rms_ned_mps"] == [0.0, 0.0, 0.0]


def test_mean_throttle_of_known_samples():
    samples = [
        make_sample(k, [[0.0, 1.0, 0.0]], throttle=np.array([0.2, k % 2])) for k in range(50)
    ]
    measured = measure(samples, run_info(followers=1))["mean_throttle"]
    assert measured == {"leader": pytest.approx(0.2), "uav1": pytest.approx(0.5)}


@pytest.mark.parametrize("missing", [0, 1, 2, 5])
def test_window_that_lacks_samples_is_not_complete(missing):
    """But for one, which a window that ends between two samples may lack."""
    end_s = 50 / FRAME_RATE_HZ
    samples = [make_sample(k, np.ones((2, 3))) for k in range(50 - missing)]
    window = measure(samples, run_info(windows={"all": (0.0, end_s)}))["windows"]["all"]
    assert window["covered_s"] == pytest.approx((50 - missing) / FRAME_RATE_HZ, rel=1e-14)
    assert window["complete"] == (missing <= 1)


def test_sums_of_a_later_start_have_the_same_spans():
    """The same bits in a window that both have; spans counted from the first sample differ."""
    samples = random_run(3 * SPAN, 3)
    some = {"late": (samples[SPAN // 2].time_s, samples[-1].time_s)}

    def late(first):
        return measure(samples[first:], run_info(3, windows=some))["windows"]["late"]

    assert late(0)["rms_m"] == late(SPAN // 3)["rms_m"] == late(SPAN // 2)["rms_m"]
