"""Save the state of objects in memory, and return to it.

The state is whatever can change in the objects that are reachable from the given ones: the numbers
of arrays, the elements of lists, sets and dictionaries, the attributes of objects, the places of
random generators. Returning writes these into the same objects again, so that addresses in compiled
code stay right. What has its state elsewhere, such as a program or a file, is refused by name.

A class may say that its objects are `CONSTANT`. It may name attributes in `UNSAVED`: these are no
state of a flight, or are made again where they are missing; in `ADDRESSES`: these are right in
their own object only; and in `ALIKE`: objects whose values of these differ are no counterparts of
each other. It may have a method `unused_arrays`, of arrays that are written before they are read,
and an attribute `why_not_saved`, a text that is not empty where its objects have state elsewhere.
"""

from __future__ import annotations

import copy
import enum
import functools
import math
import types
from collections import OrderedDict, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import PurePath
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import is_compiled
from testbed.core.errors import InputError, NotCopied

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


class SavedState(NotCopied):
    """The state of some objects at one moment.

    Args:
        roots: the objects, by names for errors.

    Raises:
        InputError: something reachable cannot be saved.
    """

    CONSTANT = True  # for another state, of a flight that holds this one

    def __init__(self, **roots: object) -> None:
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
        # writing bytes takes half the time of assigning to an array
        self._arrays = [_bytes_of(each).data for each in used]
        self._copies = [each.tobytes() for each in self._arrays]

    def _why_not_copied(self) -> str:
        """See `NotCopied`."""
        return (
            "a saved state cannot be copied or pickled: it belongs to the objects of its flight "
            "(restore it as often as you like, or make another flight)"
        )

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
        for name, (a, b), write in _parallel_parts((one, other), path):
            if not isinstance(a, (*_CONSTANT, frozenset)):
                waiting.append((a, b, f"{path}{name}"))
            elif write is not None:
                write(a)
            elif _differ(a, b):
                raise TypeError(f"{path}{name}: {a!r} and {b!r} cannot be exchanged")


def take_changes(
    before: Mapping[str, object], after: Mapping[str, object], target: Mapping[str, object]
) -> list[str]:
    """Write what has changed in objects into others, which keep all else.

    Numbers are compared one by one. So parameters, which do not change, stay those of the target.

    Args:
        before: by name, twins of `after` in the state that these had.
        after: objects in their present state.
        target: of a similar structure.

    Returns:
        Names of the parts that have changed and have no counterpart in the target.

    Raises:
        InputError: a part has changed that has a counterpart, into which it cannot be written; the
            text begins with its name.
    """
    # pairs: one object there may be several here, such as a part that is shared later on
    seen, left = set[tuple[int, int]](), list[str]()
    waiting = [(before[name], after[name], target[name], name) for name in reversed([*after])]
    while waiting:
        old, new, mine, path = waiting.pop()
        pair = id(new), id(mine)
        if new is mine or pair in seen or _is_constant(new):
            continue
        seen.add(pair)
        if not _are_alike(old, new, mine) or not _take_members(old, new, mine, path, left):
            if _has_changed(old, new, path):
                _leave(old, new, mine, path, left)
            continue
        if _is_taken_whole(old, new):
            continue
        for name, (a, b, c), write in _parallel_parts((old, new, mine), path):
            where = f"{path}{name}"
            values = [_is_value(each) for each in (a, b, c)]
            if not any(values):
                waiting.append((a, b, c, where))
            elif not _has_changed(a, b, where):
                if write is None and not all(values) and not _are_alike(a, c):
                    left.append(where)  # such as no law of one's own, and one
            elif write is None or not _is_copyable(b):
                _leave(a, b, c, where, left)
            else:
                write(_merged(a, b, c) if all(values) else copy.deepcopy(b))
    return left


def _is_taken_whole(old: Any, new: Any) -> bool:  # noqa: ANN401 - any object
    """Return whether `_take_members` has taken all of something."""
    if isinstance(new, np.ndarray):
        return not new.dtype.hasobject
    return isinstance(new, _UNORDERED) or (isinstance(new, list | deque) and len(old) != len(new))


def _leave(old: object, new: object, mine: object, path: str, left: list[str]) -> None:
    """List a changed part as one without a counterpart.

    Raises:
        InputError: it has one.
    """
    if _are_alike(old, mine) and not _has_changed(old, mine, path):
        raise InputError(f"{path.lstrip('.')}: has become a {_kind(new)}, which cannot be copied")
    left.append(path)


def _kind(value: object) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}"


def _are_alike(*objects: object) -> bool:
    """Return whether objects are of one kind and structure, so that their parts correspond."""
    first, *others = (_structure(each) for each in objects)
    return all(each == first for each in others)


def _structure(value: Any) -> tuple[object, ...]:  # noqa: ANN401 - any object
    """Return what is equal for objects whose parts correspond."""
    kind: type = type(value)
    found: tuple[object, ...]
    if isinstance(value, types.FunctionType):
        found = (value.__code__,)
    elif isinstance(value, types.MethodType):
        found = (getattr(value.__func__, "__code__", value.__name__),)
    elif kind is partial:
        found = len(value.args), *sorted(value.keywords)
    elif isinstance(value, np.random.Generator):
        found = (type(value.bit_generator),)
    elif isinstance(value, tuple):
        found = (len(value),)
    elif isinstance(value, np.ndarray) and value.dtype.hasobject:
        found = value.shape, value.dtype
    else:
        found = tuple(getattr(value, name) for name in getattr(kind, "ALIKE", ()))
    return kind.__module__, kind.__qualname__, found


def _take_members(old: Any, new: Any, mine: Any, path: str, left: list[str]) -> bool:  # noqa: ANN401
    """Let a container or an object have the members that have come, and lose those that have gone.

    Numbers of arrays and elements of sets are such members.

    Returns:
        Whether it could; false: nothing is written.

    Raises:
        InputError: see `take_changes`.
    """
    if isinstance(new, np.ndarray):
        return new.dtype.hasobject or _take_numbers(old, new, mine)
    if isinstance(new, list | deque):
        if len(old) == len(new) == len(mine):
            return True
        unlike = len(old) != len(mine) or _has_changed(old, mine, path)
        if len(old) == len(new) or unlike or not _is_copyable(list(new)):
            return False
        _refill(mine, copy.deepcopy(list(new)))
        return True
    if isinstance(new, _UNORDERED):
        if not (_is_data(old) and _is_data(new) and isinstance(mine, set)):
            return False
        mine |= new - old
        mine -= old - new
        return True
    was, now, own = (_members(each, path) for each in (old, new, mine))
    for name in now.keys() - was.keys():
        where = f"{path}{_member(new, name)}"
        if not _is_copyable(now[name]):
            _leave(None, now[name], own.get(name), where, left)
        else:
            _set_member(mine, name, copy.deepcopy(now[name]))
    for name in (was.keys() - now.keys()) & own.keys():
        _delete_member(mine, name)
    for name in (was.keys() & now.keys()) - own.keys():
        if _has_changed(was[name], now[name], path):
            left.append(f"{path}{_member(new, name)}")
    return True


def _members(value: Any, path: str) -> dict[Any, Any]:  # noqa: ANN401 - any object
    """Return the entries of a dictionary, or the attributes of an object that has some.

    Raises:
        InputError: its state is not in Python.
    """
    if isinstance(value, dict):
        return value
    if isinstance(value, _WITHOUT_ATTRIBUTES) or type(value) is partial:
        return {}
    kind = type(value)
    _require_saved(value)
    try:
        names = {*getattr(value, "__dict__", ()), *_slots(kind, object)}
    except TypeError as error:
        raise InputError(f"{path.lstrip('.')}: {error}") from error
    names -= _hidden(kind)
    return {name: getattr(value, name) for name in sorted(names) if hasattr(value, name)}


def _hidden(kind: type) -> frozenset[str]:
    """Return the names of attributes that are no state, or are right in their own object only."""
    if kind in _KNOWN_HIDDEN:
        return _KNOWN_HIDDEN[kind]
    found = {*getattr(kind, "UNSAVED", ()), *getattr(kind, "ADDRESSES", ())}
    for one in kind.__mro__:
        made = (n for n, each in vars(one).items() if isinstance(each, functools.cached_property))
        found.update(made)  # when it is first read
    _KNOWN_HIDDEN[kind] = frozenset(found)
    return _KNOWN_HIDDEN[kind]


_KNOWN_HIDDEN: dict[type, frozenset[str]] = {}


_UNORDERED = set, frozenset
_WITHOUT_ATTRIBUTES = (
    *(list, tuple, deque, set, frozenset, np.ndarray, np.random.Generator),
    *(types.FunctionType, types.MethodType),
)


def _member(value: object, name: object) -> str:
    return f"[{name!r}]" if isinstance(value, dict) else f".{name}"


def _set_member(target: Any, name: Any, value: object) -> None:  # noqa: ANN401
    if isinstance(target, dict):
        target[name] = value
    else:
        object.__setattr__(target, name, value)


def _delete_member(target: Any, name: Any) -> None:  # noqa: ANN401
    if isinstance(target, dict):
        del target[name]
    else:
        object.__delattr__(target, name)


def _is_copyable(value: object, seen: set[int] | None = None) -> bool:
    """Return whether a copy of something is as good as it is.

    These are data, generators of random numbers, and objects of a user's classes that consist of
    them. Objects of the testbed may refer to others of their flight.
    """
    seen = set() if seen is None else seen
    if id(value) in seen or isinstance(value, (*_CONSTANT, np.random.Generator)):
        return True
    seen.add(id(value))
    if isinstance(value, dict):
        parts = [*value.keys(), *value.values()]
    elif isinstance(value, list | tuple | set | frozenset | deque):
        parts = [*value]
    elif isinstance(value, np.ndarray):
        parts = [*value.flat] if value.dtype.hasobject else []
    elif _is_constant(value) or type(value).__module__.partition(".")[0] == "testbed":
        return _is_constant(value)
    else:
        try:
            parts = [*_members(value, "").values()]
        except InputError:
            return False
        if isinstance(value, _WITHOUT_ATTRIBUTES) or type(value) is partial:
            return False
    return all(_is_copyable(each, seen) for each in parts)


def _is_value(value: object) -> bool:
    """Return whether something never changes itself: it is replaced by another value."""
    if isinstance(value, tuple | frozenset):
        return all(map(_is_value, value))
    kind = type(value)
    compared = getattr(kind, "CONSTANT", False) and kind.__eq__ is not object.__eq__
    return compared or isinstance(value, _CONSTANT)


def _merged(old: Any, new: Any, mine: Any) -> Any:  # noqa: ANN401 - values
    """Return a value with what has changed, and else what it was."""
    tuples = all(isinstance(each, tuple) for each in (old, new, mine))
    if not tuples or not len(old) == len(new) == len(mine):
        return new if _differ(old, new) else mine
    parts = [_merged(*each) for each in zip(old, new, mine, strict=True)]
    make = getattr(type(mine), "_make", type(mine))
    return make(parts)


def _take_numbers(old: NDArray[Any], new: NDArray[Any], mine: object) -> bool:
    """Write the numbers of an array that have changed into another; return whether they fit."""
    if not (isinstance(mine, np.ndarray) and old.shape == new.shape == mine.shape):
        return False
    if not old.dtype == new.dtype == mine.dtype:
        return False
    if not mine.flags.writeable:  # a view; or what it has cannot change
        return _take_base(old, new, mine)
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


def _take_base(old: NDArray[Any], new: NDArray[Any], mine: NDArray[Any]) -> bool:
    """Take the numbers of the arrays that read-only ones are views of; see `_take_numbers`."""
    bases = old.base, new.base, mine.base
    if all(isinstance(each, np.ndarray) for each in bases):
        return _take_numbers(*bases)  # type: ignore[arg-type]
    return not _has_changed(old, new, "")


def _has_changed(old: object, new: object, path: str) -> bool:
    """Return whether an object differs from a twin.

    Raises:
        InputError: it has a part whose state is not in Python.
    """
    seen, waiting = set[int](), [(old, new, path)]
    while waiting:
        one, other, where = waiting.pop()
        if one is other or id(other) in seen:
            continue
        if _is_value(one) or _is_value(other):
            if _differ(one, other):
                return True
            continue
        if _is_constant(other):
            continue
        seen.add(id(other))
        if not _are_alike(one, other) or _size(one) != _size(other):
            return True
        if isinstance(one, np.ndarray) and not one.dtype.hasobject:
            if one.tobytes() != np.asarray(other).tobytes():
                return True
            continue
        if isinstance(one, set | frozenset):
            if not (_is_data(one) and _is_data(other)):
                raise InputError(f"{where.lstrip('.')}: is a set of objects, which have no order")
            if one != other:
                return True
            continue
        parts = _parallel_parts((one, other), where)
        waiting += [(a, b, f"{where}{name}") for name, (a, b), _ in parts]
    return False


def _size(value: Any) -> object:  # noqa: ANN401 - any object
    """Return what differs where members have come or gone."""
    if isinstance(value, np.ndarray):
        return value.shape, value.dtype
    if isinstance(value, list | deque | tuple | set | frozenset):
        return len(value)
    if isinstance(value, dict):
        return frozenset(value)
    return frozenset(getattr(value, "__dict__", ())) - _hidden(type(value))


def _is_data(value: object) -> bool:
    """Return whether something consists of numbers, texts and containers alone."""
    if isinstance(value, dict):
        return all(map(_is_data, value.values()))
    if isinstance(value, list | tuple | set | frozenset | deque):
        return all(map(_is_data, value))
    if isinstance(value, np.ndarray):
        return not value.dtype.hasobject
    return isinstance(value, _CONSTANT)


def _differ(one: object, other: object) -> bool:
    """Return whether two values differ; NaN equals NaN, and −0 differs from 0."""
    if one is other:
        return False
    if type(one) is not type(other):
        return True
    if isinstance(one, tuple) and isinstance(other, tuple):
        pairs = zip(one, other, strict=False)
        return len(one) != len(other) or any(_differ(a, b) for a, b in pairs)
    if isinstance(one, float) and isinstance(other, float):
        if math.isnan(one) or math.isnan(other):
            return not (math.isnan(one) and math.isnan(other))
        return one != other or math.copysign(1.0, one) != math.copysign(1.0, other)
    return bool(one != other)


Part = tuple[str, tuple[Any, ...], "Callable[[object], object] | None"]


def _parallel_parts(objects: tuple[Any, ...], path: str) -> Iterator[Part]:
    """Yield the parts of objects of one type: name, of each object, and what writes the last one's.

    Parts that not all of them have are left out.

    Args:
        objects: that are alike.
        path: of them, for errors.

    Raises:
        InputError: their state is not in Python.
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
        yield "", tuple(each.func for each in objects), None
        for same in zip(*(each.args for each in objects), strict=True):
            yield "()", same, None
        for name in one.keywords:
            yield f"({name})", tuple(each.keywords[name] for each in objects), None
    elif isinstance(one, np.random.Generator):
        states = tuple(repr(each.bit_generator.state) for each in objects)
        state = objects[-2].bit_generator.state
        yield "", states, lambda _: setattr(last.bit_generator, "state", state)
    elif isinstance(one, np.ndarray):
        for at in np.ndindex(one.shape):
            yield f"[{at}]", tuple(each[at] for each in objects), partial(last.__setitem__, at)
    elif isinstance(one, list | tuple | deque):
        for k, same in enumerate(zip(*objects, strict=True)):
            write = None if isinstance(one, tuple) else partial(last.__setitem__, k)
            yield f"[{k}]", same, write
    elif isinstance(one, set | frozenset):
        if not all(map(_is_data, objects)):
            raise InputError(f"{path.lstrip('.')}: is a set of objects, which have no order")
        write = None if isinstance(one, frozenset) else partial(_refill, last)
        yield "{}", tuple(frozenset(each) for each in objects), write
    else:
        members = [_members(each, path) for each in objects]
        for name in [name for name in members[0] if all(name in each for each in members)]:
            write = None if _is_frozen(type(one)) else partial(_set_member, last, name)
            yield _member(one, name), tuple(each[name] for each in members), write


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
    _require_saved(each)
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


def _require_saved(each: Any) -> None:  # noqa: ANN401 - any object
    """Refuse an object with a reason why it cannot be saved.

    Raises:
        InputError: it does.
    """
    if reason := getattr(type(each), "why_not_saved", "") and each.why_not_saved:
        raise InputError(reason)


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
    attributes.update(kept)
    if len(attributes) > len(kept):
        for name in (attributes.keys() - kept.keys()).difference(unsaved):
            del attributes[name]


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
