"""daqp solves the program that was written, called from compiled code without a step through Python.

daqp's C function `daqp_quadprog(result, problem, settings)` reads and writes three structures, of which this file
knows two numbers: `ik.quadprog` has laid them out and given their addresses.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from workcell.control.laws import arithmetic, law
from workcell.control.laws.joint_limits import settle

NO_ANSWER, ANSWERED, NOT_ASKED = 0, 1, 2
"""The solver has found nothing that can be used; it has answered; its address is not known, ask its wrapper."""
CONSTRAINTS = 1
"""Which word of the problem says how many constraints there are (`DAQPProblem.m`)."""
EXIT_FLAG = 8
"""Which word of the result says how the solver ended (`DAQPResult.exitflag`)."""
SOLVED = (1, 2)
"""daqp's exit flags of an answer: optimal; optimal with a soft constraint missed."""


def _call_interpreted(function: int, result: int, problem: int, settings: int) -> None:
    """The C function at an address with three pointers."""
    kind = ctypes.CFUNCTYPE(None, *3 * (ctypes.c_void_p,))
    kind(int(function))(int(result), int(problem), int(settings))


@intrinsic
def _call_compiled(_context: Any, function: Any, result: Any, problem: Any, settings: Any) -> Any:
    """The same in machine code."""

    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer] * 3).as_pointer()
        at, *given = arguments
        builder.call(
            builder.inttoptr(at, kind), [builder.inttoptr(each, pointer) for each in given]
        )
        return _context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), build


_call: Any = _call_interpreted if arithmetic() == "interpreted" else _call_compiled


@law
def solve(addresses, problem, result, x, constraints, smallest, largest, tolerance, settled):
    """Solve the program in the arrays that `problem` points at.

    Args:
        addresses: (4,) of daqp's function, 0 if it is not known, of its result, problem and settings.
        problem, result: These structures as 32-bit words.
        x: (n,) written by daqp: its solution.
        constraints: How many the program has, the box on the unknowns included.
        smallest, largest, tolerance, settled: The solution within its box, written; see `joint_limits.settle`.

    Returns:
        `ANSWERED`, `NO_ANSWER` or `NOT_ASKED`.
    """
    if addresses[0] == 0:
        return NOT_ASKED
    problem[CONSTRAINTS] = constraints
    _call(addresses[0], addresses[1], addresses[2], addresses[3])
    if result[EXIT_FLAG] not in SOLVED:
        return NO_ANSWER
    total = 0.0
    for value in x:
        total += value
    if not math.isfinite(total):
        return NO_ANSWER
    settle(x, smallest, largest, tolerance, settled)
    return ANSWERED
