"""From the text of a kernel's sweeps to functions in memory: LLVM's object code, kept on disk for the next process."""

import hashlib
import inspect
from collections.abc import Iterable
from functools import cache
from typing import Any

import llvmlite
from llvmlite import binding as llvm
from numba.core.registry import cpu_target

from hydro_env.ir import nodes, reader
from hydro_env.jit import collector_waits, keep, kept

from . import vector_ir
from .driver import SWEEPS


class MachineCode:
    """Functions in memory: `addresses` of those named. They are valid as long as this object lives."""

    def __init__(self, object_code: bytes, names: Iterable[str]) -> None:
        # An engine begins with a module; ours has nothing to compile.
        empty = llvm.parse_assembly(f'target triple = "{_target()[0]}"')
        self._engine = llvm.create_mcjit_compiler(empty, _machine(), use_lmm=True)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(object_code))
        self._engine.finalize_object()
        self.addresses = [self._engine.get_function_address(name) for name in names]


def machine_code(text: str, single: bool, sweeps: Iterable[str] = SWEEPS) -> MachineCode:
    """The sweeps of a text (see `vector_ir`) for cells of float32, if `single`, else of float64."""
    depends = (text, single, _target(), llvmlite.__version__, _translator())
    name = f"{hashlib.sha256(repr(depends).encode()).hexdigest()[:32]}.o"
    found = kept(name)
    if found is None:
        with collector_waits():
            found = _compiled(vector_ir.llvm_text(text, single, _register()))
        keep(name, found)
    return MachineCode(found, sweeps)


def _compiled(text: str) -> bytes:
    """Object code of a module of LLVM for this processor."""
    machine = _machine()
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = _target()[0], str(machine.target_data)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    object_code: bytes = machine.emit_object(module)
    return object_code


def _target() -> tuple[Any, ...]:
    """Triple, processor and its features, as Numba compiles for them."""
    return tuple(cpu_target.target_context.codegen().magic_tuple())


def _register() -> int:
    """Bytes of this processor's widest vector register."""
    features = _target()[2].split(",")
    return 64 if "+avx512f" in features else 32 if "+avx" in features else 16


def _machine() -> llvm.TargetMachine:
    triple, processor, features = _target()
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(
        cpu=processor, features=features, opt=2, reloc="pic", codemodel="small", jit=True
    )


@cache
def _translator() -> str:
    sources = [inspect.getsource(part) for part in (nodes, reader, vector_ir, _compiled, _register, _machine)]
    return hashlib.sha256("\0".join(sources).encode()).hexdigest()
