"""What the joints have done since the state was taken that the controller sees.

A state that is m ticks old is carried on by the commands given since, which only the controller knows:

    q  + T (u[k-m] + ... + u[k-1]),    dq + u[k-1] - u[k-1-m]

with period T and commands u. That is exact where the joints do what they are told; a servo's lag stays in it as it
was m ticks ago. m is `[simulation] latency_ticks`, and one more for every time that the state before is seen again
to the last bit: its successor was lost or has not come yet. (A state that repeats because nothing moves is
carried on by commands of zero.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell.scene.cell import Cell

Array = NDArray[np.float64]

MOST_LOST = 10
"""States that may be lost in a row: beyond them nothing more is carried on. Chosen above what a link loses that works at all."""


class Delay:
    """The commands under way to the measured state.

    Args:
        cell: The compiled cell.
    """

    def __init__(self, cell: Cell):
        self._late: int = cell.scenario.simulation.latency_ticks
        self._period_s = cell.period_s
        self._dofs = np.concatenate([arm.dofs for arm in cell.arms])
        self._positions = np.concatenate([arm.qpos for arm in cell.arms])
        self._commands = np.zeros((self._late + MOST_LOST + 2, cell.model.nv))
        """A ring."""
        self._newest = 0
        self._seen: tuple[bytes, bytes] | None = None
        self._lost = 0

    def now(self, qpos: Array, qvel: Array, last: Array) -> tuple[Array, Array]:
        """The state now.

        Args:
            qpos, qvel: (nq,) and (nv,) as measured.
            last: (nv,) the commands of the tick before.

        Returns:
            (nq,) and (nv,): the same arrays where nothing is late.
        """
        commands = self._commands
        self._newest = newest = (self._newest + 1) % len(commands)
        commands[newest] = last
        seen = qpos.tobytes(), qvel.tobytes()
        self._lost = min(self._lost + 1, MOST_LOST) if seen == self._seen else 0
        self._seen = seen
        age = self._late + self._lost
        if not age:
            return qpos, qvel
        since = (newest - np.arange(age)[::-1]) % len(commands)
        before = commands[(newest - age) % len(commands), self._dofs]
        qpos, qvel = qpos.copy(), qvel.copy()
        qpos[self._positions] += self._period_s * commands[since][:, self._dofs].sum(axis=0)
        qvel[self._dofs] += commands[newest, self._dofs] - before
        return qpos, qvel
