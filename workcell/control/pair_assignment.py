"""Which arm answers for which watched pair; anew whenever an instrument changes hands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from workcell.control.arm import ControlledArm
from workcell.control.arm_constraints import ArmConstraints, ArmPairs
from workcell.control.grasp import Grasps
from workcell.control.watched import Watched
from workcell.motion.jobs import Meeting
from workcell.scene.cell import Cell


def assign(cell: Cell, grasps: Grasps, watched: Watched, arms: Sequence[ControlledArm]) -> None:
    """Give each arm its part of the pairs, as the instruments are held now."""
    watched.inactive[...] = inactive_pairs(cell, grasps)
    for arm, pairs in zip(arms, assigned(cell, grasps), strict=True):
        arm.constraints = ArmConstraints(
            watched, arm.ik, arm.configuration, pairs, support=arm.support
        )


def inactive_pairs(cell: Cell, grasps: Grasps) -> NDArray[np.bool_]:
    """(P,) pairs that no arm's motion changes, or that do not count now: an instrument against the hand that holds it."""
    return np.array([not grasps.parties(k) for k in range(len(cell.pairs))], dtype=bool)


def assigned(cell: Cell, grasps: Grasps) -> list[ArmPairs]:
    """Which pairs concern each arm, in the order of the arms.

    Every pair that a support arm can hold by slowing down is answered for by exactly one arm.
    Between two arms it is the support arm, of two support arms the one with the higher priority
    number, of equals the later in the scenario; near a base it is the arm that comes, if a
    support arm does.
    """
    rank = {arm.name: (arm.support, arm.priority, index) for index, arm in enumerate(cell.arms)}
    parties = [grasps.parties(k) for k in range(len(cell.pairs))]
    holders = [
        [name for name in names if rank[name][0] and grasps.can_move(k, name)] or names
        for k, names in enumerate(parties)
    ]
    owners = cell.pairs.owners
    dealt = []
    for arm in cell.arms:
        name = arm.name
        mine = [k for k, names in enumerate(parties) if name in names]
        owned = [k for k in mine if arm.support and name == max(holders[k], key=rank.__getitem__)]
        dealt.append(
            ArmPairs(
                moved=np.array(mine, dtype=np.intp),
                averaged=np.array([k for k in mine if owners[k][0] != owners[k][1]], dtype=np.intp),
                owned=np.array(owned, dtype=np.intp),
                fixed_base=np.array([not grasps.can_move(k, name) for k in owned], dtype=bool),
            )
        )
    return dealt


def meeting_pairs(cell: Cell, grasps: Grasps, arm: ControlledArm) -> NDArray[np.intp]:
    """Pairs that an arm's present job brings together, or that it leaves after having done so.

    One geom is of the arm's hand and the other of what it is to meet. Looked up when the job or a
    holder changes.
    """
    meeting = None if arm.jobs is None else arm.jobs.meeting
    key = meeting, grasps.summary()
    if arm.meeting_key != key:
        arm.meeting_key = key
        arm.meeting_pairs = (
            np.array([], dtype=np.intp)
            if meeting is None
            else brought_together(cell, grasps, arm.name, arm.constraints.pairs.moved, meeting)
        )
    return arm.meeting_pairs


def brought_together(
    cell: Cell, grasps: Grasps, arm: str, pairs: Iterable[int], meeting: Meeting
) -> NDArray[np.intp]:
    """Of some pairs those between what an arm's job is to bring together, as the instruments are held now."""
    partner = meeting.arm
    moved = next((x.geom for x in cell.instruments if x.name == meeting.instrument), None)

    def meets(g: int, h: int) -> bool:
        if moved is not None and moved not in (g, h):
            return False  # a hand-over is complete when the instrument is there, not when the hands are
        return any(
            grasps.part_of_hand(mine, arm)
            and (theirs == moved if partner is None else grasps.part_of_hand(theirs, partner))
            for mine, theirs in ((g, h), (h, g))
        )

    found = [k for k in pairs if meets(*map(int, cell.pairs.geoms[k]))]
    return np.array(found, dtype=np.intp)
