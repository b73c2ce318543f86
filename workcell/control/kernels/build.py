"""The functions of `source` -> machine code for this processor, in one file (`workcell compile`).

numba types and optimises each function with the arguments that `arguments` declares and gives LLVM's text for
it; LLVM turns all of it into one object file. What is written beside it, the stamp, says what it was made
from and the names under which the functions are found in it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from workcell.control.kernels import library, source
from workcell.control.kernels.arguments import SIGNATURES, Signature

_KINDS = {"f": types.float64, "i": types.int64, "m": types.intc, "b": types.boolean}


_BARE: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""numba's options for a function that is called by address, and by nothing of numba's."""


@intrinsic
def _pointer(_context, _address):
    """An address, kept as a number in the table, as a pointer."""

    def generate(context, builder, _signature, values):
        return builder.inttoptr(values[0], context.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


def compile_kernels() -> Path:
    """Compile all functions and write them where this installation looks for them.

    Returns:
        The file of machine code.

    Raises:
        OSError: Neither the package's own folder nor the user's cache can be written.
    """
    _start_llvm()
    whole = llvm.parse_assembly("")
    for function in source.ENTRIES:
        whole.link_in(_module(function, SIGNATURES[function.__name__]))
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
    )
    return _write(machine.emit_object(whole))


def _start_llvm() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def _module(function, signature: Signature) -> llvm.ModuleRef:
    """LLVM's module of one function behind an entry that takes a table."""
    entry = njit(types.void(types.CPointer(types.int64)), **_BARE)(_entry(function, signature))
    (text,) = entry.inspect_llvm().values()
    module = llvm.parse_assembly(text)
    name = entry.overloads[entry.signatures[0]].fndesc.llvm_func_name
    for other in module.functions:
        if other.name == name:
            other.name = library.PREFIX + function.__name__
        elif not other.is_declaration:
            other.linkage = "internal"  # so that what nobody calls is left out
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    machine = llvm.Target.from_default_triple().create_target_machine()
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    foreign = [
        other.name
        for other in module.functions
        if other.is_declaration
        and not other.name.startswith("llvm.")
        and other.name not in _OF_EVERY_PROCESS
    ]
    if foreign:
        raise RuntimeError(
            f"{function.__name__} calls {', '.join(foreign)}, which no run could find; it must neither allocate nor raise"
        )
    return module


_OF_EVERY_PROCESS = ("sqrt", "sin", "cos", "tan", "atan2")
"""The system's mathematics, found by every process that has loaded Python."""


def _entry(function, signature: Signature):
    """A function of the table alone: it takes sizes and arrays out and hands them on."""
    at = {size: k for k, size in enumerate(signature.sizes)}
    handed = [f"table[{k}]" for k in at.values()]
    names = {"_function": function, "carray": carray, "_pointer": _pointer}
    for k, array in enumerate(signature.arrays, start=len(at)):
        shape = "".join(f"{n if n.isdigit() else f'table[{at[n]}]'}, " for n in array.shape)
        names[f"_kind_{k}"] = _KINDS[array.kind]
        handed.append(f"carray(_pointer(table[{k}]), ({shape}), _kind_{k})")
    lines = ["def entry(address):", f" table = carray(address, ({len(handed)},))"]
    lines.append(f" _function({', '.join(handed)})")
    exec("\n".join(lines), names)
    return names["entry"]


def _write(code: bytes) -> Path:
    """Write into the first folder that can be written; whole files only, whatever else runs meanwhile."""
    failure: OSError | None = None
    for folder in library.folders():
        linked, plain = library.files(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            part = plain.with_suffix(f".{os.getpid()}")
            part.write_bytes(code)
            part.replace(plain)
        except OSError as error:
            failure = error
            continue
        return linked if _link(plain, linked) else plain
    raise failure or OSError("there is no folder to write to")


def _link(plain: Path, linked: Path) -> bool:
    """Make a shared library of the object file, if this system has what it takes."""
    linker = shutil.which("cc")
    if linker is None:
        return False
    part = linked.with_suffix(f".{os.getpid()}")
    command = [linker, "-shared", "-o", str(part), str(plain), "-lm"]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        part.unlink(missing_ok=True)
        return False
    part.replace(linked)
    return True
