"""The quadratic program of one arm and its solver, daqp."""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from workcell.control.finite import all_finite
from workcell.control.ik import quadprog
from workcell.control.laws import joint_limits
from workcell.control.laws import quadprog as laws

SOLVER_TOLERANCE_RAD_S = 1e-9
"""How far a constraint may be missed; far below what an encoder sees."""


@dataclass(frozen=True)
class Program:
    """A program, its constraints in daqp's order: the box on the joints, then the rows."""

    H: NDArray[np.float64]
    """(n, n)"""
    c: NDArray[np.float64]
    """(n,)"""
    rows: NDArray[np.float64]
    """(R, n)"""
    lower: NDArray[np.float64]
    """(n + R,)"""
    upper: NDArray[np.float64]
    """(n + R,)"""
    sense: NDArray[np.intc]
    """(n + R,) daqp's marks; see `laws.program`."""


class ProgramSpace:
    """Arrays that an arm's programs are written into, kept from tick to tick.

    Args:
        n: Joints.
    """

    def __init__(self, n: int):
        self.n = n
        self.H, self.c = np.zeros((n, n)), np.zeros(n)
        self.smallest, self.largest = np.zeros(n), np.zeros(n)
        """(n,) the box on the joints."""
        self._grow(64)

    def _grow(self, rows: int) -> None:
        self.rows, self.bounds = np.zeros((rows, self.n)), np.zeros(rows)
        """(room, n) rows and (room,) the smallest rate of those that stand for pairs."""
        self.lower, self.upper = np.zeros(self.n + rows), np.zeros(self.n + rows)
        self.sense = np.zeros(self.n + rows, dtype=np.intc)
        self.solver, self._kept = quadprog.solver(
            self.H, self.c, self.rows, self.lower, self.upper, self.sense, SOLVER_TOLERANCE_RAD_S
        )
        """What `laws.quadprog.solve` is given."""

    def reserve(self, rows: int) -> None:
        """Make room for this many rows; what was written is lost where the room was too small."""
        if rows > len(self.rows):
            self._grow(2 * rows)

    def solve(self, rows: int) -> NDArray[np.float64] | None:
        """(n,) the solution of the program that was written with this many rows, settled in its box; None without one."""
        settled = np.empty(self.n)
        answer = laws.solve(
            *self.solver,
            self.n + rows,
            self.smallest,
            self.largest,
            SOLVER_TOLERANCE_RAD_S,
            settled,
        )
        return self.answered(answer, rows, settled)

    def answered(
        self, answer: int, rows: int, settled: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """What `laws.quadprog.solve` has answered and written (n,); where it could not ask, the wrapper is asked."""
        if answer == laws.NOT_ASKED:
            m = self.n + rows
            x = solution(
                Program(
                    self.H, self.c, self.rows[:rows], self.lower[:m], self.upper[:m], self.sense[:m]
                )
            )
            if x is None:
                return None
            self.solver.x[...] = x
            joint_limits.settle(x, self.smallest, self.largest, SOLVER_TOLERANCE_RAD_S, settled)
            return settled
        return settled if answer == laws.ANSWERED else None


def solution(program: Program) -> NDArray[np.float64] | None:
    """(n,) what daqp's wrapper finds; None where there is no acceptable solution."""
    velocity, _, flag, _ = daqp.solve(
        program.H,
        program.c,
        program.rows,
        program.upper,
        program.lower,
        program.sense,
        primal_tol=SOLVER_TOLERANCE_RAD_S,
    )
    if flag not in laws.SOLVED or not all_finite(velocity):
        return None
    return velocity
