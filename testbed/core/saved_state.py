"""Save the state of objects in memory, and return to it.

The state is whatever can change in the objects that are reachable from the given ones: the numbers
of arrays, the elements of lists, sets and dictionaries, the attributes of objects, the places of
random generators. Returning writes these into the same objects again, so that addresses in compiled
code stay right. What has its state elsewhere, such as a program or a file, is refused by name.

A class may name attributes in `UNSAVED`: these are no state of a flight, or are made again where
they are missing. It may have a method `unused_arrays`, of arrays that are written before they are
read.
"""

from __future__ import annotations

import enum
import types
from collections import OrderedDict, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import PurePath
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import is_compiled
from testbed.core.errors import InputError

# Objects that never change, or that no flight changes.
_CONSTANT = (
    *(int, float, complex, str, bytes, type(None), range, slice, enum.Enum, PurePath),
    *(np.generic, np.dtype, type, types.ModuleType, types.BuiltinFunctionType),
    *(types.WrapperDescriptorType, property, types.GenericAlias, types.EllipsisType),
)
_CONTAINERS = defaultdict, OrderedDict, dict, list, deque, set, tuple, frozenset
_POINTER = np.dtype(np.intp).itemsize
T = TypeVar("T")
Back = Callable[[], None]  # writes a part of the state again


class SavedState:
    """The state of some objects at one moment.

    Args:
        roots: the objects, by names for errors.

    Raises:
        InputError: something reachable cannot be saved.
    """

    def __init__(self, **roots: object) -> None:
        """See the class."""
        seen, arrays = dict[int, object](), dict[int, NDArray[Any]]()
        unused, self._objects = set[int](), list[Back]()
        waiting = [(each, name) for name, each in reversed(roots.items())]
        while waiting:
            each, path = waiting.pop()
            if id(each) in seen or isinstance(each, _CONSTANT) or is_compiled(each):
                continue
            seen[id(each)] = each
            if isinstance(each, np.ndarray):
                if isinstance(each.base, np.ndarray):
                    waiting.append((each.base, path))
                elif each.dtype.hasobject:
                    self._objects.append(partial(np.copyto, each, each.copy()))
                    waiting += [(one, path) for one in each.flat]
                elif each.flags.writeable:
                    arrays[id(each)] = each
                continue
            back, parts = _take_apart(each, path)
            self._objects += back
            waiting += parts
            unused.update(id(_owner(one)) for one in getattr(each, "unused_arrays", tuple)())
        self._seen = seen  # which keeps ids and addresses
        used = [each for key, each in arrays.items() if key not in unused and each.size]
        self._arrays = [_bytes_of(each) for each in used]
        self._copies = [each.copy() for each in self._arrays]

    def restore(self) -> None:
        """Return all objects to this state."""
        for back in self._objects:
            back()
        for array, copy in zip(self._arrays, self._copies, strict=True):
            array[:] = copy


class Replayed(Iterator[T]):
    """An iterator that can return to an earlier element, as a part of a saved state.

    Args:
        make: makes an iterator from the first element on; the same elements each time.
    """

    UNSAVED = ("_source", "_at")

    def __init__(self, make: Callable[[], Iterator[T]]) -> None:
        """See the class."""
        self._make, self._taken = make, 0
        self._source, self._at = make(), 0

    def __next__(self) -> T:
        """Return the next element."""
        if self._at > self._taken:
            self._source, self._at = self._make(), 0
        found = next(islice(self._source, self._taken - self._at, None))
        self._taken += 1
        self._at = self._taken
        return found


def copy_state(source: object, target: object) -> None:
    """Write the numbers of one object into another of the same structure, at the same places.

    Args:
        source: an object, such as one that is made for another seed.
        target: made in the same way; what it has and the source has not stays.

    Raises:
        TypeError: their structures differ.
    """
    seen, waiting = set[int](), [(source, target)]
    while waiting:
        one, other = waiting.pop()
        if one is other or id(one) in seen or is_compiled(one):
            continue
        seen.add(id(one))
        if type(one) is not type(other):
            raise TypeError(f"{one!r} and {other!r} are of two kinds")
        if isinstance(one, np.ndarray):
            assert isinstance(other, np.ndarray), "of one type"
            if other.flags.writeable:
                other[...] = one
        elif isinstance(one, np.random.Generator):
            assert isinstance(other, np.random.Generator), "of one type"
            other.bit_generator.state = one.bit_generator.state
        else:
            waiting += _pair_parts(one, other)


def _pair_parts(one: Any, other: Any) -> Iterator[tuple[object, object]]:  # noqa: ANN401
    """Yield pairs of the parts of two objects; constants are written into the other.

    Raises:
        TypeError: they have other parts, or other constants where these cannot be written.
    """
    pairs = list[tuple[object, object, Any]]()
    if isinstance(one, types.FunctionType):
        cells = zip(one.__closure__ or (), other.__closure__ or (), strict=True)
        pairs += [
            (a.cell_contents, b.cell_contents, partial(setattr, b, "cell_contents"))
            for a, b in cells
        ]
    elif isinstance(one, types.MethodType):
        pairs.append((one.__self__, other.__self__, None))
    elif type(one) is partial:
        pairs += [(a, b, None) for a, b in zip(one.args, other.args, strict=True)]
    elif isinstance(one, dict):
        pairs += [(each, other[key], partial(other.__setitem__, key)) for key, each in one.items()]
    elif isinstance(one, list | deque):
        both = enumerate(zip(one, other, strict=True))
        pairs += [(a, b, partial(other.__setitem__, k)) for k, (a, b) in both]
    elif isinstance(one, tuple):
        pairs += [(a, b, None) for a, b in zip(one, other, strict=True)]
    else:
        names = {*getattr(one, "__dict__", ()), *_slots(type(one), object)}
        for name in names.difference(getattr(type(one), "UNSAVED", ())):
            frozen = _is_frozen(type(one))
            write = None if frozen else partial(object.__setattr__, other, name)
            pairs.append((getattr(one, name), getattr(other, name), write))
    for a, b, write in pairs:
        if not isinstance(a, _CONSTANT):
            yield a, b
        elif write is not None:
            write(a)
        elif a is not b and a != b:
            raise TypeError(f"{type(one).__qualname__}: {a!r} and {b!r} cannot be exchanged")


def _bytes_of(array: NDArray[Any]) -> NDArray[np.uint8]:
    """View an array that owns its numbers as bytes, in the order in memory."""
    ordered = array if array.flags.c_contiguous else array.T
    found: NDArray[np.uint8] = ordered.reshape(-1).view(np.uint8)
    assert np.shares_memory(found, array), "numbers have gaps in memory"
    return found


def _owner(array: NDArray[Any]) -> NDArray[Any]:
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _take_apart(each: Any, path: str) -> tuple[list[Back], list[tuple[object, str]]]:  # noqa: ANN401
    """Return what writes the state of an object that is no array, and its parts with their names.

    Raises:
        InputError: it is of a kind that is not known.
    """
    kind = type(each)
    if isinstance(each, types.FunctionType):
        return _take_function_apart(each, path)
    if isinstance(each, types.MethodType):
        return [], [(each.__self__, path)]
    if kind is partial:
        return [], [(one, path) for one in (each.func, *each.args, *each.keywords.values())]
    if isinstance(each, np.random.Generator):
        generator, state = each.bit_generator, each.bit_generator.state
        return [partial(setattr, generator, "state", state)], []
    back, parts = list[Back](), list[tuple[object, str]]()
    base = next((one for one in _CONTAINERS if one in kind.__mro__), object)
    if isinstance(each, dict):
        back.append(partial(_refill, each, dict(each)))
        for key, one in each.items():
            parts += [(key, path), (one, f"{path}[{key!r}]")]
    elif isinstance(each, list | set | deque):
        held = list(each)
        back.append(partial(_refill, each, held))
        parts += [(one, f"{path}[{k}]") for k, one in enumerate(held)]
    elif isinstance(each, tuple | frozenset):
        parts += [(one, f"{path}[{k}]") for k, one in enumerate(each)]
    try:
        slots = _slots(kind, base)
    except TypeError as error:
        raise InputError(f"{path} {error}: this flight cannot be saved") from error
    unsaved = getattr(kind, "UNSAVED", ())
    if hasattr(each, "__dict__"):
        attributes = vars(each)
        kept = {name: one for name, one in attributes.items() if name not in unsaved}
        if kept and not _is_frozen(kind):
            back.append(partial(_set_attributes, attributes, kept, unsaved))
        parts += [(one, f"{path}.{name}") for name, one in kept.items()]
    values = {
        name: getattr(each, name) for name in slots if name not in unsaved and hasattr(each, name)
    }
    if values and not _is_frozen(kind):
        back += [partial(object.__setattr__, each, name, one) for name, one in values.items()]
    parts += [(one, f"{path}.{name}") for name, one in values.items()]
    return back, parts


def _take_function_apart(
    each: types.FunctionType, path: str
) -> tuple[list[Back], list[tuple[object, str]]]:
    back, parts = list[Back](), list[tuple[object, str]]()
    for name, cell in zip(each.__code__.co_freevars, each.__closure__ or (), strict=True):
        back.append(partial(setattr, cell, "cell_contents", cell.cell_contents))
        parts.append((cell.cell_contents, f"{path}.{name}"))
    return back, parts + [(one, path) for one in each.__defaults__ or ()]


def _refill(container: Any, held: Any) -> None:  # noqa: ANN401 - a list, set, deque or dict
    container.clear()
    (container.extend if isinstance(container, list | deque) else container.update)(held)


def _set_attributes(
    attributes: dict[str, object], kept: dict[str, object], unsaved: Iterable[str]
) -> None:
    others = {name: attributes[name] for name in unsaved if name in attributes}
    attributes.clear()
    attributes.update(kept)
    attributes.update(others)


def _is_frozen(kind: type) -> bool:
    parameters = getattr(kind, "__dataclass_params__", None)
    return parameters is not None and bool(parameters.frozen)


def _slots(kind: type, base: type) -> tuple[str, ...]:
    """Return the slots of a class, as `_find_slots` does."""
    if (kind, base) not in _KNOWN_SLOTS:
        _KNOWN_SLOTS[kind, base] = _find_slots(kind, base)
    return _KNOWN_SLOTS[kind, base]


_KNOWN_SLOTS: dict[tuple[type, type], tuple[str, ...]] = {}


def _find_slots(kind: type, base: type) -> tuple[str, ...]:
    """Return the names of the slots of a class.

    Raises:
        TypeError: its objects hold something that Python does not show.
    """
    found = list[str]()
    for one in kind.__mro__:
        if one in base.__mro__:
            continue
        own = one.__dict__.get("__slots__", ())
        names = [own] if isinstance(own, str) else list(own)
        names = [name for name in names if name not in ("__dict__", "__weakref__")]
        size = max((each.__basicsize__ for each in one.__bases__), default=0)
        # its own slots, and a pointer each for attributes and weak references
        more = one.__basicsize__ - size - (len(names) + 2) * _POINTER
        if not one.__flags__ & _HEAP_TYPE or more > 0:
            name = f"{kind.__module__}.{kind.__qualname__}"
            raise TypeError(f"is a {name}, whose state is not in Python")
        for name in names:
            hidden = name.startswith("__") and not name.endswith("__")
            found.append(f"_{one.__name__.lstrip('_')}{name}" if hidden else name)
    return tuple(found)


_HEAP_TYPE = 1 << 9  # of classes that are made in Python, and of some others
