"""The loop: everyone reads a tick before anyone writes the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from testbed.network.scripts import Calendar
from testbed.sim.audience import Audience
from testbed.sim.casualties import Casualties
from testbed.sim.clock import Due
from testbed.sim.control import Control
from testbed.sim.hearing import Hearing
from testbed.sim.pilots import with_ideal_leader
from testbed.sim.watch import Arrivals, Engagement, Slots, Speaker
from testbed.sim.world import World
from testbed.state import Frame, Observer, followers
from testbed.steady import Steady


def fly(world: World, observers: Sequence[Observer], ended: Callable[[float, Due], bool]) -> str:
    """Fly the world to its end; observers get a frame at the log rate.

    At each tick: the truth is read, the air blows where the aircraft are, what is due to break
    breaks and estimates are made, due broadcasts are sent and what is due arrives, the leader and
    the followers that are due compute their commands from their own estimate and inbox, autopilots
    turn these into surfaces, observers look, and everything moves to the next.

    Args:
        world: as built; its vehicles move.
        observers: begun and ended by the caller.
        ended: asked before each tick, of its time and what is due; it may wait, and true ends the
            run.

    Returns:
        The outcome: "flown", "lost", "upset" or "interrupted".
    """
    clock, vehicles, pilot, air = world.clock, world.vehicles, world.pilot, world.air
    radio, calendar = world.radio, Calendar(world.scripts)
    breakdowns, deck = world.breakdowns, world.deck
    control = Control(world.groups, world.offsets, world.roster)
    speaker, slots = Speaker(len(world.names)), Slots(len(world.names) - 1)
    hearing = Hearing(world.names, world.groups, radio.ledger)
    arrivals = Arrivals(world.gusts, world.names)
    engagement = Engagement(world.names[1:], clock.base_rate_hz)
    casualties = Casualties(world.names, world.proximity, breakdowns, fly_on=world.fly_on)
    upsets, audience = world.upsets, Audience(observers)
    # what is read and believed stays in the same arrays, to which compiled code is bound
    moved, believed, handed = Steady(), Steady(), Steady()
    news = list(world.notes)
    told, turn = control.told, None
    failing, hushed, apart = None, None, control.alone
    seen, own = None, None

    for tick, due, ticks, legs in clock.schedule(world.duration_s, everyone=radio.looks_around):
        now = clock.time_s(tick)
        if ended(now, due):
            return "interrupted"
        truth = moved(vehicles.read())
        flown_in = vehicles.air() if due.log else None  # what the truth came about in
        if due.autopilot and air is not None:
            vehicles.blow(air.felt(now, truth))
        if due.autopilot and breakdowns is not None:
            news += breakdowns.changes(now, truth, vehicles.air, casualties.gone)
            failing = breakdowns.failing
            hushed = failing.mute | failing.frozen | casualties.gone
        estimate = world.estimators.estimate(truth, fresh=due.autopilot, failing=failing)
        if estimate is not truth:
            estimate = believed(estimate)

        if due.broadcast is not None:
            message = speaker.says(estimate, now)
            sent_s = message.stamp_s if due.sent_s is None else due.sent_s
            radio.send(sent_s, message, truth, due.broadcast, hushed)
        if due.control or due.lead:
            if estimate is not seen or own is None:
                seen, own = estimate, followers(estimate)
            inbox = radio.deliver(now)
            for number in due.control:
                if learnt := control.learn(number, now, inbox, radio.measured_s):
                    news += learnt
                    apart = control.alone | casualties.gone[1:]
                    hearing.heed(control.groups, apart)
                stepped = control.step(number, now, own, inbox, radio.measured_s)
                guards = control.diagnosis.guards
                news += hearing.changes(now, stepped, control.age_s, guards, inbox.received_s)
            told = control.told
            if due.lead:
                if deck is not None:
                    hung = None if failing is None else failing.frozen
                    deck.guide(now, estimate, casualties.gone, hung)
                lead, turn = pilot.command(estimate)
                told.pitch[0], told.roll[0], told.throttle[0] = lead
            if world.ideal:
                vehicles.steer(with_ideal_leader(turn, control.unicycle))
            news += hearing.silences(now, control.diagnosis.guards, apart)
        if due.autopilot:
            if deck is not None:
                news += deck.news()
                told = handed(deck.told(told))
            vehicles.act(estimate, told)
            for partner in world.partners:
                news += partner.news(now)
            if failing is not None:
                vehicles.fail(failing)
            if lost := casualties.changes(now, truth.position_ned, vehicles.lost(truth)):
                news += lost
                vehicles.remove(casualties.gone)
                if air is not None:
                    air.remove(casualties.gone)
                hushed = casualties.gone if hushed is None else hushed | casualties.gone
                apart = control.alone | casualties.gone[1:]
                hearing.heed(control.groups, apart)

        if flown_in is not None:
            reached = None if air is None else air.gusts_inside(now, truth.position_ned)
            if reached is not None:
                news += arrivals.changes(now, reached)
            news = [*calendar.changes(now), *news]  # what is scripted before what comes of it
            formation = slots.state(
                truth,
                estimate,
                control.diagnosis if deck is None else deck.heeded(control.diagnosis),
                control.age_s,
                control.offsets,
                control.places,
                world.altitudes,
            )
            news += engagement.changes(tick, formation.error_ned, casualties.gone)
            away = apart if deck is None else deck.away(apart)
            news += upsets.changes(now, truth, flown_in, formation, (casualties.gone, away))
            audience.observe(
                Frame(
                    tick=tick,
                    time_s=now,
                    truth=truth,
                    estimate=estimate,
                    air=flown_in,
                    command=told,
                    surfaces=vehicles.surfaces,
                    formation=formation,
                    links=radio.counts(),
                    lost=casualties.gone,
                    events=tuple(news),
                    failing=failing,
                )
            )
            news = []
            if casualties.over:
                return "lost"
            if upsets.over:
                return "upset"
        vehicles.step(ticks, legs)
    return "upset" if upsets.unforeseen and casualties.outcome == "flown" else casualties.outcome
