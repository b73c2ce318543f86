"""The watched pairs as a tick sees them, in compiled code on arrays kept from tick to tick.

Each method does what `share.py` says in NumPy, in one call for a whole stage of the tick. What a
compiled function refuses (a number that is not finite, joints that can reach no factor, a command that
does not keep every pair) is left to NumPy, which finds out what is the matter.
"""

from __future__ import annotations

from typing import Any

import mink
import numpy as np
from numpy.typing import NDArray

from workcell.control.criteria import (
    STOP_MARGIN_RAD,
    STOP_PUSH_RAD_S,
    NullspaceObjective,
)
from workcell.control.ik import (
    OPTIMAL,
    SOLVER_TOLERANCE_RAD_S,
    ArmIk,
    CompiledIk,
    IkSolution,
    Program,
    solution,
)
from workcell.control.kernels.arguments import DONE
from workcell.control.kernels.library import Bound, Kernels
from workcell.control.scaling import AccelerationInterval, ScaleBound, acceleration_interval
from workcell.control.share import (
    AT_REST_M_S,
    PRESSED_M_S,
    PRESSED_MEETING_M_S,
    TASK_SLACK_M_S,
    WAYS,
    Allowance,
    ArmPairs,
    Array,
    Indices,
    Rates,
    Share,
    Watched,
)
from workcell.control.ttc import SmallestTtc
from workcell.scenario import Control

_KINDS = {"artc": 0, "artc_approaching": 1, "armd": 2, "none": 3}
_PUSH = 4


class CompiledWatched(Watched):
    """See `share.Watched`; there must be pairs."""

    def __init__(self, kernels: Kernels, pairs: int, dofs: list[Indices], nv: int):
        super().__init__(pairs, dofs, nv)
        self.kernels = kernels
        owner = np.full(nv, -1, dtype=np.int64)
        for arm, own in enumerate(dofs):
            owner[own] = arm
        self._rates: dict[int, Bound] = {
            order: kernels.bind(
                "rates",
                {"pairs": pairs, "joints": nv, "arms": len(dofs), "order": order},
                jacobian=self.jacobian,
                distance=self.distance_m,
                silent=self.silent,
                owner=owner,
            )
            for order in (1, 2)
        }

    def share(
        self, ik: ArmIk, configuration: mink.Configuration, pairs: ArmPairs, *, support: bool
    ) -> Share:
        """See `share.Watched.share`."""
        return CompiledShare(self.kernels, self, ik, configuration, pairs, support=support)

    def rates(self, velocity_rad_s: Array, accel_m_s2: Array | None = None) -> Rates:
        """See `share.Watched.rates`."""
        call = self._rates[1 if accel_m_s2 is None else 2]
        kept = call.arrays
        kept["velocity"][...] = velocity_rad_s
        if accel_m_s2 is not None:
            kept["accel"][...] = accel_m_s2
        call.run()
        if call.done() != DONE:
            return super().rates(velocity_rad_s, accel_m_s2)
        first, nearest, cause = kept["which"].tolist()
        soonest = SmallestTtc(kept["ttc"].item(), first)
        return Rates(kept["rate"].copy(), soonest, nearest, None if cause < 0 else cause)


class CompiledShare(Share):
    """See `share.Share`."""

    def __init__(
        self,
        kernels: Kernels,
        watched: Watched,
        ik: ArmIk,
        configuration: mink.Configuration,
        pairs: ArmPairs,
        *,
        support: bool,
    ):
        super().__init__(watched, ik, configuration, pairs, support=support)
        self._kernels = kernels
        n = len(self.arm.dofs)
        self._sizes = {
            "pairs": len(watched.distance_m),
            "joints": watched.jacobian.shape[1],
            "dofs": n,
            "owned": len(pairs.owned),
            "averaged": len(pairs.averaged),
            "chosen": len(pairs.moved),
        }
        self._seen: dict[str, NDArray[Any]] = {
            "jacobian": watched.jacobian,
            "distance": watched.distance_m,
        }
        self._dof = self.arm.dofs.astype(np.int64)
        averaged = pairs.averaged.astype(np.int64)
        self._surroundings: dict[bool, Bound] = {
            approaching: kernels.bind(
                "surroundings",
                self._sizes | {"kind": int(approaching)},
                distance=watched.distance_m,
                rate=watched.rate_m_s,
                criterion=averaged,
            )
            for approaching in (False, True)
        }
        answered: dict[str, NDArray[Any]] = {
            **self._seen,
            "other": self.other_m_s,
            "index": pairs.owned.astype(np.int64),
            "meeting": self.meeting,
            "dof": self._dof,
        }
        self._allow: Bound = kernels.bind(
            "allow",
            self._sizes,
            **answered,
            standing=np.ascontiguousarray(pairs.standing),
            limit=np.ascontiguousarray(self.arm.acceleration_limit_rad_s2, dtype=float),
        )
        self._keeps: Bound = kernels.bind("keeps", self._sizes, **answered)
        self._program: Bound | None = None
        self._aimed_by: CompiledIk | None = None
        self._programs: dict[int, Program] = {}
        self._settle: Bound | None = None
        self._settings: Control | None = None
        self._chosen: tuple[float, ...] = ()

    def surroundings(self, *, approaching: bool) -> tuple[float, float]:
        """See `share.Share.surroundings`."""
        found = self._surroundings[approaching]
        found.run()
        if found.done() != DONE:
            return super().surroundings(approaching=approaching)
        artc, armd = found.arrays["value"].tolist()
        return artc, armd

    def solve(
        self,
        previous_rad_s: Array,
        task_rad_s: Array,
        qvel: Array,
        settings: Control,
        push: NullspaceObjective | None = None,
    ) -> IkSolution:
        """See `share.Share.solve`."""
        ik = self.ik
        if ik.aimed_by is not None and (push is None or not push.hessian.any()):
            if self._program is None or ik.aimed_by is not self._aimed_by:
                self._bind_program(ik.aimed_by)
            velocity = self._solve(previous_rad_s, qvel, settings, push)
            if velocity is not None:
                return IkSolution(velocity, OPTIMAL)
        return super().solve(previous_rad_s, task_rad_s, qvel, settings, push)

    def _solve(
        self,
        previous_rad_s: Array,
        qvel: Array,
        settings: Control,
        push: NullspaceObjective | None,
    ) -> Array | None:
        """The first program's solution; None where NumPy has to see to it."""
        assert self._program is not None
        assert self._settle is not None
        self._take(settings)
        ik, kept = self.ik, self._program.arrays
        kept["previous"][...], kept["qvel"][...] = previous_rad_s, qvel
        ways = WAYS if self.support else 1
        if self.support and settings.variant == "static":
            ways = 0
        kind = _KINDS[settings.criterion]
        if push is not None:
            kind, kept["push"][...] = _PUSH, push.linear
        choice = ways, kind, self.support, ik.tool_rows, ik.criterion.gain
        if choice != self._chosen:
            self._chosen = choice
            kept["choice"][...] = choice[:4]
            kept["settings"][...] = ik.dt_s, ik.criterion.gain
            kept["stops"][...] = STOP_MARGIN_RAD, STOP_PUSH_RAD_S, ik.criterion.gain
        self._program.run()
        if self._program.done() != DONE:
            return None
        velocity = solution(self._written(kept["counts"].item(0) + ik.tool_rows))
        if velocity is None:
            return None
        settled = self._settle.arrays
        settled["velocity"][...] = velocity
        self._settle.run()
        return settled["settled"].copy() if self._settle.done() == DONE else None

    def allow(
        self, wanted_rad_s: Array, command_rad_s: Array, period_s: float, settings: Control
    ) -> Allowance:
        """See `share.Share.allow`."""
        if settings.slow_down == "ttc" and self.watched.accel_m_s2 is None:
            self._take(settings)
            kept = self._allow.arrays
            kept["wanted"][...], kept["previous"][...] = wanted_rad_s, command_rad_s
            kept["period"][0] = period_s
            self._allow.run()
            if self._allow.done() == DONE:
                factor, required, short = kept["found"].tolist()
                pair, short_pair = kept["which"].tolist()
                pressed, reachable = kept["told"].tolist()
                return Allowance(
                    ScaleBound(factor, pair, required, short, short_pair),
                    bool(pressed),
                    AccelerationInterval(*kept["reach"].tolist(), feasible=True)
                    if reachable
                    else acceleration_interval(
                        command_rad_s, wanted_rad_s, self.arm.acceleration_limit_rad_s2, period_s
                    ),
                )
        return super().allow(wanted_rad_s, command_rad_s, period_s, settings)

    def keeps(self, command_rad_s: Array, settings: Control) -> bool:
        """See `share.Share.keeps`."""
        self._take(settings)
        kept = self._keeps.arrays
        kept["command"][...] = command_rad_s
        self._keeps.run()
        if self._keeps.done() == DONE:
            self.kept_other_m_s = kept["kept_other"]
            return True
        return super().keeps(command_rad_s, settings)

    def _take(self, settings: Control) -> None:
        """Write down the parameters in force, if they are others than before."""
        if settings is self._settings:
            return
        self._settings = settings
        rule = (settings.standoff_m, settings.t_min_s, settings.d_min_m)
        self._allow.arrays["rule"][...] = (*rule, AT_REST_M_S, PRESSED_M_S, PRESSED_MEETING_M_S)
        self._keeps.arrays["rule"][...] = (*rule, AT_REST_M_S, TASK_SLACK_M_S)
        if self._program is not None:
            self._program.arrays["rule"][...] = (*rule, TASK_SLACK_M_S)

    def _bind_program(self, ik: CompiledIk) -> None:
        """Arrays for the arm's program: the rows of all pairs that it moves, and the tool's six."""
        rows, n = len(self.pairs.moved) + 6, len(self._dof)
        self._aimed_by, self._settings, self._chosen = ik, None, ()
        self._program = self._kernels.bind(
            "program",
            self._sizes
            | {
                "coordinates": len(ik.limits["qpos"]),
                "room": rows,
                "constraints": n + rows,
            },
            **self._seen,
            **ik.limits,
            **ik.aimed,
            rate=self.watched.rate_m_s,
            ways=self.watched.ways_rad_s,
            index=self.pairs.moved.astype(np.int64),
            criterion=self.pairs.averaged.astype(np.int64),
            dof=self._dof,
            other=self.other_m_s,
        )
        kept = self._program.arrays
        self._settle = self._kernels.bind("settle", {"dofs": n}, low=kept["low"], high=kept["high"])
        self._settle.setting[0] = SOLVER_TOLERANCE_RAD_S
        self._programs = {}

    def _written(self, rows: int) -> Program:
        """The program that was written into the kept arrays, with this many rows."""
        program = self._programs.get(rows)
        if program is None:
            assert self._program is not None
            kept, m = self._program.arrays, len(self._dof) + rows
            program = self._programs[rows] = Program(
                kept["H"], kept["c"], kept["rows"][:rows], kept["lower"][:m], kept["upper"][:m],
                kept["sense"][:m],
            )  # fmt: skip
        return program
