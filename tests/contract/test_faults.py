"""What breaks on a page, what the log says of it, and what the others make of it."""

import dataclasses
import json

import numpy as np
import pytest
from run_flight import Collector, arrays
from typer.testing import CliRunner

import testbed
from testbed.cli import app
from testbed.errors import InputError
from testbed.formation.geometry import READY_TRUE_SLOTS
from testbed.scenario import load, loads
from testbed.sim.loop import fly
from testbed.sim.world import build
from testbed.state import AirData, Inbox

# Simulation 3's formation on its way to the first lap, everyone in its slot from the start.
PAGE = """
extends: simulation-3
scenario: {name: breaking, duration_s: 8, portions: null, published: null}
log: {mcap: false}
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]}
  - {name: uav3, aircraft: rascal110, start_m: [-5, -5, 4]}
"""
LEADER, UAV1, UAV2, UAV3 = range(4)
PERIOD = 0.04  # s, between messages and between frames


def page(*changes):
    return loads(PAGE, changes)


def flown(*changes):
    """The frames of a flight, its events beside them, and how it ended."""
    seen = Collector()
    run = testbed.run(page(*changes), write=False, observers=[seen])
    return seen.frames, said(seen.frames), run


def said(frames):
    """What was told of faults and what comes of them: not who has taken its slot."""
    told = [(e.time_s, e.level, e.source, e.text) for frame in frames for e in frame.events]
    return [event for event in told if not event[3].startswith("engaged")]


def faults(number, text):
    return f"fleet.{number}.faults=[{text}]"


def unlike(one, other):
    """The names of the arrays in which two frames differ."""
    pairs = zip(arrays(one), arrays(other), strict=True)
    return [name for (name, a), (_, b) in pairs if not np.array_equal(a, b, equal_nan=True)]


def column(frames, record, name):
    return np.array([getattr(getattr(frame, record), name) for frame in frames])


# what begins and ends, and when


def test_a_fault_begins_and_ends_when_the_page_says_and_not_in_between():
    frames, events, run = flown(faults(0, "{kind: thrust-loss, left: 0.5, at_s: 2, lasts_s: 3}"))
    assert events == [
        (2.0, "warning", "uav1", "thrust loss, 50 % of the throttle is left"),
        (5.0, "info", "uav1", "thrust loss, 50 % of the throttle is left: over"),
    ]
    assert run.outcome == "flown"
    usual, _, _ = flown()
    time = np.array([frame.time_s for frame in frames])
    different = [unlike(one, other) for one, other in zip(frames, usual, strict=True)]
    # surfaces are those of the moment, so the first frame that differs is that of the fault
    at = int(np.argmax(time >= 2.0))
    assert not any(different[:at])
    assert different[at] == ["surfaces.throttle"]
    throttle, told = column(frames, "surfaces", "throttle"), column(frames, "command", "throttle")
    assert throttle[at, UAV1] == 0.5 * usual[at].surfaces.throttle[UAV1]
    share = throttle[:, UAV1] / told[:, UAV1]
    broken = (time >= 2.0) & (time < 5.0)
    # autopilots fly a command that is one of their periods old, in which it changes by a tenth
    assert share[broken] == pytest.approx(0.5, abs=0.15)
    assert share[~broken] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("{kind: engine-out", "engine out"),
        ("{kind: surface-stuck, surface: rudder", "rudder stuck"),
        ("{kind: surface-stuck, surface: aileron, position: 0.1", "aileron stuck at 0.1"),
        ("{kind: surface-floating, surface: elevator", "elevator floating"),
        ("{kind: airspeed-blocked", "pitot tube blocked, drain blocked"),
        ("{kind: airspeed-blocked, drain: open", "pitot tube blocked, drain open"),
        ("{kind: gps-lost", "GPS lost"),
        (
            "{kind: gps-jump, offset_m: [1, -2.5, 3]",
            "GPS off by 1, -2.5, 3 m north, east, down",
        ),
        ("{kind: autopilot-frozen", "autopilot frozen"),
        ("{kind: radio-mute", "radio mute"),
    ],
)
def test_every_kind_has_its_words(fault, text):
    _, events, _ = flown(
        faults(1, f"{fault}, at_s: 0.2, lasts_s: 0.2}}"),
        "fleet.1.sensors=pixhawk",
        "scenario.duration_s=0.6",
    )
    assert events == [
        (0.2, "warning", "uav2", text),
        (0.4, "info", "uav2", f"{text}: over"),
    ]


def test_a_condition_begins_a_fault_once_and_counts_from_its_time_on():
    """The airspeed is below 100 m/s all the time."""
    when = "when: {quantity: airspeed_mps, below: 100}"
    _, events, _ = flown(faults(0, f"{{kind: radio-mute, at_s: 1.5, {when}, lasts_s: 1}}"))
    assert [(time, text) for time, _, _, text in events if "mute" in text] == [
        (1.5, "radio mute"),
        (2.5, "radio mute: over"),
    ]


def test_a_condition_is_on_the_truth_and_begins_with_the_frame_that_meets_it():
    """The first corner banks everyone beyond 10 degrees; estimates that err move nothing."""
    when = "when: {quantity: bank_deg, above: 10}"
    frames, events, _ = flown(
        faults(2, f"{{kind: radio-mute, {when}}}"),
        "fleet.2.sensors={attitude: {sigma_deg: 5, time_constant_s: 1}}",
        "scenario.duration_s=40",
        "leader.path.legs=[{kind: loiter, centre_m: [500, 200], radius_m: 120, "
        "levels: [{altitude_m: 100, turns: 9}]}]",
    )
    bank = np.abs(np.degrees(column(frames, "truth", "euler")[:, UAV3, 0]))
    first = frames[int(np.argmax(bank > 10.0))].time_s
    begun = [time for time, _, _, text in events if text == "radio mute"]
    assert len(begun) == 1
    # autopilots, and with them faults, have a period of half a frame's
    assert first - PERIOD < begun[0] <= first


def test_a_fault_that_changes_nothing_is_said_before_the_flight():
    _, events, _ = flown(faults(0, "{kind: gps-lost, at_s: 1}"), "scenario.duration_s=1")
    assert [(time, source) for time, _, source, text in events if "changes nothing" in text] == [
        (0.0, "uav1")
    ]


# who is heard


@pytest.mark.parametrize("kind", ["radio-mute", "autopilot-frozen"])
def test_who_cannot_speak_sends_nothing_and_is_heard_again_afterwards(kind):
    frames, events, _ = flown(
        faults(1, f"{{kind: {kind}, at_s: 2, lasts_s: 2}}"), "formation.on_failure.answer=re-slot"
    )
    time, sent = np.array([f.time_s for f in frames]), column(frames, "links", "sent")
    to_uav3 = sent[:, UAV3 - 1, UAV2].astype(int)
    hushed = (time >= 2.0) & (time < 4.0)
    assert (np.diff(to_uav3)[hushed[1:]] == 0).all()
    assert (np.diff(to_uav3)[~hushed[1:]] == 1).all()
    others = sent[:, UAV3 - 1, [LEADER, UAV1]].astype(int)
    assert (np.diff(others, axis=0) == 1).all()
    assert not [text for *_, text in events if "has failed" in text], "it cannot have said so"


def test_a_hung_autopilot_holds_its_servos():
    frames, _, _ = flown(faults(1, "{kind: autopilot-frozen, at_s: 2, lasts_s: 2}"))
    time = np.array([frame.time_s for frame in frames])
    hung = (time >= 2.0) & (time < 4.0)
    for name in ("aileron", "elevator", "rudder", "throttle"):
        moved = np.diff(column(frames, "surfaces", name)[:, [UAV1, UAV2]], axis=0) != 0.0
        assert not moved[hung[1:] & hung[:-1], 1].any(), name
        if name != "rudder":  # of a Rascal in straight flight it may rest
            assert moved[~hung[1:], 1].any() and moved[:, 0].any(), name


# what the others make of it

OUT = "{kind: engine-out, at_s: 1}"


def test_news_of_a_failure_comes_by_radio_after_what_it_takes_to_notice():
    """One hears it at once; of the three messages that said so first, the other missed all."""
    _, events, _ = flown(
        faults(1, OUT),
        "formation.on_failure={answer: drop, after_s: 2}",
        f"network.links.uav2.uav3={{drop: {[75, 76, 77]}}}",  # those of 3.00, 3.04 and 3.08 s
    )
    assert events == [
        (1.0, "warning", "uav2", "engine out"),
        (3.0, "warning", "uav1", "uav2 has failed"),
        (3.12, "warning", "uav3", "uav2 has failed: leaves it out"),
    ]


def test_news_of_a_failure_takes_as_long_as_the_radio():
    _, events, _ = flown(
        faults(1, OUT), "formation.on_failure={answer: drop, after_s: 1}", "network.delay_s=0.2"
    )
    told = [(time, source) for time, _, source, text in events if "has failed" in text]
    assert told == [(2.2, "uav1"), (2.2, "uav3")]


@pytest.mark.parametrize(
    ("fault", "declared"),
    [
        ("kind: engine-out", True),
        ("kind: engine-out, declared: false", False),
        ("kind: airspeed-blocked", False),
        ("kind: airspeed-blocked, declared: true", True),
        ("kind: gps-jump, offset_m: [0, 0, 0]", False),
    ],
)
@pytest.mark.parametrize("answer", ["fly-on", "drop", "re-slot"])
def test_the_others_learn_what_is_declared_if_they_care(fault, declared, answer):
    _, events, _ = flown(
        faults(1, f"{{{fault}, at_s: 0.2}}"),
        f"formation.on_failure={{answer: {answer}, after_s: 0.4}}",
        "scenario.duration_s=1",
    )
    learnt = {source for *_, source, text in events if "has failed" in text}
    assert learnt == ({"uav1", "uav3"} if declared and answer != "fly-on" else set())


def test_places_are_taken_in_the_order_of_the_fleet():
    """Nobody is as near to its place as a millimetre, so that who has failed has left it."""
    frames, events, _ = flown(
        faults(0, "{kind: thrust-loss, left: 0.9, at_s: 1, lasts_s: 3}"),
        "formation.on_failure={answer: re-slot, after_s: 1, clear_m: 0.001}",
    )
    assert events == [
        (1.0, "warning", "uav1", "thrust loss, 90 % of the throttle is left"),
        (2.0, "warning", "uav2", "uav1 has failed: leaves it out"),
        (2.0, "warning", "uav3", "uav1 has failed"),
        (2.0, "warning", "uav1", "leaves the formation: flies on its own"),
        (2.0, "warning", "uav2", "uav1 has left its place, takes the place of uav1"),
        (2.0, "warning", "uav3", "uav1 has left its place, takes the place of uav2"),
        (4.0, "info", "uav1", "thrust loss, 90 % of the throttle is left: over"),
    ]
    places = np.array([(0, 0, 0), (-5, 5, 0), (-5, -5, -4), (-5, -5, 4)], dtype=float)
    for frame in frames:
        seats = [1, 1, 2] if 2.0 <= frame.time_s else [1, 2, 3]
        assert frame.formation.place.tolist() == seats
        slots, room = np.empty((3, 3)), (np.empty((3, 3)), np.empty((3, 3)))
        READY_TRUE_SLOTS(
            frame.truth.position_ned,
            frame.truth.velocity_ned,
            np.vstack([places[:1], places[seats]]),
            np.full(3, np.nan),
            slots,
            *room,
        )()
        assert np.array_equal(frame.formation.slot_ned, slots), frame.time_s


def test_who_has_failed_but_can_fly_keeps_others_out_of_its_place():
    """With nearly all of its thrust left UAV 2 flies straight on, until the leader turns away."""
    _, events, run = flown(
        "limits={collision_m: 2.8}",
        faults(1, "{kind: thrust-loss, left: 0.95, at_s: 1}"),
        "formation.on_failure={answer: re-slot}",
        "scenario.duration_s=60",
    )
    left = [time for time, _, source, text in events if source == "uav3" and "has left" in text]
    turning = [time for time, _, source, text in events if source == "uav2" and "leaves" in text]
    assert turning == [3.0]
    assert left[0] > 10.0  # the first corner comes at some 25 s
    assert run.outcome == "flown"
    assert run.metrics["min_separation_m"] > 4.0


def known_after(*changes):
    """The world of a page at 4 s, and its groups as they are then, everything being heard."""
    world = build(page(*changes))
    truth = world.vehicles.read()
    (group,) = world.groups
    for _ in world.breakdowns.changes(1.0, truth, no_air, np.zeros(4, dtype=bool)):
        pass
    # everybody hears the same, and of uav1 that it is far below
    heard = [np.tile(each, (3, 1, 1)) for each in (truth.position_ned, truth.velocity_ned)]
    heard[0][:, UAV1, 2] += 50.0
    still, never = np.zeros((3, 4, 3)), np.zeros((3, 4))
    inbox = Inbox(never, never, *heard, still, still, still)
    for _ in world.roster.changes(4.0, group.rows, inbox, np.full((3, 4), 4.0)):
        pass
    return world, group, world.roster.regrouped(group)


def no_air() -> AirData:
    raise AssertionError("nobody asked for a battery")


def test_a_place_has_its_gains_whoever_is_in_it():
    """UAV 1 out: UAV 2 heeds the leader alone, and UAV 3 the leader and UAV 2, as UAV 2 did."""
    _, before, after = known_after(faults(0, OUT), "formation.on_failure.answer=re-slot")
    heeded = after.team.gains[:, :, 0]
    assert heeded[1:].tolist() == [[1, 0, 0, 0], [1, 0, 1, 0]]
    assert np.array_equal(after.law.gains, after.team.gains)
    offsets = after.law.offsets  # (n, N, 3), as each follower sees the places
    assert offsets[2, [LEADER, UAV2, UAV3]].tolist() == [[0, 0, 0], [-5, 5, 0], [-5, -5, -4]]
    # who has failed itself goes on as before
    assert np.array_equal(after.team.gains[0], before.team.gains[0])
    assert np.array_equal(offsets[0], before.team.offsets)


def test_to_drop_is_to_leave_out_and_to_stay():
    _, before, after = known_after(faults(0, OUT), "formation.on_failure.answer=drop")
    gains = before.team.gains.copy()
    gains[1:, UAV1] = 0.0
    assert np.array_equal(after.team.gains, gains)
    assert (after.law.offsets == before.team.offsets).all()


class Listening:
    """A law of one's own: the paper's, keeping what it is given."""

    def __init__(self, law):
        self._law, self.given = law, []

    def start(self, own):
        return self._law.start(own)

    def step(self, now, own, inbox, memory):
        self.given.append((now, type(inbox)(*(array.copy() for array in inbox))))
        return self._law.step(now, own, inbox, memory)


def test_a_law_of_ones_own_hears_no_more_of_whom_its_follower_drops():
    world = build(page(faults(0, OUT), "formation.on_failure={answer: drop, after_s: 2}"))
    law = Listening(world.groups[0].law)
    group = dataclasses.replace(world.groups[0], law=law)
    fly(dataclasses.replace(world, groups=(group,)), [], lambda now, due: False)
    for now, inbox in law.given:
        heard = np.isfinite(inbox.stamp_s)
        everyone = np.ones((3, 4), dtype=bool)
        if now >= 3.0:
            everyone[1:, UAV1] = False
        assert np.array_equal(heard, everyone), now
        assert np.array_equal(np.isfinite(inbox.position_ned).all(axis=2), everyone)


def test_a_law_of_ones_own_takes_no_other_place():
    changes = (faults(0, OUT), "formation.on_failure.answer=re-slot")
    with pytest.raises(InputError, match=r"on_failure\.answer.*write drop, or law: paper"):
        build(load("own-law-integral", changes))


def test_who_is_left_without_a_place_is_warned_before_the_flight():
    _, events, _ = flown(
        faults(1, OUT),
        "formation.on_failure={answer: drop, after_s: 9}",
        "formation.leader_gains.uav3=0",
        "scenario.duration_s=1",
    )
    (stranded,) = (each for each in events if "without uav2" in each[3])
    assert stranded[:3] == (0.0, "warning", "uav3")


# who is lost

# UAV 1's slot lies below the ground, UAV 2 flies beside the leader.
DIVE = """
scenario: {schema: 1, name: dive, duration_s: 15}
log: {mcap: false}
leader:
  aircraft: rascal110
  start: {altitude_m: 20}
  path:
    kind: mission
    airspeed_mps: 22
    legs: [{kind: waypoints, points_m: [[2000, 0, 20], [4000, 0, 20]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-10, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-10, -5, 0]}
formation:
  offsets_m: {uav1: [-10, 5, 40], uav2: [-10, -5, 0]}
  leader_gains: {uav1: 1, uav2: 1}
"""
GROUND = "lost: on the ground, at 1.0 m"


@pytest.mark.parametrize(
    ("changes", "code", "whole"),
    [
        ((), 1, False),
        (("limits.when_lost=fly-on",), 1, True),
        (("limits.when_lost=fly-on", faults(1, "{kind: radio-mute, at_s: 0}")), 1, True),
        (("limits.when_lost=fly-on", faults(0, "{kind: radio-mute, at_s: 0}")), 0, True),
        (("limits.when_lost=fly-on", faults(0, "{kind: radio-mute, at_s: 14.5}")), 1, True),
        ((faults(0, "{kind: radio-mute, at_s: 0}"),), 1, False),
    ],
    ids=["stop", "fly on", "another broke", "it broke", "it broke later", "it broke, stop"],
)
def test_the_exit_code_of_a_loss(changes, code, whole, tmp_path):
    """0 only if the page broke the aircraft that is lost, and the run went on without it."""
    path = tmp_path / "dive.yaml"
    path.write_text(DIVE)
    sets = [word for change in changes for word in ("--set", change)]
    where = tmp_path / "metrics.json"
    words = ("run", path, *sets, "--json", where, "--out", tmp_path / "out")
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == code, done.output
    metrics = json.loads(where.read_text())
    assert metrics["outcome"] == ("lost" if code else "flown")
    assert (metrics["simulated_s"] == 15.0) == whole
    assert metrics["lost_at_s"]["uav1"] < 14.0
    assert metrics["lost_at_s"]["uav2"] is None


def test_who_is_lost_lies_where_it_fell_and_sends_nothing():
    seen = Collector()
    testbed.run(loads(DIVE, ["limits.when_lost=fly-on"]), write=False, observers=[seen])
    lost = np.array([frame.lost for frame in seen.frames])
    at = int(np.argmax(lost[:, UAV1]))
    assert lost[at:, UAV1].all() and not lost[:at, UAV1].any()
    assert not lost[:, [LEADER, UAV2]].any()
    assert [event[1:] for event in said(seen.frames)][0] == ("error", "uav1", GROUND)
    after = seen.frames[at:]
    place = column(after, "truth", "position_ned")
    assert (place[:, UAV1] == place[0, UAV1]).all()
    assert abs(place[0, UAV1, 2]) < 2.0
    flown_m = np.linalg.norm(np.diff(place[:, UAV2], axis=0), axis=1)
    assert (flown_m > 0.5).all(), "20 m/s for 0.04 s"
    # what it sent at the moment it was lost had left before anybody looked
    sent = column(after, "links", "sent").astype(int)
    assert (sent[:, UAV2 - 1, UAV1] == sent[0, UAV2 - 1, UAV1]).all()
    assert (np.diff(sent[:, UAV2 - 1, LEADER]) == 1).all()


def test_two_that_collide_are_both_lost_and_the_others_fly_on():
    """UAV 1 and UAV 2 change sides at the same height, straight through each other."""
    across = (
        "formation.offsets_m={uav1: [-5, -5, 0], uav2: [-5, 5, 0], uav3: [-5, -5, 20]}",
        "formation.neighbour_gains=null",
        "fleet.0.start_m=[-5, 5, 0]",
        "fleet.1.start_m=[-5, -5, 0]",
        "fleet.2.start_m=[-5, -5, 20]",
    )
    limits = "limits={collision_m: 2, separation_m: 4, when_lost: fly-on}"
    frames, events, run = flown(*across, limits)
    assert [(level, source) for _, level, source, _ in events] == [
        ("warning", "uav1"),
        ("error", "uav1"),
    ]
    assert events[0][3].startswith("within 4 m of uav2: ")
    assert events[1][3].startswith("collided with uav2: ")
    lost = np.array([frame.lost for frame in frames])
    at = int(np.argmax(lost.any(axis=1)))
    assert 0.0 <= frames[at].time_s - events[1][0] < PERIOD  # autopilots look twice as often
    assert lost[at].tolist() == [False, True, True, False]
    place = column(frames, "truth", "position_ned")
    apart = np.linalg.norm(place[:, UAV1] - place[:, UAV2], axis=1)
    assert int(np.argmax(apart < 2.0)) == at
    assert apart[at] == pytest.approx(2.0, abs=0.05)
    assert (place[at:, [UAV1, UAV2]] == place[at, [UAV1, UAV2]]).all()
    assert (run.outcome, run.exit_code) == ("lost", 1)
    assert run.metrics["simulated_s"] == 8.0
    # nobody looks: they pass
    _, _, blind = flown(*across)
    assert blind.outcome == "flown"
    assert blind.metrics["min_separation_m"] < 2.0


def test_a_collision_ends_the_run_unless_the_page_says_otherwise():
    _, events, run = flown("limits.collision_m=7.5", "scenario.duration_s=2")
    assert (run.outcome, run.metrics["simulated_s"]) == ("lost", 0.0)
    # the leader is 7.07 m from UAV 1 and 8.12 m from the other two, and these 8 m apart
    assert [event[:3] for event in events] == [(0.0, "error", "leader")]
