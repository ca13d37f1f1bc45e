"""Build a companion from a scenario and its links."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from testbed.companion.checks import EngagementLimits
from testbed.companion.control_loop import (
    CompanionLinks,
    CompanionLoop,
    FixedGate,
    FlightListener,
    Gate,
)
from testbed.companion.engagement import CompanionText, Engagement, LeaveMode
from testbed.companion.follower_control import FollowerControl
from testbed.companion.formation_link import FormationAddress, FormationLink
from testbed.companion.scenario_digest import AGREED_PARAMETERS, scenario_digest
from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, read_bounded
from testbed.link.ends import EndAddress, open_end
from testbed.mavlink.outgoing import Severity
from testbed.mavlink.signing import MessageSigner, Signing, signing_time
from testbed.plan.fleet import FormationPlan
from testbed.plan.scenario_files import referenced_files, referents
from testbed.pool.scenario_snapshot import snapshot
from testbed.scenario import Scenario

UNSIGNED = CompanionText(Severity.WARNING, "formation is unsigned: anyone can fly it")
_AUTOPILOT_LINK, _FORMATION_LINK = 0, 1  # link ids of signatures


@dataclass(frozen=True, slots=True)
class CompanionOptions:
    """How a companion is started.

    Attributes:
        autopilot: address of the autopilot.
        formation: address of the others.
        key: 32 secret bytes that sign messages; None: none.
        unsigned: links that other computers reach may be without a key.
        leave: mode that is asked for when it leaves.
        lockstep: a run waits for its commands.
        at_once: command from the first sample on, as in lockstep.
    """

    autopilot: EndAddress
    formation: FormationAddress
    key: bytes | None = None
    unsigned: bool = False
    leave: LeaveMode = LeaveMode.LOITER
    lockstep: bool = False
    at_once: bool = False

    @property
    def reaches_aircraft(self) -> bool:
        """Whether a link leads to more than the programs of this computer."""
        return self.autopilot.may_reach_aircraft or not self.formation.loopback

    def check(self) -> None:
        """Check that the options fit each other.

        Raises:
            InputError: they do not.
        """
        if not self.reaches_aircraft:
            return
        where = self.formation if self.autopilot.kind != "udp" else self.autopilot
        if self.lockstep or self.at_once:
            option = "--lockstep" if self.lockstep else "--at-once"
            raise InputError(
                f"{option}: commands without the pilot's switch, and a link leads out of this "
                f"computer: {self.autopilot}, {self.formation} (use addresses of 127.0.0.1, or "
                "leave it out)"
            )
        if self.key is None and not self.unsigned:
            raise InputError(
                f"{where}: leads out of this computer (write --mavlink-key FILE with the key of "
                "all companions, or --unsigned: then anyone who reaches the port can fly the "
                "aircraft)"
            )


def digest_of(scenario: Scenario, folder: Path) -> int:
    """Return the digest of a scenario: the resolved scenario, and all files that it names.

    Args:
        scenario: resolved.
        folder: of its file.
    """
    resolved = snapshot(scenario, folder)
    flight = scenario.controller.companion.model_dump(mode="json")
    parts = [("scenario", json.dumps([resolved, flight], sort_keys=True).encode())]
    files = referenced_files(referents(scenario))
    parts += [(name, read_bounded(file, MAX_TABLE_BYTES)) for name, file in files.items()]
    return scenario_digest(parts)


def flight_limits(
    scenario: Scenario, plan: FormationPlan, control: FollowerControl, *, reaches_aircraft: bool
) -> EngagementLimits:
    """Return the bounds of the flight of a follower."""
    own = plan.aircraft[control.row]
    assumed = {
        name: float(value)
        for name in AGREED_PARAMETERS
        if (value := getattr(own.params, name.lower(), None)) is not None
    }
    return EngagementLimits(
        scenario.controller.companion.flight,
        plan.names[0],
        tuple(plan.names[m] for m in control.used),
        tuple(
            each.name
            for each in plan.aircraft
            if each.folder == own.folder and each.tune_file == own.tune_file and each is not own
        ),
        assumed,
        reaches_aircraft=reaches_aircraft,
    )


def make_gate(scenario: Scenario, control: FollowerControl, options: CompanionOptions) -> Gate:
    """Return what decides when the aircraft is commanded."""
    if not control.row:
        return FixedGate(commands=False)
    if options.lockstep or options.at_once:
        return FixedGate(commands=True)
    limits = flight_limits(
        scenario, control.plan, control, reaches_aircraft=options.reaches_aircraft
    )
    return Engagement(limits, options.leave)


@contextmanager
def open_companion(
    scenario: Scenario,
    folder: Path,
    control: FollowerControl,
    options: CompanionOptions,
    listeners: Sequence[FlightListener],
) -> Iterator[CompanionLoop]:
    """Open the links of a companion, and close them at the end of the block.

    Args:
        scenario: resolved.
        folder: of its file.
        control: of the aircraft.
        options: checked.
        listeners: take what happens.

    Raises:
        InputError: a link cannot be opened.
    """
    now = signing_time(time.time())

    def signer(link: int) -> MessageSigner | None:
        if options.key is None:
            return None
        return MessageSigner(Signing(options.key, link=link, time=now, strict=True))

    wire = options.autopilot.kind != "udp"  # without other programs
    with ExitStack() as closing:
        autopilot = open_end(options.autopilot)
        closing.callback(autopilot.close)
        formation = FormationLink(options.formation, control.row)
        closing.callback(formation.close)
        links = CompanionLinks(
            autopilot,
            formation,
            stream=options.autopilot.is_stream,
            autopilot_signer=None if wire else signer(_AUTOPILOT_LINK),
            formation_signer=signer(_FORMATION_LINK),
        )
        yield CompanionLoop(
            control,
            links,
            make_gate(scenario, control, options),
            digest_of(scenario, folder),
            listeners,
            lockstep=options.lockstep,
            notices=[UNSIGNED] if options.reaches_aircraft and options.key is None else (),
        )
