"""What a law of a user's gives besides its command: numbers for others, for the log, and events."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from testbed.core.records import AXES, Records

MAX_SENT = 31  # numbers of a message: as many as a frame of TUNNEL carries
_WORD = 8  # bytes of a number
_DECLARE = "write memory=[('integral', float, 3)]"
NED = "_ned"  # end of the names of vectors that are north, east, down


class Outputs:
    """Fields of a law's memory that are sent, logged, or whose changes are events.

    A class has it as its attribute `outputs`; `testbed.kernel` takes the same arguments. The memory
    of such a class is a structured array (n,) of the declared fields.

    Attributes:
        memory: dtype of one follower's memory; None: no fields are declared.
        sent: fields that each message has, for `Inbox.payload`, in this order.
        logged: fields of the log.
        events: texts of the values 0, 1, … of fields.
        fields: all of these, each once.
    """

    CONSTANT = True  # for a saved flight

    def __init__(
        self,
        memory: object = None,
        send: Sequence[str] = (),
        log: Sequence[str] = (),
        events: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Declare outputs.

        Args:
            memory: fields of the memory, as of a numpy dtype: `[("integral", float, 3)]`.
            send: names of fields of floats, which each message carries: 31 numbers at most.
            log: names of fields of floats or integers, which the log has in `law`.
            events: by the name of an integer, the texts of its values 0, 1, …: a change of it is
                an event of the follower with this text.

        Raises:
            ValueError: `memory` is no list of fields with numbers, or has no such field.
        """
        self.memory = None if memory is None else _memory_dtype(memory)
        events = {} if events is None else events
        for name, value in (("send", send), ("log", log)):
            if isinstance(value, str) or not all(isinstance(each, str) for each in value):
                raise ValueError(f"{name} is {value!r} (write a list of names of the memory)")
        if not isinstance(events, Mapping) or any(
            isinstance(texts, str) or not all(isinstance(each, str) for each in texts)
            for texts in events.values()
        ):
            raise ValueError(f"events is {events!r} (write {{'mode': ['searches', 'follows']}})")
        self.sent, self.logged = tuple(send), tuple(log)
        self.events = {name: tuple(texts) for name, texts in events.items()}
        self.fields = tuple(dict.fromkeys((*self.sent, *self.logged, *self.events)))
        for argument, names, kinds in (
            ("send", self.sent, "f"),
            ("log", self.logged, "fi"),
            ("events", tuple(self.events), "i"),
        ):
            for name in names:
                self._check(argument, name, kinds)
        if self.sent_numbers > MAX_SENT:
            raise ValueError(
                f"send has {self.sent_numbers} numbers (a message carries {MAX_SENT} at most)"
            )

    def _check(self, argument: str, name: str, kinds: str) -> None:
        known = () if self.memory is None else self.memory.names or ()
        if name not in known or self.memory is None:
            hint = f"it has {', '.join(known)}" if known else _DECLARE
            raise ValueError(f"{argument}: the memory has no field {name!r} ({hint})")
        field = self.memory[name]
        if field.base.kind not in kinds or field.base.itemsize != _WORD:
            types = " or ".join({"f": "float", "i": "int"}[each] for each in kinds)
            raise ValueError(f"{argument}: {name} is {field.base} (declare it as {types})")
        if argument == "events" and field.shape:
            raise ValueError(f"events: {name} is an array (declare one int)")

    @property
    def sent_numbers(self) -> int:
        """Numbers that each message carries."""
        return sum(self._size(name) for name in self.sent)

    @property
    def numbers(self) -> int:
        """Numbers of all fields."""
        return sum(self._size(name) for name in self.fields)

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Return the places (k,) of the numbers of some fields among those of all fields."""
        first, at = {}, 0
        for name in self.fields:
            first[name] = at
            at += self._size(name)
        found = [range(first[name], first[name] + self._size(name)) for name in names]
        return np.array([k for each in found for k in each], dtype=np.intp)

    def words(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the places of all numbers in a memory of 8-byte words, and whether it is a float.

        Returns:
            (F,) places and (F,) flags.
        """
        places, floats = [], []
        for name in self.fields:
            assert self.memory is not None and self.memory.fields is not None, "of fields"
            dtype, offset = self.memory.fields[name][:2]
            places += [offset // _WORD + k for k in range(self._size(name))]
            floats += [dtype.base.kind == "f"] * self._size(name)
        return np.array(places, dtype=np.intp), np.array(floats, dtype=bool)

    @property
    def logged_names(self) -> tuple[str, ...]:
        """Names of the logged numbers: of a vector `error_ned` they end with _north, _east, _down.

        Those of other arrays end with _0, _1, ….
        """
        return tuple(each for name in self.logged for each in self._number_names(name))

    def _number_names(self, name: str) -> tuple[str, ...]:
        size = self._size(name)
        if self.memory is None or not self.memory[name].shape:
            return (name,)
        if name.endswith(NED) and size == 3:
            return tuple(f"{name[: -len(NED)]}_{axis}" for axis in AXES)
        return tuple(f"{name}_{k}" for k in range(size))

    def _size(self, name: str) -> int:
        assert self.memory is not None, "of fields"
        return math.prod(self.memory[name].shape)

    def read(self, memory: object, n: int) -> np.ndarray:
        """Return the numbers (n, F) of all fields in the memory (n,) of a class.

        Raises:
            ValueError: it is no structured array (n,) of the declared fields.
        """
        values = np.zeros((n, self.numbers))
        if not (isinstance(memory, np.ndarray) and memory.shape == (n,)) or any(
            name not in (memory.dtype.names or ()) for name in self.fields
        ):
            raise ValueError(
                "the memory is not the structured array that `outputs` declares (start with "
                f"np.zeros({n}, outputs.memory))"
            )
        for name in self.fields:
            field = memory[name].reshape(n, -1)
            if field.shape[1] != self._size(name):
                raise ValueError(f"memory {name} has {field.shape[1]} numbers, not as declared")
            values[:, self.columns([name])] = field
        return values


NONE = Outputs()


def outputs_of(law: Any) -> Outputs:  # noqa: ANN401 - of any type
    """Return the outputs of a law; those of one that declares none are empty."""
    found = getattr(law, "outputs", None)
    return found if isinstance(found, Outputs) else NONE


def memory_words(memory: Records) -> np.ndarray:
    """View memories (n,) as words of 8 bytes (n, W)."""
    words: np.ndarray = memory.view(np.ndarray).view(np.uint64).reshape(len(memory), -1)
    return words


def _memory_dtype(value: Any) -> np.dtype[Any]:  # noqa: ANN401
    try:
        dtype: np.dtype[Any] = np.dtype(value, align=True)
    except (TypeError, ValueError):
        dtype = np.dtype(object)
    if not dtype.names or any(not _is_number(dtype[name].base) for name in dtype.names):
        raise ValueError(f"memory is no list of fields with numbers ({_DECLARE})")
    wrong = next((name for name in dtype.names if not name.isidentifier()), None)
    if wrong is not None:
        raise ValueError(f"memory: {wrong!r} is no name of a field (write letters, digits and _)")
    return dtype


def _is_number(dtype: np.dtype[Any]) -> bool:
    """Return whether a dtype is a number, or a record of numbers."""
    if dtype.names is None:
        return dtype.kind in "biuf"
    return all(_is_number(dtype[name].base) for name in dtype.names)
