"""The null-space criterion of one arm: one of our own, known to the laws by a number, or one that a plug-in brings.

A criterion from outside is a function of distances (P,) in m, rates (P,) in m/s and rows of G (P, n), of the
pairs that the arm is averaged over. It answers with H (n, n) and c (n,): descending 1/2 q' H q' + c q' is
what the null space is for. The rates are those without the arm's own self-motion, as a criterion that reads its
own answer chatters. A class with options is called once with its `Options`, and its instance is the function.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from workcell import plugins
from workcell.control.criteria import Array, NullspaceObjective
from workcell.control.finite import all_finite
from workcell.control.laws import criteria as laws
from workcell.errors import InputError, WorkcellError
from workcell.scenario import Control, Scenario

Function = Callable[[Array, Array, Array], tuple[Array, Array]]

_CONVEX_TOLERANCE = 1e-9
"""Of H, against its largest entry: how asymmetric it may be, and how negative its least eigenvalue, by rounding."""


class CriterionFault(WorkcellError):
    """A criterion has not given an answer that can be used."""


class ArmCriterion:
    """What the null space of one arm is for.

    Args:
        scenario: Names the criterion of all arms, of this one, and their options.
        arm: Its name.

    Raises:
        InputError: A criterion is unknown, cannot be made, or does not take its options.
    """

    def __init__(self, scenario: Scenario, arm: str):
        self._arm = arm
        self._own = next(each for each in scenario.arm if each.name == arm).criterion
        self._options: Mapping[str, Mapping[str, Any]] = scenario.criterion
        self._made: dict[str, Any] = {}
        """By name, the number of one of our own or the function of one from outside."""
        self._settings: Control | None = None
        """Those for which `_kind` was looked up."""
        self._kind = laws.NO_CRITERION
        later = [change.criterion for change in scenario.change if change.criterion]
        for name in {self._own or scenario.control.criterion, *([] if self._own else later)}:
            self._make(name)

    def name(self, settings: Control) -> str:
        """Of the criterion in force."""
        return self._own or settings.criterion

    def kind(self, settings: Control) -> int:
        """Its number for the laws; `laws.criteria.GIVEN` for one from outside."""
        if settings is not self._settings:
            made = self._make(self.name(settings))
            self._settings, self._kind = settings, made if isinstance(made, int) else laws.GIVEN
        return self._kind

    def counts_approaching(self, settings: Control) -> bool:
        """Whether the ARTC that is logged counts only pairs that approach, as the criterion does."""
        return self.kind(settings) in (laws.ARTC_APPROACHING, laws.ARTC_HELD)

    def objective(
        self, settings: Control, distance_m: Array, rate_m_s: Array, rows: Array
    ) -> NullspaceObjective:
        """What a criterion from outside answers.

        Args:
            settings: In force.
            distance_m: (P,).
            rate_m_s: (P,) without the arm's own self-motion.
            rows: (P, n) of G.

        Raises:
            CriterionFault: It raised, or its answer cannot be used; the message names it.
        """
        name, n = self.name(settings), rows.shape[1]
        function = self._make(name)
        assert not isinstance(function, int)
        who = f"criterion {name!r} of arm {self._arm}"
        try:
            hessian, linear = function(distance_m, rate_m_s, rows)
            hessian, linear = np.array(hessian, dtype=float), np.array(linear, dtype=float)
        except Exception as error:
            raise CriterionFault(f"{who} raised {type(error).__name__}: {error}") from error
        if hessian.shape != (n, n) or linear.shape != (n,):
            raise CriterionFault(
                f"{who} answered with shapes {hessian.shape} and {linear.shape}, must be ({n}, {n}) and ({n},)"
            )
        if not all_finite(hessian) or not all_finite(linear):
            raise CriterionFault(f"{who} answered with a number that is not finite")
        slack = _CONVEX_TOLERANCE * max(1.0, float(np.abs(hessian).max(initial=0.0)))
        if np.abs(hessian - hessian.T).max(initial=0.0) > slack or (
            n and float(np.linalg.eigvalsh(hessian)[0]) < -slack
        ):
            raise CriterionFault(
                f"{who} answered with a quadratic term that is not symmetric and positive semidefinite"
            )
        return NullspaceObjective(hessian, linear)

    def _make(self, name: str) -> int | Function:
        if name not in self._made:
            given = self._options.get(name)
            found = plugins.load("criteria", name)
            if inspect.isclass(found):
                found = plugins.make("criteria", name, lambda options: options, given)
            elif not (callable(found) or plugins.is_built_in("criteria", name)):
                raise InputError(
                    f"criterion {name!r}: is {type(found).__name__}; allowed is a function or a class"
                )
            elif given:
                plugins.options("criteria", name, given)  # refuses them
            self._made[name] = found
        return self._made[name]
