"""What `testbed network` prints and writes: the radio of a scenario by itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.errors import InputError
from testbed.metrics.document import replacing
from testbed.metrics.network_table import arrival_table, link_table, worst_links
from testbed.network.links import Fate
from testbed.network.report import LOSSES, word
from testbed.outputs import is_stdout, put_json, refuse_files
from testbed.progress import counting
from testbed.scenario import Scenario, load
from testbed.sim.sounding import Heard, sound
from testbed.sim.stop import stopping

MOST_PACKETS = 10_000_000
MOST_ROWS = 50_000_000  # of all links: half a gigabyte of memory, and several of CSV
ABREAST = 5  # counts that fit side by side in 80 columns
OTHERS = ("mute", "overtaken", "duplicated")
HEADER = "source,destination,sequence,sent_s,received_s,fate,copies\n"

Document = Mapping[str, Any]


def send_and_show(
    scenario: str,
    overrides: tuple[str, ...],
    *,
    packets: int,
    seed: int | None,
    out: Path | None,
    json: Path | None,
) -> None:
    """Send the messages, print what became of them, and write what was asked for."""
    refuse_files(out=out, json=json)
    if out and out.suffix.lower() != ".csv":
        raise InputError(f"--out {out}: write a name that ends in .csv")
    if out and json and out.absolute() == json.absolute():
        raise InputError(f"--json {json}: this is --out too; write another name")
    if not 1 <= packets <= MOST_PACKETS:
        raise InputError(f"--packets {packets}: write a number of 1 to {MOST_PACKETS:,}")
    if seed is not None:
        overrides = (*overrides, f"scenario.seed={seed}")
    page = load(scenario, overrides)
    _refuse_rows(page, packets)
    count = packets * len(page.aircraft_names)
    with stopping() as stop, counting("network", of=count, done=" sent") as show:
        sounding = sound(page, packets, keep=out is not None, tell=show, stop=stop)
        if stop():
            raise KeyboardInterrupt
    document = {
        "scenario": page.name,
        "seed": page.scenario.seed,
        "packets": packets,
        **sounding.summary,
    }
    if out and sounding.heard:
        _save(out, page.aircraft_names, sounding.heard)
    console = Console(stderr=is_stdout(json), highlight=False)
    _show(console, document)
    if out:
        console.print(f" messages  {out}", soft_wrap=True)
    put_json(json, document)


def _refuse_rows(page: Scenario, packets: int) -> None:
    listeners = len(page.aircraft_names) - 1
    links = listeners * listeners
    if not links:
        raise InputError(f"{page.name}: nobody listens to the leader (write a fleet)")
    if links * packets > MOST_ROWS:
        raise InputError(
            f"--packets {packets}: {links} links make {links * packets:,} rows of them; write at "
            f"most {MOST_ROWS // links:,}"
        )


def _save(path: Path, names: Sequence[str], heard: Heard) -> None:
    rows, written = len(heard.fate) * (len(names) - 1) ** 2, 0
    try:
        with replacing(path) as file, counting("network", of=rows, done=" written") as show:
            file.write(HEADER)
            for m, source in enumerate(names):
                sent = [f"{k},{time!r}" for k, time in enumerate(heard.sent_s[:, m].tolist())]
                for i, destination in enumerate(names[1:]):
                    if m != i + 1:
                        file.writelines(_rows(f"{source},{destination}", sent, heard, i, m))
                        written += len(sent)
                        show(written, rows)
    except OSError as error:
        raise InputError(f"--out {path}: cannot write it: {error.strerror}") from error


def _rows(link: str, sent: Sequence[str], heard: Heard, i: int, m: int) -> Iterator[str]:
    """The rows of one link, numbers in as many digits as read back to the same."""
    received = heard.received_s[:, i, m]
    ends = [[f"{word(fate)},{copies}\n" for copies in range(3)] for fate in Fate]
    for told, time, fate, copies in zip(
        sent,
        received.tolist(),
        heard.fate[:, i, m].tolist(),
        heard.copies[:, i, m].tolist(),
        strict=True,
    ):
        # only what is not a number is not itself
        arrived = repr(time) if time == time else ""
        yield f"{link},{told},{arrived},{ends[fate][copies]}"


def _show(console: Console, document: Document) -> None:
    together = document["all"]
    console.print(
        Text.assemble(
            " ",
            (document["scenario"], "bold"),
            f" · {document['packets']:,} messages on each of {_count(document)} links"
            f" · seed {document['seed']}",
        )
    )
    listed = worst_links(document["links"])
    console.print()
    console.print(arrival_table(listed, together))
    happened = [key for key in (*map(word, LOSSES), *OTHERS) if _number(together, key)]
    for first in range(0, len(happened), ABREAST):
        console.print()
        console.print(_counts(listed, together, happened[first : first + ABREAST]))
    if len(listed) < _count(document):
        console.print(Text(f" (the worst of {_count(document)} links)", style="dim"))


def _count(document: Document) -> int:
    return sum(len(receivers) for receivers in document["links"].values())


def _counts(links: Mapping[str, Document], together: Document, keys: Sequence[str]) -> Table:
    """Why messages of each link did not arrive, and what else befell them."""

    def cells(link: Document) -> list[str]:
        return [f"{_number(link, key):,}" for key in keys]

    return link_table("link", keys, links, together, cells)


def _number(link: Document, key: str) -> int:
    """How many messages of a link had this fate, or were mute, overtaken or duplicated."""
    return int(link[key] if key in OTHERS else link["lost"].get(key, 0))
