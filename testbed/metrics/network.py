"""What the radio did to messages, in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

JITTER_S = 1e-6  # delays nearer than this are the same
NOTHING = "–"
WORDS = {
    "lost": "lost",
    "faded": "out of reach",
    "corrupted": "corrupted",
    "queue": "before a full queue",
    "blackout": "in a blackout",
    "partition": "across a partition",
    "listed": "as listed",
}
OTHERS = {"overtaken": "overtaken", "duplicated": "twice"}


def describe(network: Mapping[str, Any] | None) -> list[str]:
    """What the radio did, in up to four lines; none if all came without delay.

    Args:
        network: of the metrics document; None: of a run in flight.
    """
    if network is None:
        return []
    together = network["all"]
    lines = []
    if together["lost"] or together["mute"]:
        share = percent(together["delivered_share"])
        worst = _worst(network["links"])
        lines.append(f"{share} of {together['sent']:,} delivered{worst}")
    counts = {WORDS[fate]: count for fate, count in together["lost"].items()}
    counts |= {words: together[key] for key, words in OTHERS.items()}
    lines.append(", ".join(f"{count:,} {what}" for what, count in counts.items() if count))
    if together["mute"]:
        lines.append(f"{together['mute']:,} not sent: sender mute or lost")
    how = []
    if together["bursts"]["longest"] > 1:
        bursts = together["bursts"]
        how.append(f"{bursts['mean']:.1f} lost in a row, {bursts['longest']:,} at most")
    delay = together["delay_s"]
    if delay and delay["p95"] > JITTER_S:
        how.append(f"{_ms(delay['p50'])} ms late")
        if delay["p95"] - delay["p50"] > JITTER_S:
            how[-1] += f", p95 {_ms(delay['p95'])}"
    lines.append("; ".join(how))
    return [line for line in lines if line]


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def percent(share: float | None) -> str:
    """A share of 0..1 as people read it; only all of it is 100 %, and only none of it 0 %."""
    if share is None:
        return NOTHING
    shown = f"{100.0 * share:.1f}"
    if shown == "100.0" and share < 1.0:
        return "> 99.9 %"
    return "< 0.1 %" if shown == "0.0" and share > 0.0 else f"{shown} %"


def _worst(links: Mapping[str, Mapping[str, Any]]) -> str:
    """The link that lost most, if there is another that lost less."""
    shares = {
        f"{sender} > {receiver}": link["delivered_share"]
        for sender, receivers in links.items()
        for receiver, link in receivers.items()
        if link["delivered_share"] is not None
    }
    if len(set(shares.values())) < 2:
        return ""
    worst = min(shares, key=lambda name: float(shares[name]))
    return f"; worst {worst} {percent(shares[worst])}"
