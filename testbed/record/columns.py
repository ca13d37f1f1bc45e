"""What a log tells of frames: their arrays as columns of its topics."""

from __future__ import annotations

from typing import Any

from testbed.record.messages import BELIEVED, ESTIMATE, NETWORK, TOPICS, Topic
from testbed.rows import Columns, Rows
from testbed.state import Frame


def keep(room: int) -> Rows:
    """Room for so many frames."""
    return Rows([c.source for topic in TOPICS for c in topic.columns], _arrays, room=room)


def _arrays(frame: Frame) -> tuple[Any, ...]:
    """In the order of the topics."""
    return (
        *frame.truth,
        *frame.air,
        *frame.surfaces,
        frame.lost,
        *frame.estimate,
        *frame.command,
        *frame.formation,
        *frame.links,
    )


def unpack(kept: Rows) -> tuple[Columns, list[Topic]]:
    """The columns of K frames, one at least, and the topics that tell what no other does."""
    columns = kept.columns()

    def differ(one: str, other: str) -> bool:
        # by the bits, so that what is not a number equals itself
        return columns[one].tobytes() != columns[other].tobytes()

    told = [topic for topic in TOPICS if topic not in (ESTIMATE, BELIEVED, NETWORK)]
    if kept.erring:
        for topic in (ESTIMATE, BELIEVED):
            if any(differ(column.source, column.unwritten or "") for column in topic.columns):
                told.append(topic)
    # once a message is lost, no later count is as it was sent
    if differ("links.sent", "links.delivered"):
        told.append(NETWORK)
    return columns, sorted(told, key=TOPICS.index)
