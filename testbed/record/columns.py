"""What a log tells of frames: their arrays as columns of its topics."""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np

from testbed.record.messages import BELIEVED, ESTIMATE, NETWORK, TOPICS, Topic
from testbed.rows import Columns, Kept, Rows
from testbed.state import Frame

_BELIEFS = (ESTIMATE, BELIEVED)
_SEEN = attrgetter("truth", "air", "surfaces", "lost", "command", "formation", "links")
_BELIEVED = attrgetter("estimate", "formation")


def keep(room: int) -> Kept:
    """Room for so many frames."""

    def sources(beliefs: bool) -> list[str]:
        told = [topic for topic in TOPICS if (topic in _BELIEFS) == beliefs]
        return [column.source for topic in told for column in topic.columns]

    return Kept(
        rows=Rows(sources(False), _seen, _SEEN, room=room),
        beliefs=Rows(sources(True), _believed, _BELIEVED, room=room),
    )


def _seen(frame: Frame) -> tuple[Any, ...]:
    return (
        *frame.truth,
        *frame.air,
        *frame.surfaces,
        frame.lost,
        *frame.command,
        *frame.formation[:-1],  # all but what is believed
        *frame.links,
    )


def _believed(frame: Frame) -> tuple[Any, ...]:
    return (*frame.estimate, frame.formation.believed_ned)


def unpack(kept: Kept) -> tuple[Columns, list[Topic]]:
    """The columns of K frames, one at least, and the topics that tell what no other does."""
    columns = kept.rows.columns()
    # once a message is lost, no later count is as it was sent
    delivered = np.array_equal(columns["links.sent"], columns["links.delivered"])
    untold = [NETWORK, *_BELIEFS] if delivered else [*_BELIEFS]
    if kept.erring:
        beliefs = kept.beliefs.columns()
        for topic in _BELIEFS:
            for column in topic.columns:
                same = columns[column.unwritten or ""]
                columns[column.source] = values = same.copy()
                values[kept.erring] = beliefs[column.source]
                # by the bits, so that what is not a number equals itself
                if topic in untold and np.any(values.view(np.uint64) != same.view(np.uint64)):
                    untold.remove(topic)
    return columns, [topic for topic in TOPICS if topic not in untold]
