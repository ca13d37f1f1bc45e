"""The command that looks at the radio of a scenario by itself: network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import Overrides, ScenarioName


def network(
    scenario: ScenarioName,
    packets: Annotated[int, typer.Option(metavar="N", help="Messages on every link.")] = 10_000,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Write what became of every message: source, destination, sequence, sent_s, "
            "received_s (empty if it did not arrive), fate, copies.",
        ),
    ] = None,
    overrides: Overrides = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random stream.")] = None,
    json: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the numbers here too; - is stdout."),
    ] = None,
) -> None:
    """Send messages over a scenario's network and show what becomes of them.

    Everyone broadcasts when it would in the flight, and nobody flies. All that
    the page says of the network acts as it does there, with the same dice for
    each message. Distances and airframes in the way are those of the start, in
    level flight. received_s is when the first copy arrived, copies how many did.

    fate is delivered; lost (by the loss model or a trace); faded (by distance or
    an airframe); corrupted (its checksum failed); queue (it was full); blackout;
    partition; listed (in a drop list); or mute (it was not even sent).
    """
    from testbed.network_console import send_and_show

    send_and_show(scenario, tuple(overrides or ()), packets=packets, seed=seed, out=out, json=json)
