"""Keep machine code of entries in kept files, in place of numba's own cache.

numba's cache reads pickles of any owner, raises where one is damaged, and has an index per function
that can be damaged, too. Here each entry and signature has a file of its own with a checksum.
"""

from __future__ import annotations

import hashlib
import pickle
import re
import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import llvmlite
import numba
from llvmlite import binding
from numba.core import bytecode, compiler, serialize
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime.nrt import rtsys

from testbed.core.kept_files import KeptFiles

SUFFIX = ".code"
_VERSIONS = numba.__version__, llvmlite.__version__, sys.implementation.cache_tag
_CompileResult: Any = compiler.CompileResult
_Library: Any = JITCodeLibrary
_parse_bitcode: Any = binding.parse_bitcode
_dumps: Any = serialize.dumps
_OTHER = re.compile(r"[^\w.]")  # characters, such as those of <locals>
_LETTERS = 80  # of the name of an entry in that of its file
# A symbol has the number that numba gives to its function. numba counts from 1 in each process: the
# machine code that two processes keep could have one symbol for two functions, such as the steps of
# two laws, and where a third process loads both, calls of the second would run the first.
_Identity: Any = bytecode.FunctionIdentity
_Identity._unique_ids = iter(partial(secrets.randbits, 64), None)


class _LoadedLibrary(_Library):  # type: ignore[misc]
    """Machine code of a kept file.

    Its bitcode, which only a function needs that is compiled and calls it, is parsed then: that of
    a flight would take 0.1 s.
    """

    def __init__(
        self,
        codegen: Any,  # noqa: ANN401 - numba's
        name: str,
        machine_code: bytes,
        bitcode: bytes,
        symbols: list[str],
    ) -> None:
        super().__init__(codegen, name)
        self._shared_module: Any
        self._bitcode = bitcode
        self.enable_object_caching()
        self._set_compiled_object(machine_code)
        self._finalize_final_module()
        codegen._engine._defined_symbols.update(symbols)

    def _get_module_for_linking(self) -> Any:  # noqa: ANN401 - numba's
        if self._shared_module is None:
            self._shared_module = _parse_bitcode(self._bitcode)
        return self._shared_module


class KeptCode(_Cache):
    """The machine code of an entry, or of a function that is called by its address."""

    def __init__(self, function: Callable[..., Any], kept: KeptFiles, *, by_name: bool) -> None:
        """Read and write kept files; nothing is read yet.

        Args:
            function: of Python.
            kept: where the machine code is.
            by_name: the name of the function changes with its code, and alone tells which it is:
                functions that it calls may be new objects in each process.
        """
        self._function, self._kept, self._by_name = function, kept, by_name

    @property
    def cache_path(self) -> str:
        """Folder to which machine code is written; empty: none."""
        return str(self._kept.folder or "")

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401 - numba's
        """Return what was compiled for a signature, or None.

        numba's own method first imports all types and operations that it can compile, which loading
        does not need: 0.3 s, a fifth of the start of a run.
        """
        rtsys.initialize(target_context)
        content = self._kept.read(self._file_name(sig, target_context.codegen()))
        if content is None:
            return None
        with suppress(Exception):  # whatever numba raises: it is compiled anew
            found = _load(target_context, *pickle.loads(content))
            if tuple(found.signature.args) == tuple(getattr(sig, "args", sig)):
                return found
        return None

    def save_overload(self, sig: Any, data: Any) -> None:  # noqa: ANN401 - numba's
        """Keep what was compiled for a signature, where it can be kept."""
        if self._kept.folder is None or data.library.has_dynamic_globals or data.lifted:
            return
        module = data.library._get_module_for_linking()
        named = (*module.functions, *module.global_variables)
        symbols = [each.name for each in named if not each.is_declaration]
        self._kept.write(self._file_name(sig, data.codegen), _dumps((symbols, data._reduce())))

    def enable(self) -> None:
        """Do nothing; numba's other caches can be disabled."""

    def disable(self) -> None:
        """Do nothing."""

    def flush(self) -> None:
        """Do nothing: files of other code have other names."""

    def _file_name(self, signature: Any, codegen: Any) -> str:  # noqa: ANN401 - numba's
        function, code = self._function, self._function.__code__
        name = f"{function.__module__}.{function.__qualname__}"
        of: tuple[Any, ...] = (_VERSIONS, name, repr(signature), codegen.magic_tuple())
        if not self._by_name:
            cells = tuple(each.cell_contents for each in function.__closure__ or ())
            of = (*of, code.co_filename, code.co_code, _dumps(cells) if cells else b"")
        digest = hashlib.sha256(repr(of).encode()).hexdigest()[:32]
        return f"{_OTHER.sub('', name)[-_LETTERS:]}-{digest}{SUFFIX}"


def _load(context: Any, symbols: list[str], reduced: tuple[Any, ...]) -> Any:  # noqa: ANN401 - numba's
    """Return a result of compiling from what numba reduces it to, as numba does.

    Args:
        context: numba's, of the processor.
        symbols: that the machine code defines.
        reduced: parts of the result.
    """
    library, description, environment, signature, by_object, lifted, text, again, others = reduced
    for each in again:
        each()
    name, _, (machine_code, bitcode) = library
    codegen = context.codegen()
    loaded = _LoadedLibrary(codegen, name, machine_code, bitcode, symbols)
    result = _CompileResult(
        typing_context=context.typing_context,
        target_context=context,
        entry_point=context.get_executable(loaded, description, environment),
        typing_error=None,
        type_annotation=text,
        signature=signature,
        objectmode=by_object,
        lifted=lifted,
        fndesc=description,
        library=loaded,
        call_helper=None,
        environment=environment,
        metadata=None,
        reload_init=again,
        referenced_envs=others,
    )
    for each in others:
        codegen.set_env(each.env_name, each)
    return result
