"""Copy the outputs of users' laws to messages and to the log, and find their events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.core.call_list import NOW, Call, Words
from testbed.core.compile import entry
from testbed.core.records import Array, BoolArray, Event, Indices, Records
from testbed.formation.law_outputs import Outputs, memory_words


class LawReports:
    """The outputs of the law of n followers, after its last step.

    Attributes:
        outputs: that the law declares.
        logged: (n, L) numbers for the log; NaN before the first step.
    """

    def __init__(self, names: Sequence[str], outputs: Outputs, sent: Array) -> None:
        """Begin before the first step.

        Args:
            names: of the n followers.
            outputs: that their law declares.
            sent: (N, K) numbers of the law in the next messages; written.
        """
        self.outputs, self._names = outputs, tuple(names)
        n, self._texts = len(names), list(outputs.events.values())
        self.logged = np.full((n, len(outputs.columns(outputs.logged))), np.nan)
        self._values, self._sent = np.zeros((n, outputs.numbers)), sent
        self._states = np.zeros((n, len(self._texts)))  # at the last look
        self._words = outputs.words()
        names_of = outputs.sent, outputs.logged, tuple(outputs.events)
        self._columns = tuple(map(outputs.columns, names_of))

    def copy_call(self, rows: Indices, memory: Records) -> Call:
        """Return the call that copies the outputs of a compiled law.

        Args:
            rows: (m,) of its followers.
            memory: (m,) of the law.
        """
        sent, logged, _ = self._columns
        values = self._values, sent, self._sent, logged, self.logged
        return Call(_copy_outputs, rows, memory_words(memory), *self._words, *values, NOW)

    def copy(self, rows: Indices, memory: object) -> None:
        """Copy the outputs of a law in Python.

        Args:
            rows: (m,) of its followers.
            memory: (m,) of the law.

        Raises:
            ValueError: it is not as declared.
        """
        self._values[rows] = self.outputs.read(memory, len(rows))
        sent, logged, _ = self._columns
        self._sent[rows + 1] = self._values[np.ix_(rows, sent)]
        self.logged[rows] = self._values[np.ix_(rows, logged)]

    def changed_call(self, rows: Indices) -> Call:
        """Return the call after which `changes` is needed where it returns true.

        Args:
            rows: (m,) of followers.
        """
        return Call(_has_changed, rows, self._values, self._columns[2], self._states, NOW)

    def changes(self, rows: Indices, now: float) -> Iterator[Event]:
        """Yield an event for each field of followers (m,) whose value has changed."""
        for i in rows.tolist():
            for k, (name, texts) in enumerate(self.outputs.events.items()):
                value = int(self._values[i, self._columns[2][k]])
                if value == self._states[i, k]:
                    continue
                self._states[i, k] = value
                text = texts[value] if 0 <= value < len(texts) else f"{name} is {value}"
                yield Event(now, "info", self._names[i], text)


@entry
def _copy_outputs(
    rows: Indices,
    words: Words,
    places: Indices,
    floats: BoolArray,
    values: Array,
    sent_columns: Indices,
    sent: Array,
    logged_columns: Indices,
    logged: Array,
    now: float,
) -> None:
    """Copy the outputs of followers (m,) from memories of words (m, W)."""
    numbers, integers = words.view(np.float64), words.view(np.int64)
    for k in range(len(rows)):
        i = rows[k]
        for f in range(len(places)):
            place = places[f]
            values[i, f] = numbers[k, place] if floats[f] else float(integers[k, place])
        for f in range(len(sent_columns)):
            sent[i + 1, f] = values[i, sent_columns[f]]
        for f in range(len(logged_columns)):
            logged[i, f] = values[i, logged_columns[f]]


@entry
def _has_changed(rows: Indices, values: Array, columns: Indices, states: Array, now: float) -> bool:
    for i in rows:
        for k in range(len(columns)):
            if values[i, columns[k]] != states[i, k]:
                return True
    return False
