"""The loop: everyone reads a tick before anyone writes the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from testbed.network import channel as radio
from testbed.sim.control import Control
from testbed.sim.pilots import with_ideal_leader, with_leader
from testbed.sim.watch import Arrivals, Silence, broadcast, formation_state, losses
from testbed.sim.world import World
from testbed.state import Frame, Observer, followers


def fly(world: World, observers: Sequence[Observer], stop: Callable[[], bool]) -> str:
    """Fly the world to its end; observers get a frame at the log rate.

    At each tick: the truth is read, the air blows where the aircraft are and estimates are made,
    due broadcasts are sent and what is due arrives, the leader and the followers that are due
    compute their commands from their own estimate and inbox, autopilots turn these into surfaces,
    observers look, and everything moves.

    Args:
        world: as built; its vehicles move.
        observers: begun and ended by the caller.
        stop: asked before each tick; true ends the run.

    Returns:
        The outcome: "flown", "lost" or "interrupted".
    """
    clock, vehicles, pilot, air = world.clock, world.vehicles, world.pilot, world.air
    control = Control(world.groups, len(world.names) - 1, len(world.names))
    silence = Silence(world.names[1:], world.groups[0].team.silent_after)
    arrivals = Arrivals(world.gusts, world.names)
    inboxes = radio.silent(world.channel)
    news = list(world.notes)
    lead, turn = (0.0, 0.0, 0.0), None

    for tick, ahead, due in clock.schedule(world.duration_s):
        if stop():
            return "interrupted"
        now = clock.time_s(tick)
        truth = vehicles.read()
        flown_in = vehicles.air() if due.log else None  # what the truth came about in
        if due.autopilot and air is not None:
            vehicles.blow(air.felt(now, truth))
        estimate = world.estimators.estimate(truth, fresh=due.sense)

        if due.broadcast is not None:
            content = broadcast(estimate, now)
            inboxes = radio.send(world.channel, inboxes, content, now, due.broadcast)
        if due.control or due.lead:
            own = followers(estimate)
            inboxes = radio.deliver(inboxes, now)
            for number in due.control:
                control.step(number, now, own, inboxes.inbox)
            if due.lead:
                lead, turn = pilot.command(estimate)
            told = with_leader(lead, control.command)
            if world.ideal:
                vehicles.steer(with_ideal_leader(turn, control.unicycle))
            news += silence.changes(now, control.diagnosis.guards)
        if due.autopilot:
            vehicles.act(estimate, told)

        if flown_in is not None:
            lost = vehicles.lost(truth)
            over = bool(lost.any())
            if (
                air is not None
                and (reached := air.gusts_inside(now, truth.position_ned)) is not None
            ):
                news += arrivals.changes(now, reached)
            if over:
                news += losses(now, lost, world.names)
            frame = Frame(
                tick=tick,
                time_s=now,
                truth=truth,
                estimate=estimate,
                air=flown_in,
                command=told,
                surfaces=vehicles.surfaces,
                formation=formation_state(
                    truth, control.diagnosis, control.age_s, world.offsets, world.altitudes
                ),
                events=tuple(news),
            )
            news = []
            for observer in observers:
                observer.observe(frame)
            if over:
                return "lost"
        vehicles.step(ahead)
    return "flown"
