"""The file of a link between two programs: a `network` section, and what the programs send."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from testbed.core.ranges import ORIGIN_ELEVATION, ORIGIN_LATITUDE, ORIGIN_LONGITUDE
from testbed.scenario.fields import (
    Degrees,
    Finding,
    Name,
    Number,
    Section,
    raise_findings,
    within,
)
from testbed.scenario.load import override, parse_setting
from testbed.scenario.network import Network
from testbed.scenario.network_checks import Ends, check_links, link_entries
from testbed.scenario.problems import FilePosition
from testbed.scenario.references import resolve_references
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import Node, error_at, parse, read

FRAMES, DATAGRAMS, SIK = "frames", "datagrams", "sik"
# Keys of `network` about messages that a run makes itself.
_OF_A_RUN = ("message_bytes", "encoding", "receive", "broadcast", "clocks")


class Position(Section):
    """A place on the Earth (WGS 84)."""

    latitude_deg: Annotated[Degrees, within(ORIGIN_LATITUDE)] = Field(
        description="Latitude, degrees."
    )
    longitude_deg: Annotated[Degrees, within(ORIGIN_LONGITUDE)] = Field(
        description="Longitude, degrees."
    )
    height_m: Annotated[Number, within(ORIGIN_ELEVATION)] = Field(
        0.0, json_schema_extra={"unit": "m"}, description="Height above sea level, m."
    )


class LinkFile(Section):
    """A link between two programs, both ways."""

    ends: tuple[Name, Name] = Field(
        ("a", "b"),
        description="Names of the first and the second end; random numbers depend on them.",
    )
    unit: Literal["frames", "datagrams"] = Field(
        "datagrams",
        description="What is lost at once: MAVLink frames, as by a radio or a serial line, in "
        "order; or datagrams, as in a network of IP.",
    )
    radio: Literal["sik"] | None = Field(
        None,
        description="sik: both ends get RADIO_STATUS, as SiK radios send it, with the free share "
        "of the queue of rate.",
    )
    positions: Mapping[Name, Position] = Field(
        {}, description="By end, where it stays if it sends no position, as a ground station."
    )
    network: Network = Field(
        Network(), description="Delay, loss and all else, as in a scenario, by end."
    )

    @model_validator(mode="after")
    def _cross_check(self) -> Self:
        raise_findings(self._findings())
        return self

    def _findings(self) -> Iterator[Finding]:
        network, names = self.network, self.ends
        if names[0] == names[1]:
            yield ("ends", 1), "is the name of the first end, too (write two names)"
        for name in self.positions:
            if name not in names:
                yield (
                    ("positions", name),
                    f"no end has this name (the ends are {', '.join(names)})",
                )
        yield from check_links(
            network, Ends(names, names, "end", "the ends are", "end", "the ends are")
        )
        for key in _OF_A_RUN:
            if getattr(network, key) != Network.model_fields[key].default:
                yield (
                    ("network", key),
                    "has no effect here: it is about messages that a run makes, and these are of "
                    "other programs (leave this out)",
                )
        for at, link in link_entries(network):
            if self.unit == FRAMES and link.reorder is not None and link.reorder.probability:
                yield (
                    (*at, "reorder"),
                    "lets packets overtake, and frames stay in order, as on a radio or a serial "
                    "line (leave this out, or write unit: datagrams)",
                )
            if self.unit == DATAGRAMS and link.corrupt is not None and link.corrupt.bits > 1:
                yield (
                    (*at, "corrupt", "bits"),
                    "has no effect: a wrong datagram is dropped by its checksum (write "
                    "unit: frames, or leave this out)",
                )
        if self.radio is not None:
            yield from self._of_a_radio()

    def _of_a_radio(self) -> Iterator[Finding]:
        if self.unit != FRAMES:
            yield ("radio",), "sends frames, not datagrams (write unit: frames)"
        for sender, receiver in (self.ends, self.ends[::-1]):
            rate = self.network.link(sender, receiver).rate
            if rate is None or not rate.bit_per_s:
                yield (
                    ("radio",),
                    "tells how full the queue of network.rate is, and there is no rate from "
                    f"{sender} to {receiver} (write network.rate.bit_per_s, or leave radio out)",
                )
                return


def load_link_file(
    path: Path | None, settings: Sequence[str] = (), *, unit: str = DATAGRAMS
) -> LinkFile:
    """Read the file of a link, checked.

    Args:
        path: of the file; None: an empty one.
        settings: texts `key.path=value`, applied in order.
        unit: where neither file nor settings have one, and no radio, which sends frames.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    tree = parse("{}", "<link>", Path.cwd()) if path is None else read(path)
    if tree.value is None:
        tree = replace(tree, value={})
    if not isinstance(tree.value, dict):
        raise error_at(tree.place, "is no map of keys and values (write network: and its keys)")
    for text in settings:
        tree = override(tree, parse_setting(text))
    assert isinstance(tree.value, dict)
    if "unit" not in tree.value:
        place, radio = FilePosition("the ends of the link"), tree.value.get("radio")
        unit = FRAMES if radio is not None and radio.value is not None else unit
        tree = replace(tree, value={**tree.value, "unit": Node(unit, place, place, tree.folder)})
    return resolve_references(validate(tree, LinkFile), tree)
