"""What a link does to packets: from a file of its own, or from the network of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from testbed.core.errors import InputError
from testbed.link.link_file import FRAMES, LinkFile, Position
from testbed.scenario import Scenario
from testbed.scenario.arguments import with_changes
from testbed.scenario.network import Network
from testbed.scenario.problems import did_you_mean

DEFAULT_SEED = 1  # that of a scenario, too


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """What a link does to packets.

    Attributes:
        names: of the two ends.
        network: section with the links between them.
        seed: of the random numbers.
        frames: a packet is a frame, in order; else a datagram.
        radio: the ends get RADIO_STATUS.
        positions: of ends that stay where they are, by their number.
    """

    names: tuple[str, str]
    network: Network
    seed: int = 1
    frames: bool = False
    radio: bool = False
    positions: Mapping[int, Position] = field(default_factory=dict)


def settings_from_file(file: LinkFile, seed: int | None = None) -> LinkSettings:
    """Return the settings of a file.

    Args:
        file: of the link.
        seed: of the random numbers; None: `DEFAULT_SEED`.
    """
    return LinkSettings(
        file.ends,
        _ordered(file.network, file.ends),
        DEFAULT_SEED if seed is None else seed,
        file.unit == FRAMES,
        file.radio is not None,
        {file.ends.index(name): place for name, place in file.positions.items()},
    )


def settings_from_scenario(
    scenario: Scenario, between: tuple[str, str], *, frames: bool = False, radio: bool = False
) -> LinkSettings:
    """Return the settings of the links between two aircraft of a scenario, with its seed.

    The leader, which receives nothing in a run, receives what the network has for all.

    Args:
        scenario: whose section `network` is used.
        between: names of the aircraft at the first and the second end.
        frames: a packet is a frame, in order; else a datagram.
        radio: the ends get RADIO_STATUS.

    Raises:
        InputError: there is no such aircraft, or it is at both ends.
    """
    names = scenario.aircraft_names
    for name in between:
        if name not in names:
            raise InputError(
                f"--between {name}: no aircraft of {scenario.name} has this name"
                f"{did_you_mean(name, names)} (write two of {', '.join(names)})"
            )
    if between[0] == between[1]:
        raise InputError(f"--between {between[0]} {between[1]}: write two different aircraft")
    if radio:
        for sender, receiver in (between, between[::-1]):
            rate = scenario.network.link(sender, receiver).rate
            if rate is None or not rate.bit_per_s:
                raise InputError(
                    "--radio sik: tells how full the queue of network.rate is, and there is no "
                    f"rate from {sender} to {receiver}; write --set network.rate.bit_per_s=57600, "
                    "or leave it out"
                )
        if not frames:
            raise InputError("--radio sik: sends frames, not datagrams; write --unit frames")
    network = _ordered(scenario.network, names)
    return LinkSettings(between, network, scenario.scenario.seed, frames, radio)


def _ordered(network: Network, names: Sequence[str]) -> Network:
    """Return a network whose TDMA has the order of all names, as each direction has two of them."""
    tdma = network.tdma
    if tdma is None or tdma.order is not None:
        return network
    return with_changes(network, tdma=with_changes(tdma, order=tuple(names)))
