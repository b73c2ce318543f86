"""Which arithmetic a process uses, and calling what was compiled.

`WORKCELL_KERNELS` says: `compiled` (an error where it cannot be), `numpy`, or nothing, which takes the
compiled functions where they are ready and says in one line how to get them where they are not. Nothing is
ever compiled by a run. Ready means that there is machine code made from this very source by these versions
for this processor, which its name tells.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.kernels.arguments import DONE, SIGNATURES, Signature
from workcell.errors import InputError

VARIABLE = "WORKCELL_KERNELS"
COMMAND = "workcell compile"

LINKED = ".so"
PREFIX = "workcell_"
"""Of the functions' names in machine code."""
KEPT_SHAPES = 64
"""Shapes for which a function keeps its arrays; a cell needs about one an arm."""
_DTYPES = {"f": np.float64, "i": np.int64, "m": np.intc, "b": np.bool_}


class Kernels:
    """The compiled functions of this process.

    Args:
        file: Of machine code: a shared library, or an object file, for which LLVM is loaded.
    """

    def __init__(self, file: Path):
        takes = (
            ctypes.c_void_p,
        ) * 3  # room for a result and for an error, both unused, and the table
        entry = ctypes.PYFUNCTYPE(ctypes.c_int, *takes)
        if file.suffix == LINKED:
            self._holder = ctypes.PyDLL(str(file))
            self._functions = {name: entry((PREFIX + name, self._holder)) for name in SIGNATURES}
        else:
            self._holder = _engine(file.read_bytes())
            self._functions = {
                name: entry(self._holder.get_function_address(PREFIX + name)) for name in SIGNATURES
            }

    def bind(self, function: str, sizes: Mapping[str, int], **given: NDArray[Any]) -> Bound:
        """A call of a function with fixed arrays; those that are not given are made, full of zeros."""
        return Bound(self, self._functions[function], SIGNATURES[function], sizes, given)


class Bound:
    """A compiled function with the arrays it reads and writes.

    Args:
        kernels: What holds the machine code, which must not go before this.
        function: It, as something to call.
        signature: What it takes.
        sizes: Every size by its name.
        given: Arrays of the caller's, which stay where they are; all others are made here.

    Raises:
        ValueError: An array that is given is not what the function takes.
    """

    def __init__(
        self,
        kernels: Kernels,
        function: Any,
        signature: Signature,
        sizes: Mapping[str, int],
        given: Mapping[str, NDArray[Any]],
    ):
        self._kernels = kernels
        self.arrays: dict[str, NDArray[Any]] = {}
        for array in signature.arrays:
            shape = tuple(int(n) if n.isdigit() else sizes[n] for n in array.shape)
            value = given.get(array.name)
            if value is None:
                value = np.zeros(shape, dtype=_DTYPES[array.kind])
            if (value.shape, value.dtype, value.flags.c_contiguous) != (
                shape,
                np.dtype(_DTYPES[array.kind]),
                True,
            ):
                raise ValueError(
                    f"{array.name} is {value.dtype} {value.shape}; must be {np.dtype(_DTYPES[array.kind])} {shape}, C-contiguous"
                )
            self.arrays[array.name] = value
        unknown = set(given) - set(self.arrays)
        if unknown:
            raise ValueError(f"there is no argument {', '.join(sorted(unknown))}")
        self._table = np.array(
            [sizes[name] for name in signature.sizes]
            + [array.ctypes.data for array in self.arrays.values()],
            dtype=np.int64,
        )
        self._spare = np.zeros(2, dtype=np.int64)
        spare = self._spare.ctypes.data
        self.run = functools.partial(function, spare, spare + 8, self._table.ctypes.data)
        """Runs it once; the outcome is in the arrays."""
        self.done = self.arrays["answer"].item
        """Tells `DONE` or `REFUSED` after a run."""
        self.setting = self.arrays.get("setting", self._spare)


class ArrayFunction(threading.local):
    """A compiled function of arrays that may lie anywhere and have any length: they are copied to it first.

    Each thread has arrays of its own, as a call is several steps.

    Args:
        function: Its name.
        inputs: Names of the arrays a call brings, in the order of the call; the rest stay zero.
        sizes: Those that no shape tells.
    """

    def __init__(self, function: str, *inputs: str, **sizes: int):
        self._function, self._inputs, self._sizes = function, inputs, sizes
        shapes = {array.name: array.shape for array in SIGNATURES[function].arrays}
        self._shapes = [shapes[name] for name in inputs]
        self._ready: dict[Any, tuple[Bound, list[NDArray[Any]]]] = {}

    def __call__(
        self, *values: ArrayLike, setting: float | tuple[float, ...] | None = None
    ) -> dict[str, NDArray[Any]] | None:
        """Run it.

        Args:
            values: The inputs.
            setting: What a function that has a `setting` finds in it.

        Returns:
            Its arrays, which the next call overwrites; None where NumPy is used, where an input is not an
            array of the shape meant, and where the function has refused.
        """
        found = kernels()
        if found is None:
            return None
        try:
            key = (found, *[value.shape for value in values])  # type: ignore[union-attr]
        except AttributeError:
            return None  # a number or a list: whatever it is meant to be, NumPy knows
        ready = self._ready.get(key)
        if ready is None:
            ready = self._bind(found, key[1:])
            if ready is None:
                return None
            self._ready[key] = ready
        bound, kept = ready
        for k, value in enumerate(values):
            kept[k][...] = value
        if setting is not None:
            bound.setting[:] = setting
        bound.run()
        return bound.arrays if bound.done() == DONE else None

    def _bind(
        self, found: Kernels, given: tuple[tuple[int, ...], ...]
    ) -> tuple[Bound, list[NDArray[Any]]] | None:
        sizes = dict(self._sizes)
        for shape, lengths in zip(self._shapes, given, strict=True):
            if len(shape) != len(lengths):
                return None
            for name, length in zip(shape, lengths, strict=True):
                if sizes.setdefault(name, length) != length:
                    return None
        if not all(length for lengths in given for length in lengths):
            return None  # nothing to compute with
        if len(self._ready) >= KEPT_SHAPES:
            self._ready.clear()
        bound = found.bind(self._function, sizes)
        return bound, [bound.arrays[name] for name in self._inputs]


def kernels() -> Kernels | None:
    """The compiled functions, or None where NumPy is used; decided at the first call.

    Raises:
        InputError: The environment asks for what is not there.
    """
    global _chosen
    if _chosen is _UNDECIDED:
        _chosen = _choose(os.environ.get(VARIABLE, ""))
    return _chosen  # type: ignore[return-value]


def in_use() -> str:
    """`numpy`, or `compiled` and by what, as it is written into traces and shown by benchmarks."""
    return "numpy" if kernels() is None else f"compiled by numba {_version('numba')}"


@contextmanager
def forced(wish: str) -> Iterator[Kernels | None]:
    """Use one or the other, `compiled` or `numpy`, for what is called or built inside."""
    global _chosen
    before, _chosen = _chosen, _choose(wish)
    try:
        yield _chosen
    finally:
        _chosen = before


_UNDECIDED: Any = object()
_chosen: Any = _UNDECIDED


def _choose(wish: str) -> Kernels | None:
    if wish not in ("", "numpy", "compiled"):
        raise InputError([f"{VARIABLE} = {wish!r}: must be `numpy`, `compiled` or empty"])
    if wish == "numpy":
        return None
    loaded = _load()
    if loaded is None and wish == "compiled":
        raise InputError(
            [f"{VARIABLE} = 'compiled': nothing is compiled for this version; run `{COMMAND}` once"]
        )
    if loaded is None and parent_process() is None:
        print(f"ticks are slower than they could be: run `{COMMAND}` once", file=sys.stderr)
    return loaded


@functools.cache
def _load() -> Kernels | None:
    """The first machine code there is for this process; loaded once."""
    for file in (file for folder in folders() for file in files(folder)):
        if file.is_file():
            with suppress(
                OSError, ImportError
            ):  # not readable, or nothing there that could load it
                return Kernels(file)
    return None


def _engine(code: bytes) -> Any:
    """LLVM with an object file loaded into it; it takes a tenth of a second and a hundred megabytes."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(
        codemodel="jitdefault", jit=True
    )
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def files(folder: Path) -> tuple[Path, Path]:
    """Machine code for this process as a shared library and as an object file: there or not."""
    return folder / f"workcell_{key()}{LINKED}", folder / f"workcell_{key()}.o"


def folders() -> list[Path]:
    """Where compiled code is looked for and written: beside the package's byte code, else in the user's cache."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return [Path(__file__).parent / "__pycache__", Path(home) / "workcell"]


@functools.cache
def key() -> str:
    """What machine code must have been made from to be this process's: source, versions, processor."""
    here = Path(__file__).parent
    parts = [(here / name).read_bytes() for name in ("source.py", "arguments.py", "build.py")]
    parts += [f"{name} {_version(name)}".encode() for name in ("numba", "llvmlite", "numpy")]
    parts += [platform.python_version().encode(), platform.platform().encode(), _processor()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _processor() -> bytes:
    """Model and abilities of the processor, as far as the system tells without asking a compiler."""
    told = Path("/proc/cpuinfo")
    if told.is_file():
        lines = told.read_text(encoding="utf-8", errors="replace").splitlines()
        found = {line.split(":")[0].strip(): line for line in lines if ":" in line}
        return "\n".join(
            found[name] for name in ("model name", "flags", "Features", "CPU part") if name in found
        ).encode()
    return (platform.processor() + platform.machine()).encode()
