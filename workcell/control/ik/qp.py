"""The quadratic program of one arm and its solver, daqp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workcell.control.finite import all_finite
from workcell.control.ik import quadprog

SOLVER_TOLERANCE_RAD_S = 1e-9
"""How far a constraint may be missed; far below what an encoder sees."""
_SOLVED, _SOLVED_SOFT = 1, 2  # daqp's exit flags: optimal; optimal with a soft constraint missed


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
    solve: Callable[[], tuple[NDArray[np.float64], int]] = field(init=False, repr=False)
    """Solves what stands in the arrays then; see `quadprog.bind`."""

    def __post_init__(self) -> None:
        solve = quadprog.bind(
            self.H, self.c, self.rows, self.lower, self.upper, self.sense, SOLVER_TOLERANCE_RAD_S
        )
        object.__setattr__(self, "solve", solve)


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
        self._programs: dict[int, Program] = {}

    def reserve(self, rows: int) -> None:
        """Make room for this many rows; what was written is lost where the room was too small."""
        if rows > len(self.rows):
            self._grow(2 * rows)

    def program(self, rows: int) -> Program:
        """The program that was written, which has this many rows."""
        program = self._programs.get(rows)
        if program is None:
            m = self.n + rows
            program = self._programs[rows] = Program(
                self.H, self.c, self.rows[:rows], self.lower[:m], self.upper[:m], self.sense[:m]
            )
        return program


def solution(program: Program) -> NDArray[np.float64] | None:
    """(n,) what daqp finds, good until the same program is solved again; None where there is no acceptable solution."""
    velocity, flag = program.solve()
    if flag not in (_SOLVED, _SOLVED_SOFT) or not all_finite(velocity):
        return None
    return velocity
