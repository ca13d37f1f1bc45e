"""What a run needs to fly its followers by companions in processes of their own."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from testbed.core.errors import InputError
from testbed.flight.world import World
from testbed.mavlink.udp_endpoint import LOOPBACK, Address
from testbed.runs.external_options import ExternalOptions
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ArduPlane, External
from testbed.scenario.arguments import with_changes

if TYPE_CHECKING:
    from testbed.runs.companion_hub import CompanionHub
    from testbed.runs.companion_processes import CompanionProcesses

FAILSAFE_S = 3.0  # without a command, as ArduPlane's in GUIDED


def commands_of(*, lockstep: bool) -> External:
    """Return how the companions of a run command its followers."""
    return External(kind="external", lockstep=lockstep, failsafe_s=FAILSAFE_S)


def with_message_links(scenario: Scenario) -> Scenario:
    """Return the scenario with states, commands and messages of the digits that MAVLink has.

    The run's own controller, of which the log has its desired values, then computes what the
    companions do.
    """
    controller, network = scenario.controller, scenario.network
    companion = with_changes(controller.companion, link="mavlink")
    changed = with_changes(
        scenario,
        controller=with_changes(controller, companion=companion),
        network=with_changes(network, encoding="follow-target"),
    )
    return changed.with_set_keys(scenario.set_keys)


def check_companions(scenario: Scenario, world: World) -> None:
    """Check that companions in processes of their own can fly the followers.

    Raises:
        InputError: they cannot; with the key, and what to write.
    """
    companion, network, rates = scenario.controller.companion, scenario.network, scenario.rates
    parts = world.formation
    problem = ""
    if outside := [e.name for e in scenario.aircraft if isinstance(e.commanded_by, External)]:
        problem = (
            f"{', '.join(outside)}: commanded_by: external is another program's (leave it out)"
        )
    elif companion.state_latency_s or companion.command_latency_s:
        problem = (
            "controller.companion: its latencies are those of the processes (write "
            "state_latency_s: 0 and command_latency_s: 0)"
        )
    elif rates.log_hz != rates.control_hz:
        problem = (
            f"rates.log_hz: companions step once for each sample (write {rates.control_hz}, as "
            "rates.control_hz)"
        )
    elif arduplanes := [
        each.name for each in scenario.aircraft if isinstance(each.autopilot, ArduPlane)
    ]:
        problem = (
            f"{', '.join(arduplanes)}: is flown by ArduPlane, which a companion commands at "
            "ArduPlane's own port (write autopilot: virtual)"
        )
    elif scenario.leader.vehicle == "unicycle":
        problem = "leader: an ideal vehicle has no autopilot (write vehicle: jsbsim)"
    elif network.clocks:
        problem = "network.clocks: companions stamp their messages themselves (leave it out)"
    elif parts.radio.corrupts:
        problem = "network.corrupt: the frames of companions pass as they come (leave it out)"
    elif parts.control.responds:
        problem = (
            "formation.on_failure: companions assign no slots, and declare no failures (leave it "
            "out)"
        )
    elif parts.built_control.outputs.sent:
        problem = "controller.law: FOLLOW_TARGET has no place for numbers of a law's own"
    if problem:
        raise InputError(f"--companions: {problem}")


@dataclass(frozen=True, slots=True)
class CompanionRun:
    """The companions of a run.

    Attributes:
        hub: at which they exchange messages.
        processes: not started yet.
        options: of the run, with the links to the companions.
        epoch_us: Unix time of the start of the run, µs.
    """

    hub: CompanionHub
    processes: CompanionProcesses
    options: ExternalOptions
    epoch_us: int


def open_companions(
    options: ExternalOptions, world: World, closing: ExitStack
) -> CompanionRun | None:
    """Open what the companions of a run need; None: it has none.

    Args:
        options: of the run.
        world: that is flown.
        closing: closes what is opened.

    Raises:
        InputError: no ports are free, or links are to be signed.
    """
    if not options.companions:
        return None
    # messages of MAVLink: 10 ms that other runs save
    from testbed.runs.companion_hub import CompanionHub
    from testbed.runs.companion_processes import CompanionProcesses, free_ports

    if options.signing_key is not None:
        raise InputError(
            "--companions: links to companions of a run are not signed (leave out --mavlink-key)"
        )
    # of whole ms, as times in messages are
    epoch_us = 1000 * round(1e3 * time.time())
    port = free_ports(len(world.names))
    hub = CompanionHub(epoch_us, pace=options.pace)
    closing.callback(hub.close)
    processes = CompanionProcesses(world.names, hub, port, lockstep=not options.pace)
    hub.watch = processes.watch
    link = Address("udpout", LOOPBACK, port, step=1)
    return CompanionRun(
        hub, processes, replace(options, mavlink=(*options.mavlink, link)), epoch_us
    )
