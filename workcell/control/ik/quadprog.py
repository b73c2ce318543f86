"""daqp's C function, called without its Python wrapper, which takes four times as long as the solution.

The function and its three structures are those of `daqp.h` in the version named here. Another version may have
other structures: its programs go through the wrapper `daqp.solve`, with the same answers.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

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


def _library() -> ctypes.CDLL | None:
    return ctypes.CDLL(daqp.__file__) if version("daqp") == KNOWN_VERSION else None


_LIBRARY = _library()


def bind(
    H: Array, c: Array, rows: Array, lower: Array, upper: Array, sense: NDArray[np.intc], tol: float
) -> Callable[[], tuple[Array, int]]:
    """What solves the program that stands in these arrays whenever it is called; see `qp.Program`.

    Args:
        H, c: (n, n), (n,).
        rows: (R, n).
        lower, upper, sense: (n + R,), the box on the unknowns first.
        tol: By how much a constraint may be missed.

    Returns:
        A function; it answers with (n,) the solution, good until its next call, and daqp's exit flag.
    """
    arrays = H, c, rows, upper, lower, sense
    if _LIBRARY is None or not all(map(_fits, arrays, 5 * (np.float64,) + (np.intc,))):

        def through_wrapper() -> tuple[Array, int]:
            x, _, flag, _ = daqp.solve(*arrays, primal_tol=tol)
            return x, flag

        return through_wrapper
    x, multipliers = np.zeros(len(c)), np.zeros(len(lower))
    at: list[Any] = [array.ctypes.data if array.size else None for array in arrays]
    problem = _Problem(len(c), len(lower), len(lower) - len(rows), *at, None, 0, 0)
    settings, result = _Settings(), _Result(x.ctypes.data, multipliers.ctypes.data)
    _LIBRARY.daqp_default_settings(ctypes.byref(settings))
    settings.primal_tol = tol
    solve = _LIBRARY.daqp_quadprog
    arguments = ctypes.byref(result), ctypes.byref(problem), ctypes.byref(settings)
    kept = arrays, multipliers

    def directly() -> tuple[Array, int]:
        assert kept  # the function holds on to what its structures point at
        solve(*arguments)
        return x, result.exitflag

    return directly


def _fits(array: NDArray[Any], kind: type) -> bool:
    """Whether C can read an array where it is."""
    return array.dtype == kind and array.flags.c_contiguous
