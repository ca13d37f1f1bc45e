"""Save the state of objects in memory, and return to it.

The state is whatever can change in the objects that are reachable from the given ones: the numbers
of arrays, the elements of lists, sets and dictionaries, the attributes of objects, the places of
random generators. Returning writes these into the same objects again, so that addresses in compiled
code stay right. What has its state elsewhere, such as a program or a file, is refused by name.

A class may say that its objects are `CONSTANT`. It may name attributes in `UNSAVED`: these are no
state of a flight, or are made again where they are missing; and in `ADDRESSES`: these are right in
their own object only. It may have a method `unused_arrays`, of arrays that are written before they
are read.
"""

from __future__ import annotations

import copy
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
            if id(each) in seen or isinstance(each, _CONSTANT) or _is_constant(each):
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
        for array, kept in zip(self._arrays, self._copies, strict=True):
            array[:] = kept


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
    seen, waiting = set[int](), [(source, target, "")]
    while waiting:
        one, other, path = waiting.pop()
        if one is other or id(one) in seen or _is_constant(one):
            continue
        seen.add(id(one))
        if type(one) is not type(other):
            raise TypeError(f"{path}: is a {type(one)} here and a {type(other)} there")
        if isinstance(one, np.ndarray):
            assert isinstance(other, np.ndarray), "of one type"
            if other.flags.writeable:
                other[...] = one
            continue
        for name, (a, b), write in _parallel_parts((one, other)):
            if not isinstance(a, _CONSTANT):
                waiting.append((a, b, f"{path}{name}"))
            elif write is not None:
                write(a)
            elif _differ(a, b):
                raise TypeError(f"{path}{name}: {a!r} and {b!r} cannot be exchanged")


def take_changes(before: object, after: object, target: object) -> list[str]:
    """Write what has changed in an object into another one, which keeps all else.

    Numbers are compared one by one. So parameters, which do not change, stay those of the target.

    Args:
        before: a twin of `after` in the state that this had.
        after: an object in its present state.
        target: of a similar structure.

    Returns:
        Names of the parts that have changed and have no place in the target.
    """
    seen, left = set[int](), list[str]()
    waiting = [(before, after, target, "")]
    while waiting:
        old, new, mine, path = waiting.pop()
        if new is mine or id(new) in seen or _is_constant(new):
            continue
        seen.add(id(new))
        if isinstance(new, np.ndarray) and isinstance(old, np.ndarray):
            fits = _take_numbers(old, new, mine)
        else:
            kinds = {(type(each).__module__, type(each).__qualname__) for each in (old, new, mine)}
            fits = len(kinds) == 1 and _size(old) == _size(new) == _size(mine)
        if not fits and _has_changed(old, new):
            left.append(path)
        if not fits or isinstance(new, np.ndarray):
            continue
        for name, (a, b, c), write in _parallel_parts((old, new, mine)):
            constants = [isinstance(each, _CONSTANT) for each in (a, b, c)]
            if not any(constants):
                waiting.append((a, b, c, f"{path}{name}"))
            elif all(constants) and not _differ(a, b):
                continue
            elif write is None or not _is_data(b):
                left.append(f"{path}{name}")
            else:
                write(copy.deepcopy(b))
    return left


def _take_numbers(old: NDArray[Any], new: NDArray[Any], mine: object) -> bool:
    """Write the numbers of an array that have changed into another; return whether they fit."""
    if not (isinstance(mine, np.ndarray) and old.shape == new.shape == mine.shape):
        return False
    if not old.dtype == new.dtype == mine.dtype:
        return False
    if new.dtype.names:  # field by field: what is between them is no number
        for name in new.dtype.names:
            _take_numbers(old[name], new[name], mine[name])
        return True
    was, now = (
        np.ascontiguousarray(each).reshape(-1).view(np.uint8).reshape(-1, new.dtype.itemsize)
        for each in (old, new)
    )
    changed = (was != now).any(axis=1).reshape(new.shape)  # NaN equals NaN
    mine[changed] = new[changed]
    return True


def _has_changed(old: object, new: object) -> bool:
    """Return whether an object differs from a twin."""
    seen, waiting = set[int](), [(old, new)]
    while waiting:
        one, other = waiting.pop()
        if one is other or id(other) in seen or _is_constant(other):
            continue
        seen.add(id(other))
        if isinstance(one, _CONSTANT) or isinstance(other, _CONSTANT):
            if _differ(one, other):
                return True
        elif type(one) is not type(other) or _size(one) != _size(other):
            return True
        elif isinstance(one, np.ndarray):
            if one.tobytes() != np.asarray(other).tobytes():
                return True
        else:
            waiting += [(a, b) for _, (a, b), _ in _parallel_parts((one, other))]
    return False


def _size(value: object) -> object:
    """Return the size of a container, and the shape of an array; None of other objects."""
    if isinstance(value, np.ndarray):
        return value.shape
    return len(value) if isinstance(value, dict | list | deque | tuple) else None


def _is_data(value: object) -> bool:
    """Return whether something consists of numbers, texts and containers alone."""
    if isinstance(value, dict):
        return all(map(_is_data, value.values()))
    if isinstance(value, list | tuple | set | deque):
        return all(map(_is_data, value))
    return isinstance(value, (np.ndarray, *_CONSTANT))


def _differ(one: object, other: object) -> bool:
    """Return whether two values differ, of which one is a constant; NaN equals NaN."""
    same = one is other or (type(one) is type(other) and one == other)
    return not (same or (one != one and other != other))  # noqa: PLR0124


Part = tuple[str, tuple[Any, ...], "Callable[[object], object] | None"]


def _parallel_parts(objects: tuple[Any, ...]) -> Iterator[Part]:
    """Yield the parts of objects of one type: name, of each object, and what writes the last one's.

    Parts that not all of them have are left out.
    """
    one, last = objects[0], objects[-1]
    write: Callable[[object], object] | None
    if isinstance(one, types.FunctionType):
        cells = zip(*(each.__closure__ or () for each in objects), strict=True)
        for name, same in zip(one.__code__.co_freevars, cells, strict=True):
            contents = tuple(each.cell_contents for each in same)
            yield f".{name}", contents, partial(setattr, same[-1], "cell_contents")
    elif isinstance(one, types.MethodType):
        yield "", tuple(each.__self__ for each in objects), None
    elif type(one) is partial:
        for same in zip(*(each.args for each in objects), strict=True):
            yield "()", same, None
    elif isinstance(one, np.random.Generator):
        states = tuple(repr(each.bit_generator.state) for each in objects)
        state = objects[-2].bit_generator.state
        yield "", states, lambda _: setattr(last.bit_generator, "state", state)
    elif isinstance(one, dict):
        for key in [key for key in one if all(key in each for each in objects)]:
            write = partial(last.__setitem__, key)
            yield f"[{key!r}]", tuple(each[key] for each in objects), write
    elif isinstance(one, list | tuple | deque):
        for k, same in enumerate(zip(*objects, strict=True)):
            write = None if isinstance(one, tuple) else partial(last.__setitem__, k)
            yield f"[{k}]", same, write
    else:
        kind = type(one)
        names = {*getattr(one, "__dict__", ()), *_slots(kind, object)}
        names -= {*getattr(kind, "UNSAVED", ()), *getattr(kind, "ADDRESSES", ())}
        for name in sorted(name for name in names if all(hasattr(e, name) for e in objects)):
            write = None if _is_frozen(kind) else partial(object.__setattr__, last, name)
            yield f".{name}", tuple(getattr(each, name) for each in objects), write


def _is_constant(value: object) -> bool:
    """Return whether an object is compiled code, or says that it never changes."""
    return getattr(type(value), "CONSTANT", False) or is_compiled(value)


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
