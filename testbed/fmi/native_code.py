"""Machine code of compiled functions alone: no Python, no numba, for any processor of LLVM.

numba compiles a function to native code with wrappers for Python around it. Here only the native
functions are kept, which call each other and the mathematical functions of C.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numba
from llvmlite import binding
from numba import types

from testbed.core.errors import InputError

_njit: Any = numba.njit
_binding: Any = binding
_pointer: Any = types.voidptr
# of numba's references to arrays, which blocks have none of
_NEVER_CALLED = "NRT_MemInfo_call_dtor"
_TRAP = """
define void @{name}(ptr %0) {{
  call void @llvm.trap()
  unreachable
}}
declare void @llvm.trap()
"""
# What libraries for mathematics have, which no build of C lacks.
MATHEMATICS = frozenset(
    "acos asin atan atan2 ceil cos cosh exp floor fmod hypot log log10 log1p pow sin sinh sqrt "
    "tan tanh trunc".split()
)


class NativeModule:
    """Functions of a pointer to a block that return a status, as code of LLVM.

    In C: `int32_t name(int64_t *status, void **exception, void *block)`; the result is 0.
    """

    def __init__(self, functions: Mapping[str, Callable[[Any], int]]) -> None:
        """Compile functions of Python.

        Args:
            functions: by their names in C.
        """
        _binding.initialize_all_targets()
        _binding.initialize_all_asmprinters()
        whole: Any = None
        names = {}
        for name, function in functions.items():
            options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
            compiled = _njit(error_model="numpy", **options)(function)
            compiled.compile((_pointer,))
            (result,) = compiled.overloads.values()
            module = _binding.parse_assembly(str(result.library._final_module))
            names[result.fndesc.mangled_name] = name
            if whole is None:
                whole = module
            else:
                whole.link_in(module)
        whole.link_in(_binding.parse_assembly(_TRAP.format(name=_NEVER_CALLED)))
        defined = (*whole.functions, *whole.global_variables)
        for k, each in enumerate(each for each in defined if not each.is_declaration):
            if each.name in names:
                each.name, each.linkage = names[each.name], "external"
                each.visibility = "hidden"  # of a library, which exports the standard's alone
            else:  # numba's names count what this process has compiled
                each.name, each.linkage = f"testbed_part_{k}", "internal"
        self.text = str(whole)

    def object_code(self, triple: str, processor: str = "") -> bytes:
        """Return an object file.

        Args:
            triple: of LLVM, such as `x86_64-unknown-linux-gnu`.
            processor: of LLVM; empty: any of the triple.

        Raises:
            InputError: the functions call what only this program has.
        """
        target = _binding.Target.from_triple(triple)
        machine = target.create_target_machine(cpu=processor, opt=3, reloc="pic", codemodel="small")
        module = _binding.parse_assembly(self.text)
        module.triple, module.data_layout = triple, str(machine.target_data)
        options = _binding.create_pipeline_tuning_options(speed_level=3)
        builder = _binding.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
        missing = {each.name for each in module.functions if each.is_declaration}
        unknown = {name for name in missing if not name.startswith("llvm.")} - MATHEMATICS
        if unknown:
            raise InputError(
                f"the compiled functions call {', '.join(sorted(unknown))}, which no library for "
                "mathematics has: there is no FMU of this aircraft"
            )
        code: bytes = machine.emit_object(module)
        return code
