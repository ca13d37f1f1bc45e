"""Import a co-simulation FMU of FMI 2.0: a second route to its library, by ctypes alone."""

import ctypes
import platform
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np

OK, DISCARD, ERROR = 0, 2, 3
_LOGGER = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)
MAC = platform.system() == "Darwin"
PLATFORM = {"x86_64": "linux64"}.get(platform.machine(), f"{platform.machine()}-linux")
PLATFORM, SUFFIX = ("darwin64", "dylib") if MAC else (PLATFORM, "so")


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOGGER),
        ("allocate", ctypes.c_void_p),
        ("free", ctypes.c_void_p),
        ("step_finished", ctypes.c_void_p),
        ("environment", ctypes.c_void_p),
    )


class Archive:
    """An FMU that is unpacked into a folder, and its library."""

    def __init__(self, data, folder):
        path = folder / "it.fmu"
        path.write_bytes(data)
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        self.folder = folder
        self.root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self.guid = self.root.get("guid")
        name = self.root.find("CoSimulation").get("modelIdentifier")
        self.path = folder / "binaries" / PLATFORM / f"{name}.{SUFFIX}"
        self.library = ctypes.CDLL(str(self.path))
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        rows = self.root.findall("ModelVariables/ScalarVariable")
        self.reals = {
            each.get("name"): int(each.get("valueReference"))
            for each in rows
            if each.find("Real") is not None
        }
        self.causality = {each.get("name"): each.get("causality") for each in rows}

    def outputs(self):
        return [name for name in self.reals if self.causality[name] == "output"]


class Instance:
    """One instance; a status other than `expected` is an error, with what was logged."""

    def __init__(self, archive, guid=None, **start):
        self.archive, self.messages, self.time = archive, [], 0.0
        log = _LOGGER(lambda _, __, status, ___, text: self.messages.append(text.decode()))
        self._callbacks = _Callbacks(log)  # the library keeps its address
        identity = (guid or archive.guid).encode()
        callbacks = ctypes.byref(self._callbacks)
        self.component = archive.library.fmi2Instantiate(b"a", 1, identity, b"", callbacks, 0, 0)
        if self.component is None:
            return
        self._setup()
        self.set(**start)

    def _setup(self):
        self.call("SetupExperiment", 0, ctypes.c_double(), ctypes.c_double(), 0, ctypes.c_double())
        self.call("EnterInitializationMode")

    def call(self, name, *arguments, expected=OK):
        function = getattr(self.archive.library, f"fmi2{name}")
        status = function(ctypes.c_void_p(self.component), *arguments)
        assert status == expected, (name, status, self.messages)
        return status

    def begin(self, expected=OK):
        self.call("ExitInitializationMode", expected=expected)
        return self

    def reset(self):
        self.call("Reset")
        self.time = 0.0
        self._setup()

    def _references(self, names):
        numbers = [self.archive.reals[name] for name in names]
        return (ctypes.c_uint * len(numbers))(*numbers), len(numbers)

    def set(self, names=(), values=(), expected=OK, **named):
        """By names and values, or by names as keywords with _ for dots."""
        names = [*names, *(each.replace("__", ".") for each in named)]
        values = np.array([*values, *named.values()], dtype=float)
        references, count = self._references(names)
        if count:
            self.call("SetReal", references, count, values.ctypes, expected=expected)

    def get(self, names, expected=OK):
        references, count = self._references(names)
        values = np.empty(count)
        self.call("GetReal", references, count, values.ctypes, expected=expected)
        return values

    def ended(self):
        value, reference = ctypes.c_int(), (ctypes.c_uint * 1)(0)
        self.call("GetInteger", reference, 1, ctypes.byref(value))
        return value.value

    def step(self, step=0.02, expected=OK, now=None):
        begin = ctypes.c_double(self.time if now is None else now)
        self.call("DoStep", begin, ctypes.c_double(step), 1, expected=expected)
        if expected == OK:
            self.time += step

    def terminated(self):
        value, time = ctypes.c_int(), ctypes.c_double()
        self.call("GetBooleanStatus", 3, ctypes.byref(value))
        self.call("GetRealStatus", 2, ctypes.byref(time))
        return bool(value.value), time.value

    def save(self):
        state = ctypes.c_void_p()
        self.call("GetFMUstate", ctypes.byref(state))
        return state, self.time

    def restore(self, saved):
        self.call("SetFMUstate", saved[0])
        self.time = saved[1]

    def serialize(self, saved):
        size = ctypes.c_size_t()
        self.call("SerializedFMUstateSize", saved[0], ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self.call("SerializeFMUstate", saved[0], data, size)
        return data.raw, saved[1]

    def deserialize(self, serial, expected=OK):
        state = ctypes.c_void_p()
        size = ctypes.c_size_t(len(serial[0]))
        self.call("DeSerializeFMUstate", serial[0], size, ctypes.byref(state), expected=expected)
        return state, serial[1]

    def free(self):
        self.archive.library.fmi2FreeInstance(ctypes.c_void_p(self.component))
