"""daqp's C function, called without its Python wrapper, which takes four times as long as the solution.

The function and its three structures are those of `daqp.h` in the version named here. Another version may have
other structures: its programs go through the wrapper `daqp.solve`, with the same answers.
"""

from __future__ import annotations

import ctypes
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KNOWN_VERSION = "0.11.0"
"""Of daqp, whose structures these are."""
_int, _double, _pointer = ctypes.c_int, ctypes.c_double, ctypes.c_void_p


class _Problem(ctypes.Structure):
    """`DAQPProblem`: n unknowns, m constraints, the first ms of them simple bounds."""

    _fields_ = [
        *((name, _int) for name in ("n", "m", "ms")),
        *((name, _pointer) for name in ("H", "f", "A", "bupper", "blower", "sense")),
        *(("break_points", _pointer), ("nh", _int), ("problem_type", _int)),
    ]


class _Settings(ctypes.Structure):
    """`DAQPSettings`."""

    _fields_ = [
        *((f"{name}_tol", _double) for name in ("primal", "dual", "zero", "pivot", "progress")),
        *(("cycle_tol", _int), ("iter_limit", _int)),
        *((name, _double) for name in ("fval_bound", "eps_prox", "eta_prox", "rho_soft")),
        *((name, _double) for name in ("rel_subopt", "abs_subopt", "sing_tol", "refactor_tol")),
        *(("time_limit", _double), ("w_soft", _double), ("eq_reduction", _int), ("presolve", _int)),
    ]


class _Result(ctypes.Structure):
    """`DAQPResult`."""

    _fields_ = [
        *(("x", _pointer), ("lam", _pointer), ("fval", _double), ("soft_slack", _double)),
        *(("exitflag", _int), ("iter", _int), ("nodes", _int)),
        *(("solve_time", _double), ("setup_time", _double)),
    ]


class Solver(NamedTuple):
    """What `laws.quadprog.solve` is given of one kept program."""

    addresses: NDArray[np.int64]
    """(4,) of the function, the result, the problem and the settings; the first is 0 if daqp has another version."""
    problem: NDArray[np.int32]
    """The problem's structure as words."""
    result: NDArray[np.int32]
    """The result's."""
    x: Array
    """(n,) the solution."""


def solver(
    H: Array,
    c: Array,
    rows: Array,
    lower: Array,
    upper: Array,
    sense: NDArray[np.intc],
    tolerance: float,
) -> tuple[Solver, tuple[Any, ...]]:
    """A solver of programs that stand in these arrays, C-contiguous, which must outlive it.

    Args:
        H, c: (n, n), (n,).
        rows: (room, n).
        lower, upper, sense: (n + room,), the box on the unknowns first.
        tolerance: By how much a constraint may be missed.

    Returns:
        It, and what must be kept as long as it is used.
    """
    n = len(c)
    x, multipliers = np.zeros(n), np.zeros(len(lower))
    at = [array.ctypes.data for array in (H, c, rows, upper, lower, sense)]
    problem = _Problem(n, len(lower), n, *at, None, 0, 0)
    settings, result = _Settings(), _Result(x.ctypes.data, multipliers.ctypes.data)
    addresses = np.zeros(4, dtype=np.int64)
    library = _library()
    if library is not None:
        library.daqp_default_settings(ctypes.byref(settings))
        settings.primal_tol = tolerance
        function = ctypes.cast(library.daqp_quadprog, _pointer).value or 0
        addresses[:] = function, *map(ctypes.addressof, (result, problem, settings))
    kept = problem, result, settings, multipliers
    return Solver(addresses, _words(problem), _words(result), x), kept


def _words(structure: Any) -> NDArray[np.int32]:
    return np.frombuffer(structure, dtype=np.int32)


@cache
def _library() -> ctypes.CDLL | None:
    return ctypes.CDLL(daqp.__file__) if version("daqp") == KNOWN_VERSION else None
