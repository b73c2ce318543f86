"""An operator that somebody else brings: a class found by name (`workcell.plugins`), asked like any other.

The class is called once with an `OperatorSetup` and answers `setpoint(time_s)` once a tick, with rising
times. What it answers is checked here, since nothing behind this point expects nonsense: an operator
that raises, or answers with something else than a finite setpoint, ends the run with its name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell import plugins, scenario
from workcell.errors import ControlFault, InputError
from workcell.motion.path import Target
from workcell.motion.setpoint import STATES, Operator, Setpoint

_SHAPES = {
    "position_m": 3,
    "wxyz": 4,
    "velocity_m_s": 3,
    "angular_velocity_rad_s": 3,
}
"""Length of each part of a target."""


@dataclass(frozen=True)
class OperatorSetup:
    """What an operator is told once, before the run."""

    arm: str
    """Name of the arm that it drives."""
    position_m: NDArray[np.float64]
    """(3,) of the tool at the start, in the world."""
    wxyz: NDArray[np.float64]
    """(4,) unit quaternion of the tool at the start."""
    period_s: float
    """Control period."""
    random: np.random.Generator
    """Source of all chance, seeded by the scenario and the arm's name: the same seed gives the same run."""
    options: Any
    """An instance of the class's own `Options`; None if it has none."""


class PluggedOperator:
    """Asks an operator from a plug-in, and checks what it answers.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        arm: Name of the arm.
        period_s: Control period.
        random: Source of all its chance.

    Raises:
        InputError: it cannot be made.
    """

    def __init__(
        self,
        settings: scenario.Plugin,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        arm: str,
        period_s: float,
        random: np.random.Generator,
    ):
        self._name, self._period_s = settings.name, period_s
        self._operator: Operator = plugins.make(
            "operators",
            settings.name,
            lambda options: OperatorSetup(
                arm=arm,
                position_m=np.array(position_m, dtype=float),
                wxyz=np.array(wxyz, dtype=float),
                period_s=period_s,
                random=random,
                options=options,
            ),
            settings.options,
        )

    def setpoint(self, time_s: float) -> Setpoint:
        """See `workcell.motion.setpoint.Operator`.

        Raises:
            ControlFault: it raised, or answered with nonsense.
        """
        try:
            answer = self._operator.setpoint(time_s)
            fault = _fault(answer)
        except Exception as error:
            fault = f"raised {type(error).__name__}: {error}"
        if fault:
            raise ControlFault(
                round(time_s / self._period_s), f"operator {self._name!r} {fault[:500]}"
            )
        return answer


def faults(
    settings: scenario.Plugin,
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
    *,
    arm: str,
    period_s: float,
) -> list[str]:
    """Why an operator cannot be made, or gives no first setpoint; empty where it does. Arguments as for the class."""
    random = np.random.default_rng(0)
    try:
        operator = PluggedOperator(
            settings, position_m, wxyz, arm=arm, period_s=period_s, random=random
        )
        operator.setpoint(0.0)
    except InputError as error:
        return [f"name: {fault}" for fault in error.faults]
    except ControlFault as error:
        return [f"name: {error.origin}"]
    return []


def _fault(answer: object) -> str:
    """What is wrong with an answer; empty if nothing is."""
    if not isinstance(answer, Setpoint) or not isinstance(answer.target, Target):
        return f"answered with {type(answer).__name__}; allowed is a Setpoint with a Target"
    for name, count in _SHAPES.items():
        value = getattr(answer.target, name)
        if not isinstance(value, np.ndarray) or value.shape != (count,):
            return f"answered with target.{name} of shape {np.shape(value)}; allowed is an array ({count},)"
        if not np.isfinite(value).all():
            return f"answered with target.{name} = {value.tolist()}: is not finite"
    norm = float(np.linalg.norm(answer.target.wxyz))
    if abs(norm - 1.0) > scenario.UNIT_QUATERNION_TOLERANCE:
        return f"answered with target.wxyz of norm {norm:.6g}; allowed is 1"
    if answer.state not in STATES:
        return f"answered with state {answer.state!r}; allowed: {', '.join(STATES)}"
    if answer.joints_rad_s is not None and not np.isfinite(answer.joints_rad_s).all():
        return "answered with joints_rad_s that are not finite"
    return ""
