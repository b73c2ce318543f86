"""Who holds which instrument, and what follows for the watched pairs.

A held instrument moves with the tool as one rigid body: the columns of G that belong to its free
joint are folded onto the joints of the arm that holds it. It counts as part of that arm from the
tick it is taken: pairs with its own hand are inactive, pairs with everything else are the holder's
to keep apart. Where the plant has the instrument is `simulation/instruments.py`.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.cell import Cell
from workcell.scene.contacts import CarriedMotion, hand_bodies
from workcell.scene.hand import tool_body


class Grasps:
    """The instruments of a cell and the arms that hold them, at the start those of the scenario.

    Args:
        cell: The cell.
    """

    def __init__(self, cell: Cell):
        self._cell = cell
        self._arms = {arm.name: arm for arm in cell.arms}
        self._items = {item.name: item for item in cell.instruments}
        self._held = {item.name: item.held_by for item in cell.instruments if item.held_by}
        self._tools = {arm.name: tool_body(cell.model, arm) for arm in cell.arms}
        self._hands = {arm.name: hand_bodies(cell.model, arm) for arm in cell.arms}
        self._carried = CarriedMotion(cell.model)
        self.holders: dict[str, str | None] = {}
        """For every instrument the arm that holds it, None where it lies; another dict after every change."""
        self._summary = ""
        self._tell()

    def holder(self, instrument: str) -> str | None:
        """Name of the arm that holds an instrument; None where it lies."""
        return self._held.get(instrument)

    def holding(self, arm: str) -> str | None:
        """Name of the instrument an arm holds."""
        return next((name for name, holder in self._held.items() if holder == arm), None)

    def summary(self) -> str:
        """Who holds what, for the log: `scalpel=nurse clamp=`."""
        return self._summary

    def take(self, instrument: str, arm: str) -> None:
        """From now on the arm holds the instrument."""
        self._held[instrument] = arm
        self._tell()

    def let_go(self, instrument: str) -> None:
        """From now on nobody holds the instrument; it stays where it is."""
        del self._held[instrument]
        self._tell()

    def fold(self, data: mujoco.MjData, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
        """G (P, nv) with held instruments as part of their arms, and lying ones as part of the world."""
        if not self._items:
            return jacobian
        folded = jacobian.copy()
        for name, item in self._items.items():
            own = slice(item.dof, item.dof + 6)
            holder = self._held.get(name)
            if holder is not None:
                arm = self._arms[holder]
                follow = self._carried.per_joint(data, item, arm)
                folded[:, self._carried.columns(arm)] += folded[:, own] @ follow
            folded[:, own] = 0.0
        return folded

    def parties(self, pair: int) -> tuple[str, ...]:
        """The arms whose motion changes a pair; empty for a pair that is switched off now.

        Off are: an instrument against the hand that holds it, and pairs without any arm.
        """
        names = []
        for geom, owner in zip(
            self._cell.pairs.geoms[pair], self._cell.pairs.owners[pair], strict=True
        ):
            arm = self.holder(owner) if owner in self._items else owner
            if arm is not None:
                names.append((arm, int(geom), owner in self._items))
        if len(names) == 2 and names[0][0] == names[1][0] and any(item for *_, item in names):
            arm = names[0][0]
            others = [geom for _, geom, item in names if not item]
            if not others or self._cell.model.geom_bodyid[others[0]] in self._hands[arm]:
                return ()
        return tuple(dict.fromkeys(arm for arm, *_ in names))

    def can_move(self, pair: int, arm: str) -> bool:
        """Whether an arm's joints change a pair: its own base stands, whatever it does."""
        model = self._cell.model
        return any(
            (self.holder(owner) if owner in self._items else owner) == arm
            and model.body_weldid[model.geom_bodyid[geom]] != 0
            for geom, owner in zip(
                self._cell.pairs.geoms[pair], self._cell.pairs.owners[pair], strict=True
            )
        )

    def part_of_hand(self, geom: int, arm: str) -> bool:
        """Whether a geom is on the arm's tool or is the instrument it holds."""
        held = self.holding(arm)
        return self._cell.model.geom_bodyid[geom] == self._tools[arm] or (
            held is not None and geom == self._items[held].geom
        )

    def _tell(self) -> None:
        """Say anew who holds what: asked every tick, changed a few times a run."""
        self.holders = {name: self.holder(name) for name in self._items}
        self._summary = " ".join(f"{name}={arm or ''}" for name, arm in self.holders.items())
