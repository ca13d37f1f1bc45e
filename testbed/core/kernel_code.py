"""Kernels as numba's functions without machine code of their own.

numba emits machine code, a wrapper for Python and one for C for each function that it compiles. An
entry has the code of its kernels in its own machine code, so those of the kernels would never be
called: without them, and without optimising each kernel alone, a first flight compiles in three
quarters of the time.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import compiler, typed_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher

import testbed.core.machine_code  # noqa: F401 - which numbers functions before one is compiled

_Library: Any = JITCodeLibrary
_Lowering: Any = typed_passes.NativeLowering
_Compiler: Any = compiler.CompilerBase
_Dispatcher: Any = CPUDispatcher
_builder: Any = compiler.DefaultPassBuilder
_njit: Any = numba.njit
_register: Any = register_pass
_WITHOUT = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class _KernelLibrary(_Library):  # type: ignore[misc]
    """Code that is linked into that of callers, and is optimised and made machine code there."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@_register(mutates_CFG=True, analysis_only=False)
class _KernelLowering(_Lowering):  # type: ignore[misc]
    """Lowers a kernel into a library that callers link."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:  # noqa: ANN401 - numba's
        library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library, state.flags.no_compile = library, True
        super().run_pass(state)
        found = state.cr
        identity = object()  # by which callers find it, in place of the function for Python
        state.targetctx.insert_user_function(identity, found.fndesc, [library])
        state.reload_init.extend(library._reload_init)
        state.cr = found._replace(cfunc=identity)
        return True


class _KernelCompiler(_Compiler):  # type: ignore[misc]
    """numba's passes, with those of kernels in place of the last."""

    def define_pipelines(self) -> list[Any]:
        passes = _builder.define_nopython_pipeline(self.state)
        lowering = [each for each, _ in passes.passes].index(_Lowering)
        passes.passes[lowering] = _KernelLowering, "kernel lowering"
        passes.finalize()
        return [passes]


class Kernel(_Dispatcher):  # type: ignore[misc]
    """A function that kernels and entries call; Python's calls compile it once more."""

    def __init__(
        self,
        function: Any,  # noqa: ANN401
        local_types: dict[str, Any] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        """Compile nothing yet.

        Args:
            function: of Python.
            local_types: of its variables, by name, as numba takes them.
            options: numba's.
        """
        self._options = options or {}
        every = {"nopython": True, **self._options, **_WITHOUT}
        super().__init__(function, local_types, every, pipeline_class=_KernelCompiler)
        self._for_python: Any = None

    def add_overload(self, result: Any) -> None:  # noqa: ANN401 - numba's
        """Add what was compiled for a signature; numba would also let Python call it."""
        self.overloads[tuple(result.signature.args)] = result

    def __call__(self, *args: Any, **named: Any) -> Any:  # noqa: ANN401
        """Call it from Python."""
        if self._for_python is None:
            self._for_python = _njit(**self._options)(self.py_func)
        return self._for_python(*args, **named)
