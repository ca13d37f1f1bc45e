"""When a companion commands, refuses and leaves: every reason, and properties of any sequence."""

import dataclasses
import os
import random

import pytest
from cases import ALL
from companion_flights import (
    BREAKS,
    FBWA,
    GUIDED,
    LIMITS,
    PERIOD_S,
    changed,
    observe,
    old,
    other,
    own,
    peer,
)

from testbed.companion.checks import REASONS, Ending, Reason
from testbed.companion.engagement import (
    ASKING_S,
    FRESH_MODE_S,
    Decision,
    Engagement,
    EngagementState,
    LeaveMode,
)
from testbed.mavlink.outgoing import TEXT_BYTES
from testbed.scenario.companion_flight import CompanionFlight

LOOPBACK = dataclasses.replace(LIMITS, reaches_aircraft=False)
SEQUENCES = int(os.environ.get("TESTBED_ENGAGEMENTS", "20" if ALL else "10"))
RTL = 11
CASES = [(reason, number) for reason, every in BREAKS.items() for number in range(len(every))]
# in `make test` one way of each reason: all of them leave an engagement, by the same checks
LASTING_CASES = [
    (reason, number)
    for reason, number in CASES
    if reason is not Reason.PAUSED and (ALL or number == 0)
]


class Pass:
    """Passes of a companion's loop, one after the other."""

    def __init__(self, limits=LIMITS, leave=LeaveMode.LOITER, machine=Engagement):
        self.machine, self.t = machine(limits, leave), 100.0
        self.decisions = []

    def fly(self, duration_s, mode, broken=lambda seen: seen):
        """Pass for some time; return the decisions."""
        begun = len(self.decisions)
        for _ in range(round(duration_s / PERIOD_S)):
            self.t += PERIOD_S
            self.decisions.append(self.machine.step(broken(observe(self.t, mode))))
        return self.decisions[begun:]

    def engage(self):
        self.fly(1, FBWA)
        last = self.fly(1, GUIDED)[-1]
        assert last.command and last.state is EngagementState.ENGAGED
        return self


def texts(decisions):
    return [each.text for one in decisions for each in one.texts]


def fits(text):
    """Whether a text is one STATUSTEXT."""
    return len(text) <= TEXT_BYTES and text.isascii()


def asked(decisions):
    return [each.change_mode for each in decisions if each.change_mode is not None]


def once(broken):
    """Break the first observation only: what has a memory must remember it."""
    left = [broken]
    return lambda seen: left.pop()(seen) if left else seen


def test_good_flight_engages_by_the_switch_and_stays():
    flight = Pass()
    before = flight.fly(1, FBWA)
    assert not any(each.command for each in before)
    assert before[-1].state is EngagementState.READY
    after = flight.fly(20, GUIDED)
    assert all(each.command for each in after)
    found = flight.decisions
    assert texts(found) == ["formation ready: GUIDED engages it", "formation engaged"]
    assert not asked(found) and not any(each.reasons for each in found)


def test_every_reason_of_the_table_is_tried():
    assert BREAKS.keys() == REASONS.keys()
    assert set(REASONS) == set(Reason)
    untried = {each for each, ways in BREAKS.items() if not ways}
    assert untried == {Reason.NO_FENCE, Reason.HEIGHTS_DIFFER}  # tried below


@pytest.mark.parametrize(("reason", "number"), CASES, ids=lambda each: getattr(each, "value", each))
def test_reason_leaves_or_is_let_pass(reason, number):
    """It ends an engagement after its time, with its text and its request, as the table has it."""
    row, flight = REASONS[reason], Pass().engage()
    decisions = flight.fly(3, GUIDED, BREAKS[reason][number])
    assert all(fits(each) for each in texts(decisions))
    if not row.leaves:
        assert all(each.command for each in decisions)
        return
    first = next(k for k, each in enumerate(decisions) if not each.command)
    left = decisions[first]
    assert left.state is EngagementState.LEFT and reason in left.reasons
    assert first * PERIOD_S >= row.lasts_s - PERIOD_S
    assert not any(each.command for each in decisions[first:])
    assert [text for text in texts([left]) if text.startswith("formation left: ")]
    expected = [LeaveMode.LOITER] if row.ending is Ending.ASKS_MODE else []
    assert asked(decisions) == expected


@pytest.mark.parametrize(
    ("reason", "number"), LASTING_CASES, ids=lambda each: getattr(each, "value", each)
)
def test_reason_refuses_or_is_let_pass(reason, number):
    """While it holds the switch engages nothing, and nothing engages when it has ended."""
    row, flight = REASONS[reason], Pass()
    flight.fly(1, FBWA)
    broken = BREAKS[reason][number]
    flight.fly(1, FBWA, lambda seen: changed(broken(seen), mode=FBWA))
    decisions = flight.fly(0.4, GUIDED, lambda seen: changed(broken(seen), mode=GUIDED))
    assert all(fits(each) for each in texts(flight.decisions))
    if not row.refuses:
        assert decisions[-1].command
        return
    assert not any(each.command for each in decisions)
    assert not asked(decisions)
    after = flight.fly(10, GUIDED)
    assert not any(each.command for each in after) and not asked(after)
    assert after[-1].state is EngagementState.LEFT
    flight.fly(6, FBWA)
    assert flight.fly(1, GUIDED)[-1].command


def test_switch_during_a_pause_engages_nothing():
    """The process is stopped while it is ready, and the pilot switches meanwhile."""
    flight = Pass()
    flight.fly(1, FBWA)
    flight.t += 30
    refused = flight.fly(5, GUIDED)
    assert refused[0].reasons[0] is Reason.PAUSED
    assert not any(each.command for each in refused)
    flight.fly(1, FBWA)
    assert flight.fly(1, GUIDED)[-1].command


@pytest.mark.parametrize("reason", [Reason.STATE_JUMP, Reason.LEADER_JUMP, Reason.TIME_JUMP])
def test_a_jump_is_remembered_for_seconds(reason):
    flight = Pass()
    flight.fly(1, FBWA)
    flight.fly(1, FBWA, once(lambda seen: changed(BREAKS[reason][0](seen), mode=FBWA)))
    refused = flight.fly(0.2, GUIDED)
    assert not any(each.command for each in refused) and reason in refused[0].reasons


def test_scenario_without_fence_is_refused():
    without_fence = dataclasses.replace(LIMITS, flight=CompanionFlight())
    flight = Pass(without_fence)
    assert flight.fly(1, FBWA)[-1].reasons == (Reason.NO_FENCE,)
    assert not flight.fly(1, GUIDED)[-1].command
    Pass(dataclasses.replace(without_fence, reaches_aircraft=False)).engage()


def on_the_ground(apart_m, speed=0.0):
    """Return the break by which all aircraft stand, and uav1 is that much higher."""

    def stand(seen):
        still = {"velocity_ned": (speed, 0.0, 0.0), "position_ned": (0.0, 0.0, -1.0)}
        others = {
            name: peer(seen.boot_s, 3.0, height_m=300.0 + apart_m * (name == "uav1"), **still)
            for name in seen.peers
        }
        return changed(seen, armed=False, peers=others, **still)

    return stand


@pytest.mark.parametrize(("apart_m", "engages"), [(4.9, True), (5.1, False), (-5.1, False)])
def test_heights_that_differ_on_the_ground_refuse(apart_m, engages):
    """The comparison outlasts the take-off, where positions jump from here to there."""
    flight = Pass()
    found = texts(flight.fly(8, FBWA, on_the_ground(apart_m)))
    assert f"heights compared: uav1 {apart_m:+.1f} m" in found
    flight.fly(10, FBWA)
    assert flight.fly(1, GUIDED)[-1].command is engages
    assert (Reason.HEIGHTS_DIFFER in flight.decisions[-1].reasons) is not engages


def test_heights_of_moving_aircraft_are_not_compared():
    flight = Pass()
    assert not [t for t in texts(flight.fly(8, FBWA, on_the_ground(9, 1.5))) if "heights" in t]
    flight.fly(10, FBWA)
    assert flight.fly(1, GUIDED)[-1].command


def test_companion_that_starts_in_guided_waits():
    flight = Pass()
    decisions = flight.fly(10, GUIDED)
    assert not any(each.command for each in decisions) and not asked(decisions)
    assert texts(decisions) == ["formation refused: GUIDED was on already"]
    flight.fly(0.2, FBWA)
    assert flight.fly(0.2, GUIDED)[-1].command


def test_switch_that_was_not_seen_engages_nothing():
    """The mode became GUIDED while no HEARTBEAT came."""
    flight = Pass()
    flight.fly(1, FBWA)
    flight.fly(5, FBWA, old("HEARTBEAT"))
    assert not any(each.command for each in flight.fly(5, GUIDED))


def test_sticks_and_receiver_count_on_aircraft_only():
    """The testbed's vehicle answers with the pulses of the command, and has no pilot."""
    flight = Pass(LOOPBACK).engage()
    assert flight.fly(2, GUIDED, BREAKS[Reason.STICK][0])[-1].command
    assert flight.fly(2, GUIDED, own(sticks_us=None))[-1].command


def test_stick_that_was_held_at_engagement_may_stay():
    flight = Pass()
    flight.fly(1, FBWA)
    held = own(sticks_us=(1800.0, 1500.0, 1500.0))
    assert flight.fly(5, GUIDED, held)[-1].command
    assert not flight.fly(1, GUIDED)[-1].command


@pytest.mark.parametrize(
    ("reason", "lasts_s", "stays"),
    [
        (Reason.AIRSPEED, 0.9, True),
        (Reason.AIRSPEED, 1.2, False),
        (Reason.CLOCKS_APART, 0.9, True),
        (Reason.CLOCKS_APART, 1.2, False),
        (Reason.STICK, 0.08, True),
    ],
)
def test_short_breaks_are_outlasted(reason, lasts_s, stays):
    flight = Pass().engage()
    flight.fly(lasts_s, GUIDED, BREAKS[reason][0])
    assert flight.fly(1, GUIDED)[-1].command is stays


@pytest.mark.parametrize("leave", LeaveMode)
def test_the_mode_of_choice_is_asked_for(leave):
    flight = Pass(leave=leave).engage()
    assert asked(flight.fly(3, GUIDED, own(fix_type=0))) == [leave]
    assert leave == {"RTL": RTL, "LOITER": 12}[leave.name]


def test_no_mode_is_asked_for_after_the_pilots():
    """He switches after the last HEARTBEAT; the next one tells."""
    flight = Pass().engage()
    aged = old("HEARTBEAT", age_s=FRESH_MODE_S + 0.1)
    left = flight.fly(1, GUIDED, lambda seen: changed(aged(seen), fix_type=0))
    assert not left[-1].command and not asked(left)
    assert not asked(flight.fly(3, RTL)) and not asked(flight.fly(3, GUIDED))


def test_mode_is_asked_for_when_a_heartbeat_has_come():
    flight = Pass().engage()
    aged = old("HEARTBEAT", age_s=FRESH_MODE_S + 0.1)
    assert not asked(flight.fly(1, GUIDED, lambda seen: changed(aged(seen), fix_type=0)))
    assert not flight.machine.may_end
    assert asked(flight.fly(1, GUIDED)) == [LeaveMode.LOITER]
    assert flight.machine.may_end


def test_late_heartbeat_asks_for_no_mode():
    """ArduPlane has left attitudes by then, and circles."""
    flight = Pass().engage()
    aged = old("HEARTBEAT", age_s=FRESH_MODE_S + 0.1)
    flight.fly(ASKING_S + 0.1, GUIDED, lambda seen: changed(aged(seen), fix_type=0))
    assert not asked(flight.fly(5, GUIDED))
    assert flight.machine.may_end


def test_waiting_tells_each_reason_once():
    flight = Pass()
    found = flight.fly(10, FBWA, own(fix_type=0)) + flight.fly(10, FBWA, own(armed=False))
    found += flight.fly(3, FBWA) + flight.fly(3, FBWA, own(armed=False))
    assert texts(found) == [
        "formation waits: GPS fix type 0",
        "formation waits: not armed",
        "formation ready: GUIDED engages it",
        "formation waits: not armed",
    ]


# Properties of any sequence, by rules of their own.


def drawn(seed, steps=400):
    """Draw observations: the mode is switched, and breaks come, go and overlap."""
    draw = random.Random(seed)
    breaks = [each for ways in BREAKS.values() for each in ways]
    now, mode, active = 100.0, draw.choice((FBWA, GUIDED)), []
    told, told_s, every_s = mode, now, draw.choice((0.1, 0.5, 1.0))  # by HEARTBEAT
    for _ in range(steps):
        now += PERIOD_S
        if draw.random() < 0.03:
            mode = draw.choice((FBWA, GUIDED, GUIDED, RTL))
        if draw.random() < 0.01:
            active.append((draw.choice(breaks), now + draw.choice((0.1, 1.5, 4.0))))
        if draw.random() < 0.01:
            active.append((old("HEARTBEAT", age_s=draw.choice((0.2, 0.5, 2.0, 5.0))), now + 1.0))
        active = [(each, until) for each, until in active if until > now]
        if now - told_s >= every_s:
            told, told_s = mode, now
        seen = old("HEARTBEAT", age_s=now - told_s)(observe(now, told))
        for broken, _ in active:
            seen = changed(broken(seen), mode=told)  # modes are those of the pilot
        yield seen


def check_rules(machine, sequence):
    """Assert what holds of every companion; return how often it engaged and asked."""
    free = commanded = False  # the switch was seen outside GUIDED, without a gap, since the last
    engagements = requests = 0
    asked_since = False
    latest = None
    for seen in sequence:
        decision = machine.step(seen)
        heartbeat = seen.age_s("HEARTBEAT")
        paused = latest is not None and seen.now_s - latest > LIMITS.flight.pause_s
        latest = seen.now_s
        if decision.command:
            assert decision.state is EngagementState.ENGAGED
            assert seen.mode == GUIDED and heartbeat <= LIMITS.flight.status_age_s
            assert seen.armed and seen.fix_type >= 3 and not seen.stopping and not paused
            assert max(seen.age_s(each) for each in ("ATTITUDE", "VFR_HUD")) <= 1.0
            if not commanded:
                assert free, "engaged without the pilot's switch"
                engagements, free, asked_since = engagements + 1, False, False
        if decision.change_mode is not None:
            assert not decision.command and not asked_since, "asked twice, or while commanding"
            assert seen.mode == GUIDED and heartbeat <= FRESH_MODE_S, "asked against the pilot"
            assert engagements, "asked without an engagement"
            assert not free, "asked although the pilot has switched since"
            asked_since, requests = True, requests + 1
        commanded = decision.command
        if heartbeat > LIMITS.flight.status_age_s or (commanded and seen.mode == GUIDED):
            free = False
        elif seen.mode != GUIDED:
            free = True
    return engagements, requests


def test_rules_hold_for_drawn_sequences():
    counts = [check_rules(Engagement(LIMITS), drawn(seed)) for seed in range(SEQUENCES)]
    engagements, requests = (sum(each) for each in zip(*counts, strict=True))
    assert engagements > SEQUENCES and requests > SEQUENCES / 4


class StaysOn(Engagement):
    """Commands once more after it has left."""

    def step(self, seen):
        was = self._state
        decision = super().step(seen)
        return dataclasses.replace(decision, command=was is EngagementState.ENGAGED)


class EngagesAtStart(Engagement):
    """Takes GUIDED at its start for a switch."""

    def __init__(self, *given):
        super().__init__(*given)
        self._may_engage = True


class EngagesAgain(Engagement):
    """Goes on when the reason has ended, without a switch."""

    def _idle(self, seen):
        self._may_engage = self._may_engage or self._state is EngagementState.LEFT
        return super()._idle(seen)


class AsksAgain(Engagement):
    """Asks for its mode until it is there."""

    def _ask_mode(self, seen):
        until = self._asks_until_s
        asks = super()._ask_mode(seen)
        self._asks_until_s = until
        return asks


class AsksByOldMode(Engagement):
    """Trusts a mode of some seconds ago."""

    def _ask_mode(self, seen):
        return super()._ask_mode(changed(seen, ages_s={**seen.ages_s, "HEARTBEAT": 0.0}))


class AsksInAnyMode(Engagement):
    """Changes the pilot's mode."""

    def _idle(self, seen):
        until = self._asks_until_s
        found = super()._idle(seen)
        self._asks_until_s = until
        return found

    def _ask_mode(self, seen):
        return super()._ask_mode(changed(seen, mode=GUIDED))


class IgnoresGaps(Engagement):
    """Takes a switch that it has not seen for one."""

    def _idle(self, seen):
        may = self._may_engage
        found = super()._idle(seen)
        self._may_engage = self._may_engage or (may and seen.age_s("HEARTBEAT") > 3.0)
        return found


# with a sequence that finds each
MUTANTS = {StaysOn: 2, EngagesAtStart: 0, EngagesAgain: 0, AsksAgain: 2, AsksByOldMode: 4}
MUTANTS |= {AsksInAnyMode: 26, IgnoresGaps: 1}


@pytest.mark.parametrize(("machine", "seed"), MUTANTS.items())
def test_rules_find_a_wrong_machine(machine, seed):
    """Control: each rule is broken by a machine that lacks it."""
    with pytest.raises(AssertionError):
        check_rules(machine(LIMITS), drawn(seed))


def test_a_decision_can_neither_arm_nor_take_off():
    """What a companion can ask of the autopilot is one of two modes."""
    names = {each.name for each in dataclasses.fields(Decision)}
    assert names == {"state", "command", "change_mode", "texts", "reasons"}
    assert {each.name for each in LeaveMode} == {"RTL", "LOITER"}


def test_a_peer_that_is_not_used_is_of_no_matter():
    limits = dataclasses.replace(LIMITS, used=("leader",))
    flight = Pass(limits).engage()
    assert flight.fly(2, GUIDED, other("uav1", age_s=9.0, digests=5, offset_s=3.0))[-1].command
