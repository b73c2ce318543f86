"""The laws of a tick: each formula of docs/theory.md once, compiled by numba.

A law is a plain function of numbers and arrays, decorated with `law`. It is what a run executes and what a
user calls; tests hold each against a second opinion in NumPy. A law raises nothing: where it cannot
answer, it returns a code and the index of the pair or joint concerned, and its Python caller says
what is the matter. A law imports nothing but other laws, so that `cache_key` covers all it depends on.

Machine code is kept in a folder that is named by a hash of every file of laws, of the versions of
numba, llvmlite, NumPy and Python, and of the processor. A changed law is therefore compiled anew: code
from another text than the one on disk is never found. `workcell compile` fills the folder; otherwise
the first use of a law compiles it and says so in one line on standard error.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba.core import config, event

Law = Callable[..., Any]
"""numba knows the types of a law from its arguments; a type checker does not look into it."""

_HERE = Path(__file__).parent
_laws: dict[Any, str] = {}


def law(function: Law) -> Law:
    """Compile a function of numbers and arrays at its first call, or load it if it was compiled before.

    Division by zero gives infinity or NaN, as in NumPy. Numbers are added in the order written:
    nothing is reordered for speed. With `NUMBA_DISABLE_JIT=1` the function stays plain Python.
    """
    with _cached():
        compiled = numba.njit(cache=True, error_model="numpy")(function)
    _laws[compiled] = function.__name__
    return compiled


def part(function: Law) -> Law:
    """The same for a step of laws that is never called from Python: it is compiled into its callers."""
    return numba.njit(error_model="numpy")(function)


def arithmetic() -> str:
    """Which arithmetic this process uses, as traces and benchmarks name it."""
    if config.DISABLE_JIT:
        return "interpreted"
    return f"compiled by numba {numba.__version__}"


@functools.cache
def cache_key() -> str:
    """Hash of everything that the machine code of the laws depends on."""
    found = hashlib.sha256()
    for file in sorted(_HERE.glob("**/*.py")):
        found.update(f"{file.relative_to(_HERE)}\0".encode() + file.read_bytes())
    versions = numba.__version__, llvmlite.__version__, np.__version__, platform.python_version()
    host = llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features().flatten()
    found.update("\0".join([*versions, platform.platform(), *host]).encode())
    return found.hexdigest()[:16]


@functools.cache
def cache_folder() -> Path:
    """Where the machine code of these laws is: beside the package's byte code, else in the user's cache.

    Raises:
        OSError: Neither can be written.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "workcell"
    folders = [parent / f"laws-{cache_key()}" for parent in (_HERE / "__pycache__", home)]
    for folder in folders:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        return folder
    raise OSError(f"neither {folders[0]} nor {folders[1]} can be written; set XDG_CACHE_HOME")


@contextmanager
def _cached() -> Iterator[None]:
    """Let numba take `cache_folder` for what is decorated inside; its setting elsewhere stays as it is."""
    if config.DISABLE_JIT:
        yield
        return
    before, config.CACHE_DIR = config.CACHE_DIR, str(cache_folder())
    try:
        yield
    finally:
        config.CACHE_DIR = before


class _Progress(event.Listener):
    """Says in one line on standard error that laws are compiled; on a terminal it counts them there."""

    def __init__(self) -> None:
        self._count = 0

    def on_start(self, event: Any) -> None:
        name = _laws.get(event.data["dispatcher"])
        if name is None or parent_process() is not None:
            return
        self._count += 1
        message = "compiling the laws of a tick, once for this processor; takes about a minute"
        if sys.stderr.isatty():
            sys.stderr.write(f"\r\033[K{message}: {self._count} ({name})")
            sys.stderr.flush()
        elif self._count == 1:
            print(message, file=sys.stderr)

    def on_end(self, event: Any) -> None:
        """End the line, which the next law to be compiled writes anew."""
        if sys.stderr.isatty() and _laws.get(event.data["dispatcher"]) is not None:
            sys.stderr.write("\r\033[K")


class _Compilations(event.Listener):
    """Counts what numba compiles in this process, laws or not, with nested compilations."""

    def __init__(self) -> None:
        self.begun = self.under_way = 0

    def on_start(self, event: Any) -> None:
        self.begun += 1
        self.under_way += 1

    def on_end(self, event: Any) -> None:
        self.under_way -= 1


_compilations = _Compilations()
event.register("numba:compile", _Progress())
event.register("numba:compile", _compilations)


def compilations() -> tuple[int, bool]:
    """How many compilations this process has begun, and whether one of them is still under way.

    What is measured in time tells a slow answer from a first one with it.
    """
    return _compilations.begun, _compilations.under_way > 0
