"""Load the binary of an FMU, and make, initialise and reset its instances.

Source: FMI 2.0.4, sections 2.1 and 4.2, and FMI 3.0.1, sections 2.3 and 4.2.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.core.errors import InputError
from testbed.fmi.archive import DESCRIPTION, Archive
from testbed.fmi.model_description import ModelDescription, Variable

_POINTER, _WORD, _TEXT = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_char_p
_STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
_CO_SIMULATION = 1  # fmi2Type
_MAX_MESSAGE = 300
_LOG_2 = ctypes.CFUNCTYPE(None, _POINTER, _TEXT, ctypes.c_int, _TEXT, _TEXT)
_LOG_3 = ctypes.CFUNCTYPE(None, _POINTER, ctypes.c_int, _TEXT, _TEXT)


class _Callbacks(ctypes.Structure):
    """What an instance of FMI 2.0 calls."""

    _fields_ = (
        ("logger", _LOG_2),
        ("allocate", _POINTER),
        ("free", _POINTER),
        ("finished", _POINTER),
        ("environment", _POINTER),
    )


# types of values, in memory
_VALUES: Mapping[str, Any] = {
    "Boolean": ctypes.c_bool,
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "String": _TEXT,
    **{
        f"{sign}Int{bits}": getattr(ctypes, f"c_{sign.lower()}int{bits}")
        for sign in ("", "U")
        for bits in (8, 16, 32, 64)
    },
}
_NAMES_2 = {"Float64": "Real", "Int32": "Integer"}  # of functions, where they differ from types


@dataclass(frozen=True, slots=True)
class Value:
    """Values of a parameter."""

    variable: Variable
    values: tuple[Any, ...]


class FmuLibrary:
    """The loaded binary of an FMU."""

    CONSTANT = True  # for a saved flight

    def __init__(self, archive: Archive, model: ModelDescription, folder: Path) -> None:
        """Load the binary of this platform.

        Args:
            archive: checked.
            model: its description.
            folder: into which its binary was unpacked.

        Raises:
            InputError: it cannot be loaded.
        """
        self.model, self._archive, self._folder = model, archive, folder
        binary = archive.binary_name(model.version, model.identifier)
        try:
            self._library = ctypes.CDLL(str(self._folder / binary), os.RTLD_NOW | os.RTLD_LOCAL)
        except OSError as error:
            text = str(error).replace(f"{self._folder}/", "")
            raise InputError(
                f"{archive.path}: {binary} cannot be loaded: {text[:_MAX_MESSAGE]} (build it for "
                "this platform, with all libraries that it needs)"
            ) from error
        self._message = ""  # by its logger, last
        self._callbacks = self._make_callbacks()

    @property
    def digest(self) -> str:
        """SHA-256 of the FMU, in hexadecimal digits."""
        return self._archive.digest

    def address(self, function: str) -> int:
        """Return the address of a function, by its full name.

        Raises:
            InputError: the binary has none.
        """
        found = ctypes.cast(self._function(function), _POINTER).value
        assert found is not None, "a symbol"
        return found

    def _function(
        self,
        function: str,
        *types: Any,  # noqa: ANN401 - ctypes'
        returns: Any = ctypes.c_int,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        name = function if function.startswith("fmi") else f"fmi{self.model.version}{function}"
        try:
            symbol = getattr(self._library, name)
        except AttributeError:
            raise InputError(
                f"{self.model.file}: its binary has no {name} (link the file that defines it)"
            ) from None
        address = ctypes.cast(symbol, _POINTER).value or 0
        return ctypes.CFUNCTYPE(returns, *types)(address) if types else symbol

    def _call(self, function: str, *args: Any, what: str = "") -> None:  # noqa: ANN401 - ctypes'
        """Call a function whose arguments are ctypes' values.

        Raises:
            InputError: it has failed.
        """
        status = self._function(function, *map(type, args))(*args)
        if status not in (0, 1):
            of = f" of {what}" if what else ""
            raise InputError(
                f"{self.model.file}: fmi{self.model.version}{function}{of} returns "
                f"{self.describe_status(status)}{self.last_message}"
            )

    def describe_status(self, status: int) -> str:
        """Return the name of a status."""
        known = 0 <= status < len(_STATUS)
        return f"fmi{self.model.version}{_STATUS[status] if known else f'Status {status}'}"

    @property
    def last_message(self) -> str:
        """The last message of the FMU's logger, in brackets; "": there is none."""
        return f" (its message: {self._message})" if self._message else ""

    def instantiate(self, name: str, owner: object) -> int:
        """Make an instance, and return its address.

        Args:
            name: of it, for its messages.
            owner: with which the instance ends.

        Raises:
            InputError: none is made.
        """
        make = self._make_2 if self.model.version == 2 else self._make_3
        self._message = ""
        instance = make(name.encode())
        if not instance:
            kind = "guid" if self.model.version == 2 else "instantiationToken"
            raise InputError(
                f"{self.model.file}: makes no instance{self.last_message}; is {kind} in "
                f"{DESCRIPTION}, {self.model.token[:60]!r}, that of its binary?"
            )
        free = self._function("FreeInstance", _POINTER, returns=None)
        finalizer = weakref.finalize(owner, _free, free, instance, os.getpid())
        finalizer.atexit = False  # the process is at its end: nothing would be gained
        return int(instance)

    def _make_callbacks(self) -> Any:  # noqa: ANN401 - ctypes'
        """Return what instances call; its logger keeps the last message."""

        def log_2(_: object, __: object, status: int, ___: object, text: bytes | None) -> None:
            self._message = _plain(text)

        def log_3(_: object, status: int, __: object, text: bytes | None) -> None:
            self._message = _plain(text)

        if self.model.version == 3:
            return _LOG_3(log_3)
        libc = ctypes.CDLL(None)
        functions = (ctypes.cast(each, _POINTER) for each in (libc.calloc, libc.free))
        return _Callbacks(_LOG_2(log_2), *functions, None, None)

    def _make_2(self, name: bytes) -> int | None:
        make = self._function(
            "Instantiate",
            *(_TEXT, ctypes.c_int, _TEXT, _TEXT, _POINTER, ctypes.c_int, ctypes.c_int),
            returns=_POINTER,
        )
        resources = (self._folder / "resources").as_uri().encode()
        callbacks = ctypes.addressof(self._callbacks)
        token = self.model.token.encode()
        found: int | None = make(name, _CO_SIMULATION, token, resources, callbacks, 0, 0)
        return found

    def _make_3(self, name: bytes) -> int | None:
        flags = (ctypes.c_bool,) * 4
        make = self._function(
            "InstantiateCoSimulation",
            *(_TEXT, _TEXT, _TEXT, *flags, _POINTER, _WORD, _POINTER, _LOG_3, _POINTER),
            returns=_POINTER,
        )
        resources = f"{self._folder / 'resources'}{os.sep}".encode()
        texts, flagged = (name, self.model.token.encode(), resources), (False,) * 4
        found: int | None = make(*texts, *flagged, None, 0, None, self._callbacks, None)
        return found

    def initialise(self, instance: int, sizes: Mapping[str, int], values: Sequence[Value]) -> None:
        """Bring an instance that is new or reset to the begin of a flight at 0 s.

        Args:
            instance: its address.
            sizes: of structural parameters, by name.
            values: of parameters.

        Raises:
            InputError: a function has failed.
        """
        at, start, flag = _POINTER(instance), ctypes.c_double(0.0), ctypes.c_int(0)
        if sizes:
            self._call("EnterConfigurationMode", at)
            for name, size in sizes.items():
                self._set(at, Value(self.model.variables[name], (size,)))
            self._call("ExitConfigurationMode", at)
        for each in values:
            self._set(at, each)
        zero = ctypes.c_double(0.0)
        if self.model.version == 2:
            self._call("SetupExperiment", at, flag, zero, start, flag, zero)
            self._call("EnterInitializationMode", at)
        else:
            off = ctypes.c_bool(False)
            self._call("EnterInitializationMode", at, off, zero, start, off, zero)
        self._call("ExitInitializationMode", at)

    def reset(self, instance: int) -> None:
        """Return an instance to the state in which it was made.

        Raises:
            InputError: the function has failed.
        """
        self._call("Reset", _POINTER(instance))

    def _set(self, instance: Any, value: Value) -> None:  # noqa: ANN401 - ctypes'
        kind, count = value.variable.type, len(value.values)
        of: Any = _VALUES[kind]
        if kind == "Boolean" and self.model.version == 2:
            of = ctypes.c_int
        name = _NAMES_2.get(kind, kind) if self.model.version == 2 else kind
        texts = (each.encode() if isinstance(each, str) else each for each in value.values)
        given = (of * count)(*texts)
        refs = (ctypes.c_uint32 * 1)(value.variable.reference)
        sizes = () if self.model.version == 2 else (_WORD(count),)
        args = _address(refs), _WORD(1), _address(given), *sizes
        self._call(f"Set{name}", instance, *args, what=value.variable.name)

    def state(self, instance: int) -> bytes:
        """Return the state of an instance as bytes.

        Raises:
            InputError: a function has failed.
        """
        at, found, size = _POINTER(instance), (_POINTER * 1)(), (_WORD * 1)()
        kind = "FMUstate" if self.model.version == 2 else "FMUState"
        self._call(f"Get{kind}", at, _address(found))
        self._call(f"Serialized{kind}Size", at, _POINTER(found[0]), _address(size))
        data = ctypes.create_string_buffer(max(size[0], 1))
        self._call(f"Serialize{kind}", at, _POINTER(found[0]), _address(data), _WORD(size[0]))
        self._call(f"Free{kind}", at, _address(found))
        return data.raw[: size[0]]

    @property
    def size_function(self) -> str:
        """Full name of the function that returns the bytes of a state."""
        version = self.model.version
        return f"fmi{version}Serialized{'FMUstate' if version == 2 else 'FMUState'}Size"


def _address(array: Any) -> Any:  # noqa: ANN401 - ctypes'
    return _POINTER(ctypes.addressof(array))


def _plain(text: bytes | None) -> str:
    """Return a message in one line."""
    shown = (text or b"").decode("utf-8", "replace")
    return " ".join("".join(c if c.isprintable() else " " for c in shown).split())[:_MAX_MESSAGE]


def _free(free: Callable[[int], None], instance: int, process: int) -> None:
    if os.getpid() == process:
        free(instance)
