"""The loop: everyone reads a tick before anyone writes the next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from testbed.network import channel as radio
from testbed.sim.pilots import MissionPilot, with_leader
from testbed.sim.watch import broadcast, formation_state, losses
from testbed.sim.world import World
from testbed.state import Frame, Observer, followers
from testbed.vehicle.fbwa import AUTOPILOT, settled


def fly(world: World, observers: Sequence[Observer], stop: Callable[[], bool]) -> str:
    """Fly the world to its end; observers get a frame at the log rate.

    At each tick: the truth is read and estimated, due broadcasts are sent and what is due arrives,
    followers and leader compute their commands from their own estimate and inbox, autopilots turn
    these into surfaces, observers look, and every flight model steps.

    Args:
        world: as built; its flight models move.
        observers: begun and ended by the caller.
        stop: asked before each tick; true ends the run.

    Returns:
        The outcome: "flown", "lost" or "interrupted".
    """
    clock, fleet, law, pilot = world.clock, world.fleet, world.law, world.pilot
    mission = pilot if isinstance(pilot, MissionPilot) else None
    recorded = None if isinstance(pilot, MissionPilot) else pilot
    flown = world.names if mission else world.names[1:]
    autopilots = settled(fleet.trimmed, world.gains)
    inboxes = radio.silent(world.channel)
    memory: Any = None
    stride = clock.stride

    for tick in range(0, clock.ticks(world.duration_s) + 1, stride):
        if stop():
            return "interrupted"
        now = clock.time_s(tick)
        truth = motion = fleet.read()
        if recorded:
            truth = recorded.prepend(tick // stride, truth)
        estimate = world.estimators.estimate(truth)

        if tick % clock.broadcast == 0:
            inboxes = radio.send(world.channel, inboxes, broadcast(estimate, now), now)
        if tick % clock.control == 0:
            own = followers(estimate)
            inboxes = radio.deliver(inboxes, now)
            if memory is None:
                memory = law.start(own)
            command, memory, diagnosis = law.step(now, own, inboxes.inbox, memory)
            told = with_leader(mission.command(estimate), command) if mission else command
        if tick % clock.autopilot == 0:
            believed = estimate if mission else followers(estimate)
            surfaces, autopilots = AUTOPILOT(believed, told, autopilots, world.gains)

        if tick % clock.log == 0:
            lost = fleet.lost(motion)
            over = bool(lost.any())
            row = tick // stride
            frame = Frame(
                tick=tick,
                time_s=now,
                truth=truth,
                estimate=estimate,
                air=recorded.prepend_air(fleet.air()) if recorded else fleet.air(),
                command=recorded.prepend_command(row, told) if recorded else told,
                surfaces=recorded.prepend_surfaces(row, surfaces) if recorded else surfaces,
                formation=formation_state(truth, diagnosis, world.offsets),
                events=losses(now, lost, flown) if over else (),
            )
            for observer in observers:
                observer.observe(frame)
            if over:
                return "lost"
        fleet.step(surfaces, stride)
    return "flown"
