"""The numbers of a run, worked out by hand and by a second route."""

import math

import numpy as np
import pytest

from testbed.formation.flags import Guard, Saturation
from testbed.formation.geometry import velocity_frame
from testbed.metrics import MetricsObserver
from testbed.metrics.tally import BLOCK
from testbed.metrics.wind import describe
from testbed.state import (
    AirData,
    Event,
    FbwaCommand,
    FormationState,
    Frame,
    LinkCounts,
    Origin,
    RunInfo,
    Surfaces,
    VehicleState,
)

BASE_RATE_HZ, FRAME_RATE_HZ = 200, 25


def run_info(followers=2, portions=None):
    names = ("leader", *(f"uav{i}" for i in range(1, followers + 1)))
    return RunInfo(
        scenario_name="by-hand",
        scenario_yaml="",
        names=names,
        aircraft=("rascal110",) * len(names),
        wingspan_m=(2.8,) * len(names),
        origin=Origin(),
        base_rate_hz=BASE_RATE_HZ,
        frame_rate_hz=FRAME_RATE_HZ,
        duration_s=100.0,
        seed=1,
        speed_bounds_mps=((16.0, 30.0),) * followers,
        kappa_mps=(3.6,) * followers,
        roll_limit_rad=(0.8,) * followers,
        leader_path_ned=np.zeros((0, 3)),
        portions=portions or {},
        versions={"testbed": "0"},
    )


def a_frame(
    k,
    errors,
    *,
    offsets=None,
    bank=0.0,
    guards=None,
    saturations=None,
    wind=(0.0, 0.0, 0.0),
    roll=0.0,
    throttle=0.0,
    lost=(),
):
    """Frame k: the leader flies north, slots lie at the offsets, followers err by the errors.

    Aircraft of the rows `lost` are lost; estimates are exact.
    """
    errors = np.array(errors, dtype=float).reshape(-1, 3)
    n = len(errors)
    offsets = 20.0 * np.eye(n, 3) if offsets is None else np.array(offsets, dtype=float)
    leader = np.array([22.0 * k / FRAME_RATE_HZ, 5.0, -100.0])
    slot = leader + offsets
    zeros, none = np.zeros(n + 1), np.zeros(n)
    vectors = np.zeros((n + 1, 3))
    state = VehicleState(
        position_ned=np.vstack([leader, slot + errors]),
        velocity_ned=vectors,
        acceleration_ned=vectors,
        euler=np.vstack([[bank, 0.0, 0.0], np.full((n, 3), 9.0)]),
        rates_body=vectors,
        airspeed=zeros,
        equivalent_airspeed=zeros,
    )
    tick = 8 * k
    return Frame(
        tick=tick,
        time_s=tick / BASE_RATE_HZ,
        truth=state,
        estimate=state,
        air=AirData(zeros, zeros, zeros, vectors + wind, vectors, zeros + roll, zeros, zeros),
        command=FbwaCommand(zeros, zeros, zeros + throttle),
        surfaces=Surfaces(zeros, zeros, zeros, zeros),
        formation=FormationState(
            slot,
            errors,
            *[none] * 7,
            guards=np.array(guards or [0] * n, dtype=np.uint8),
            saturations=np.array(saturations or [0] * n, dtype=np.uint8),
            age_s=np.full((n, n + 1), np.nan),
            place=np.arange(1, n + 1, dtype=np.uint32),
            believed_ned=errors,
        ),
        links=LinkCounts(*np.zeros((2, n, n + 1), dtype=np.uint32)),
        lost=np.isin(np.arange(n + 1), lost),
    )


def measure(seen, info, **options):
    meter = MetricsObserver(**options)
    meter.begin(info)
    for frame in seen:
        meter.observe(frame)
    return meter.summary()


def test_rms_mean_and_percent_error_by_hand():
    # uav1 errs by 3 and 4 m in turn, 5 m from the leader: RMS sqrt((9 + 16) / 2) = 5 / sqrt(2),
    # a ratio of 1 / sqrt(2). uav2 errs by 2 m always, 10 m from the leader: 2 m, a ratio of 0.2.
    offsets = [[3.0, 4.0, 0.0], [0.0, 0.0, 10.0]]
    seen = [
        a_frame(k, [[0.0, 3.0 + k % 2, 0.0], [0.0, 2.0, 0.0]], offsets=offsets) for k in range(50)
    ]
    portion = measure(seen, run_info(portions={"all": (0.0, 2.0)}))["portions"]["all"]
    # some roundings of double precision
    assert portion["rms_m"]["uav1"] == pytest.approx(5.0 / math.sqrt(2.0), rel=1e-13)
    assert portion["rms_m"]["uav2"] == pytest.approx(2.0, rel=1e-13)
    mean = (5.0 / math.sqrt(2.0) + 2.0) / 2.0
    assert portion["mean_rms_m"] == pytest.approx(mean, rel=1e-13)
    percent = 100.0 * (1.0 / math.sqrt(2.0) + 0.2) / 2.0
    assert portion["percent_error"] == pytest.approx(percent, rel=1e-12)
    assert portion["max_error_m"] == {"uav1": 4.0, "uav2": 2.0}


def test_a_portion_takes_its_start_and_leaves_its_end():
    # frames at 0, 0.04, ..., 3.96 s; error k metres in frame k; [1, 2) s is frames 25 to 49
    seen = [a_frame(k, [[float(k), 0.0, 0.0]]) for k in range(100)]
    portion = measure(seen, run_info(1, {"one": (1.0, 2.0)}))["portions"]["one"]
    squares = sum(k * k for k in range(25, 50))
    assert portion["rms_m"]["uav1"] == pytest.approx(math.sqrt(squares / 25.0), rel=1e-13)
    assert portion["max_error_m"]["uav1"] == 49.0
    assert portion["covered_s"] == 1.0
    assert portion["complete"]


def test_neighbouring_portions_share_no_frame():
    seen = [a_frame(k, [[1.0, 0.0, 0.0]]) for k in range(100)]
    portions = measure(seen, run_info(1, {"a": (0.0, 1.52), "b": (1.52, 4.0)}))["portions"]
    assert portions["a"]["covered_s"] == 38 / FRAME_RATE_HZ
    assert portions["b"]["covered_s"] == 62 / FRAME_RATE_HZ


def test_a_portion_that_was_not_reached_has_no_numbers():
    seen = [a_frame(k, [[1.0, 0.0, 0.0]]) for k in range(75)]
    portions = measure(seen, run_info(1, {"half": (2.0, 4.0), "none": (5.0, 6.0)}))["portions"]
    assert portions["half"]["covered_s"] == 1.0
    assert not portions["half"]["complete"]
    assert portions["half"]["rms_m"] == {"uav1": 1.0}
    nothing = {"window_s": [5.0, 6.0], "covered_s": 0.0, "complete": False}
    nothing |= {"rms_m": {"uav1": None}, "mean_rms_m": None, "percent_error": None}
    nothing |= {"believed_rms_m": {"uav1": None}, "believed_mean_rms_m": None}
    nothing |= {"kappa_mps": {"uav1": None}, "slot_speed_mps": {"uav1": [None, None]}}
    assert portions["none"] == nothing | {"max_error_m": {"uav1": None}, "leader_bank_deg": None}


def test_an_error_that_is_not_a_number_gives_no_rms_rather_than_a_wrong_one():
    seen = [a_frame(k, [[math.nan if k > 30 else 1.0, 0, 0], [2.0, 0, 0]]) for k in range(50)]
    summary = measure(seen, run_info(portions={"all": (0.0, 2.0)}))
    assert summary["portions"]["all"]["rms_m"] == {"uav1": None, "uav2": 2.0}
    assert summary["portions"]["all"]["mean_rms_m"] is None
    assert summary["min_separation_m"] is not None


def test_a_lost_follower_counts_until_it_was_lost():
    # 3 m off for 25 frames, 4 m for 25, and then on the ground, a kilometre away and not a number
    seen = []
    for k in range(100):
        own = [3.0 if k < 25 else 4.0, 0.0, 0.0] if k < 50 else [1000.0 if k < 60 else math.nan] * 3
        lost = (1,) if k >= 50 else ()
        seen.append(a_frame(k, [own, [0.0, 2.0, 0.0]], lost=lost, throttle=0.5 if k < 50 else 0.0))
    portions = {"all": (0.0, 4.0), "late": (3.0, 4.0)}
    summary = measure(seen, run_info(portions=portions))
    both, late = summary["portions"]["all"], summary["portions"]["late"]
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
    assert late["mean_rms_m"] == late["believed_mean_rms_m"] == 2.0
    assert late["max_error_m"]["uav1"] is None
    # of the time it flew
    assert summary["mean_throttle"]["uav1"] == pytest.approx(0.5, rel=1e-13)
    assert summary["mean_throttle"]["uav2"] == pytest.approx(0.25, rel=1e-13)


def test_behind_a_lost_leader_there_are_no_slots():
    seen = [
        a_frame(k, np.full((2, 3), 1.0 if k < 50 else 500.0), lost=(0,) if k >= 50 else (), bank=k)
        for k in range(100)
    ]
    # the slots stop where the leader lies
    slot = seen[49].formation.slot_ned
    seen[50:] = [f._replace(formation=f.formation._replace(slot_ned=slot)) for f in seen[50:]]
    summary = measure(seen, run_info(portions={"all": (0.0, 4.0)}))
    portion = summary["portions"]["all"]
    assert portion["rms_m"] == pytest.approx(dict.fromkeys(("uav1", "uav2"), math.sqrt(3.0)))
    assert portion["leader_bank_deg"] == summary["leader_bank_deg"] == math.degrees(49.0)
    # 22 m/s between bounds of 16 and 30, as long as there were slots; 1e-9: positions of 44 m
    assert summary["kappa_mps"]["uav1"] == pytest.approx(6.0, abs=1e-9)
    assert summary["recovery"]["uav1"]["inside_for_good_from_s"] is None


@pytest.mark.parametrize("at", [300, BLOCK - 1, BLOCK])
def test_a_lost_aircraft_is_close_to_others_up_to_the_frame_in_which_it_was_lost(at):
    # uav2, 28 m from uav1, comes to 3 m and is lost by that; then others fly over it at 1 m
    seen = [a_frame(k, np.zeros((2, 3)), lost=(1, 2) if k >= at else ()) for k in range(at + 300)]
    seen[at] = a_frame(at, [[0.0, 0.0, 0.0], [20.0, -20.0, 3.0]], lost=(1, 2))
    for k in range(at + 1, at + 300):
        seen[k] = a_frame(k, [[0.0, 0.0, 0.0], [20.0, -20.0, 1.0]], lost=(1, 2))
    summary = measure(seen, run_info())
    assert summary["min_separation_m"] == pytest.approx(3.0, rel=1e-12)
    assert summary["min_separation_at_s"] == at / FRAME_RATE_HZ
    assert summary["min_separation_between"] == ["uav1", "uav2"]
    assert summary["lost_at_s"] == {"leader": None} | dict.fromkeys(
        ("uav1", "uav2"), at / FRAME_RATE_HZ
    )


def test_the_flags_of_a_lost_follower_are_not_counted():
    guards, saturations = [int(Guard.OUTSIDE_SPEED_SET)] * 2, [int(Saturation.PITCH)] * 2
    flags = {"guards": guards, "saturations": saturations}
    seen = [a_frame(0, np.zeros((2, 3)))]
    seen += [a_frame(k, np.zeros((2, 3)), lost=(2,), **flags) for k in range(1, 11)]
    summary = measure(seen, run_info())
    assert [summary["guards"][name]["frames"] for name in ("uav1", "uav2")] == [10, 0]
    assert [summary["saturations"][name]["frames"] for name in ("uav1", "uav2")] == [10, 0]
    assert summary["left_speed_set"]["uav2"] == {"times": 0, "first_s": None}
    assert summary["recovery"]["uav2"]["last_saturated_s"] is None


def test_a_lost_follower_is_not_engaged_by_lying_in_its_slot():
    seen = [a_frame(k, [[0.0, 0.0, 0.0]], lost=(1,) if k >= 50 else ()) for k in range(400)]
    summary = measure(seen, run_info(1))
    assert summary["engaged_at_s"]["uav1"] is None
    assert summary["recovery"]["uav1"]["inside_for_good_from_s"] is None


def test_the_wind_felt_is_that_of_the_flight():
    seen = [
        a_frame(k, [[0.0, 0.0, 0.0]], wind=(4.0, 0.0, 0.0) if k < 30 else (90.0, 0.0, 0.0), roll=k)
        for k in range(60)
    ]
    seen[30:] = [frame._replace(lost=np.array([False, True])) for frame in seen[30:]]
    felt = measure(seen, run_info(1))["wind"]
    assert felt["uav1"]["mean_ned_mps"] == pytest.approx([4.0, 0.0, 0.0], rel=1e-13)
    assert felt["uav1"]["fastest_mps"] == 4.0
    assert felt["uav1"]["wake_roll_coefficient"] == 29.0
    assert felt["leader"]["mean_ned_mps"] == pytest.approx([47.0, 0.0, 0.0], rel=1e-13)


def engaged(distances):
    seen = [a_frame(k, [[distance, 0.0, 0.0]]) for k, distance in enumerate(distances)]
    summary = measure(seen, run_info(1))
    return summary["engaged_at_s"]["uav1"], summary["recovery"]["uav1"]["inside_for_good_from_s"]


def test_an_agent_is_engaged_from_the_start_of_its_first_five_seconds_inside():
    out, inside = 6.0, 5.0  # 5 m is inside
    five = 5 * FRAME_RATE_HZ
    assert engaged([out] * 10 + [inside] * (five + 1)) == (0.4, 0.4)
    assert engaged([out] * 10 + [inside] * five) == (None, 0.4)  # 5 s are not over
    assert engaged([inside] * five + [out] + [inside] * (five + 1)) == (5.04, 5.04)
    assert engaged([inside] * (five + 1) + [out] * 3 + [inside]) == (0.0, 5.16)
    assert engaged([inside] * (five + 1) + [out]) == (0.0, None)


@pytest.mark.parametrize("start", [BLOCK - 126, BLOCK - 125, BLOCK - 1, BLOCK, BLOCK + 1])
def test_engaging_across_the_edge_of_a_block(start):
    # the same rule frame by frame, without blocks
    distances = [9.0] * start + [1.0] * 200 + [9.0] * 3 + [1.0] * BLOCK
    assert engaged(distances) == (start / FRAME_RATE_HZ, (start + 203) / FRAME_RATE_HZ)


def test_the_smallest_separation_names_the_pair_and_the_time():
    # slots 20 m north and 20 m east of the leader: 28.28 m apart, until uav2 comes within 3 m of
    # uav1 in frame 300, which is in the second block
    seen = [a_frame(k, np.zeros((2, 3))) for k in range(600)]
    seen[300] = a_frame(300, [[0.0, 0.0, 0.0], [20.0, -20.0, 3.0]])
    summary = measure(seen, run_info())
    assert summary["min_separation_m"] == pytest.approx(3.0, rel=1e-12)
    assert summary["min_separation_at_s"] == 12.0
    assert summary["min_separation_between"] == ["uav1", "uav2"]
    alone = measure([a_frame(0, np.zeros((0, 3)))], run_info(0))
    assert alone["min_separation_m"] is None


def test_guards_and_saturations_are_counted_by_kind():
    clamp, outside = Guard.SPEED_DESIRED_CLAMPED, Guard.OUTSIDE_SPEED_SET
    pitch, throttle = Saturation.PITCH, Saturation.THROTTLE
    seen = [
        a_frame(0, np.zeros((2, 3)), guards=[clamp | outside, 0], saturations=[pitch, 0]),
        a_frame(1, np.zeros((2, 3)), guards=[outside, 0], saturations=[pitch | throttle, throttle]),
        a_frame(2, np.zeros((2, 3))),
    ]
    summary = measure(seen, run_info())
    one = summary["guards"]["uav1"]
    assert (one["frames"], one["seconds"]) == (2, 0.08)
    assert one["by_kind"] == {
        "speed_desired_clamped": 1,
        "outside_speed_set": 2,
        "speed_command_clipped": 0,
        "leader_silent": 0,
    }
    assert summary["guards"]["uav2"]["frames"] == 0
    assert summary["saturations"]["uav1"]["by_kind"] == {"pitch": 2, "roll": 0, "throttle": 1}
    assert summary["saturations"]["uav2"]["frames"] == 1
    assert summary["recovery"]["uav1"]["last_saturated_s"] == 0.04
    assert measure(seen[2:], run_info())["recovery"]["uav1"]["last_saturated_s"] is None


def test_bank_is_the_leaders_and_its_size_counts():
    banks = [0.1, -0.5, 0.3, 0.2]
    seen = [a_frame(k, np.zeros((2, 3)), bank=bank) for k, bank in enumerate(banks)]
    summary = measure(seen, run_info(portions={"late": (0.08, 1.0)}))
    assert summary["leader_bank_deg"] == pytest.approx(math.degrees(0.5), rel=1e-15)
    assert summary["portions"]["late"]["leader_bank_deg"] == pytest.approx(math.degrees(0.3))


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
        frame = a_frame(k, np.zeros((len(slot), 3)))
        yield frame._replace(formation=frame.formation._replace(slot_ned=slot))


def test_kappa_is_measured_on_a_circle():
    # uav1 flies inside, on 105 m, uav2 outside and behind, on √(140² + 20²) m
    offsets = [[0.0, 15.0, 0.0], [-20.0, -20.0, 4.0]]
    windows = {"straight": (1.0, 11.0), "circle": (13.0, 40.0)}
    summary = measure(circling(1000, offsets), run_info(portions=windows))
    x = SPEED / RADIUS / FRAME_RATE_HZ
    chord = np.sin(x) / x  # of the central difference: 9e-6 below one
    inner = chord * SPEED * 105.0 / RADIUS
    outer = chord * SPEED * math.hypot(140.0, 20.0) / RADIUS
    circle, straight = summary["portions"]["circle"], summary["portions"]["straight"]
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


def test_kappa_is_negative_where_a_slot_left_the_bounds():
    summary = measure(circling(400, [[0.0, 40.0, 0.0]]), run_info(1))
    assert summary["kappa_mps"]["uav1"] == pytest.approx(SPEED * 80.0 / RADIUS - 16.0, abs=2e-4)


@pytest.mark.parametrize("count", [2, 3, BLOCK, BLOCK + 1, BLOCK + 2, 2 * BLOCK + 5])
def test_slot_speeds_do_not_know_of_blocks(count):
    rng = np.random.default_rng(8)
    # 44 m from frame to frame over the right distance: 2 m of jitter are 25 m/s
    seen = [
        a_frame(k, np.zeros((3, 3)), offsets=rng.normal(0.0, 2.0, (3, 3))) for k in range(count)
    ]
    summary = measure(seen, run_info(3, {"late": (1.0, 90.0)}))
    slots = np.array([frame.formation.slot_ned for frame in seen])
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
        late = summary["portions"]["late"]["kappa_mps"][name]
        if count > 27:  # frames 25 to count - 2
            assert late == pytest.approx(margins[24:].min(), abs=1e-10)
        else:
            assert late is None


def test_a_slot_that_is_lost_hides_no_kappa():
    seen = list(circling(400, [[0.0, 15.0, 0.0]]))
    expected = measure(seen[:375], run_info(1))["kappa_mps"]["uav1"]
    lost = np.full((1, 3), math.nan)
    seen[375:] = [f._replace(formation=f.formation._replace(slot_ned=lost)) for f in seen[375:]]
    assert measure(seen, run_info(1))["kappa_mps"]["uav1"] == expected


@pytest.mark.parametrize("start", [0, BLOCK - 3, BLOCK - 2, BLOCK - 1, BLOCK])
def test_leaving_the_speed_set_is_counted_but_not_a_start_outside(start):
    outside, other = int(Guard.OUTSIDE_SPEED_SET), int(Guard.SPEED_COMMAND_CLIPPED)
    # uav1 starts outside and enters once, as is proved; uav2 leaves twice, at frames 1 and 4
    first = [outside | other] * 3 + [other, 0, 0, 0]
    second = [0, outside, outside | other, 0, outside, outside, 0]
    guards = [[outside, 0]] * start + [list(each) for each in zip(first, second, strict=True)]
    seen = [a_frame(k, np.zeros((2, 3)), guards=each) for k, each in enumerate(guards)]
    summary = measure(seen, run_info())
    left = summary["left_speed_set"]
    assert left["uav1"] == {"times": 0, "first_s": None}
    assert left["uav2"] == {"times": 2, "first_s": (start + 1) / FRAME_RATE_HZ}
    assert summary["guards"]["uav2"]["by_kind"]["outside_speed_set"] == 4


def random_run(count, followers):
    rng = np.random.default_rng(3)
    for k in range(count):
        yield a_frame(
            k,
            rng.normal(0.0, 2.0, (followers, 3)),
            offsets=rng.normal(0.0, 30.0, (followers, 3)),
            bank=rng.normal(),
            saturations=rng.integers(0, 8, followers).tolist(),
        )


@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 17])
def test_a_second_route_over_the_whole_run_at_once(count):
    seen = list(random_run(count, 4))
    summary = measure(seen, run_info(4, {"all": (0.0, 1000.0)}))
    errors = np.array([[math.hypot(*e) for e in f.formation.error_ned] for f in seen])
    distances = np.array(
        [
            [math.dist(a, b) for a in f.truth.position_ned for b in f.truth.position_ned]
            for f in seen
        ]
    )
    distances = distances[distances > 0.0]
    chi = np.array(
        [[math.dist(s, f.truth.position_ned[0]) for s in f.formation.slot_ned] for f in seen]
    )
    portion = summary["portions"]["all"]
    rms = [math.sqrt(math.fsum(column**2) / count) for column in errors.T]
    ratio = [math.sqrt(math.fsum(column**2) / count) for column in (errors / chi).T]
    # sums of at most 785 positive numbers in another order: 785 roundings of 1e-16 at worst
    assert list(portion["rms_m"].values()) == pytest.approx(rms, rel=1e-13)
    assert portion["percent_error"] == pytest.approx(100.0 * np.mean(ratio), rel=1e-13)
    assert list(summary["max_error_m"].values()) == pytest.approx(errors.max(axis=0), rel=1e-14)
    # positions of about 1000 m know their differences to 1e-13 m
    assert summary["min_separation_m"] == pytest.approx(distances.min(), abs=1e-12)


def test_asking_in_between_changes_nothing():
    seen = list(random_run(700, 3))
    info = run_info(3, {"all": (0.0, 1000.0)})
    meter = MetricsObserver()
    meter.begin(info)
    for k, frame in enumerate(seen):
        meter.observe(frame)
        if k % 97 == 0:
            assert meter.summary()["simulated_s"] == frame.time_s
    assert meter.summary() == measure(seen, info)


def test_events_and_published_numbers_pass_through():
    frame = a_frame(0, np.zeros((2, 3)))
    event = Event(0.0, "warning", "uav1", "a gust")
    seen = Frame(
        **{name: getattr(frame, name) for name in Frame.__annotations__ if name != "events"},
        events=(event,),
    )
    summary = measure([seen], run_info(), published={"source": "elsewhere"})
    assert summary["published"] == {"source": "elsewhere"}
    expected = {"time_s": 0.0, "level": "warning", "source": "uav1", "text": "a gust"}
    assert summary["events"] == [expected]


def test_there_is_no_summary_before_a_run():
    with pytest.raises(RuntimeError, match="begin"):
        MetricsObserver().summary()


def test_the_wind_felt_by_hand():
    # 8 m/s from the east, and a gust of 1 m/s along it every second frame, as much down as up:
    # a mean of 7.5 m/s, with an RMS of 0.5 m/s along it and of 1 m/s vertically.
    seen = [
        a_frame(k, [[0.0, 1.0, 0.0]], wind=(0.0, k % 2 - 8.0, 2.0 * (k % 2) - 1.0), roll=-0.01 * k)
        for k in range(50)
    ]
    felt = measure(seen, run_info(followers=1))["wind"]
    assert list(felt) == ["leader", "uav1"]
    one = felt["uav1"]
    assert one["mean_ned_mps"] == pytest.approx([0.0, -7.5, 0.0], abs=1e-12)
    assert one["mean_mps"] == pytest.approx(7.5)
    assert one["from_deg"] == pytest.approx(90.0)
    assert one["gusts_rms_ned_mps"] == pytest.approx([0.0, 0.5, 1.0])
    assert one["fastest_mps"] == pytest.approx(math.sqrt(65.0))
    assert one["wake_roll_coefficient"] == pytest.approx(0.49)
    said = describe(felt)
    assert said == "7.5 m/s from 90°, varying by 0.35 m/s level and 1.00 m/s vertical (RMS)"


def test_still_air_is_not_spoken_of():
    felt = measure([a_frame(0, [[0.0, 1.0, 0.0]])], run_info(followers=1))["wind"]
    assert describe(felt) is None
    assert felt["uav1"]["gusts_rms_ned_mps"] == [0.0, 0.0, 0.0]


def test_the_mean_throttle_by_hand():
    seen = [a_frame(k, [[0.0, 1.0, 0.0]], throttle=np.array([0.2, k % 2])) for k in range(50)]
    measured = measure(seen, run_info(followers=1))["mean_throttle"]
    assert measured == {"leader": pytest.approx(0.2), "uav1": pytest.approx(0.5)}
