"""Operators: what drives a priority arm.

An operator is asked once a tick for the setpoint at a time of the run: the tool motion that it wants
and the state of its input (workcell.motion.setpoint). Each kind is a file of its own here;
`make_operator` chooses by the scenario's table.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators.device import DeviceOperator
from workcell.motion.operators.human import HumanOperator
from workcell.motion.operators.joints import JointsOperator
from workcell.motion.operators.joints import faults as joints_faults
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.plugged import OperatorSetup, PluggedOperator
from workcell.motion.operators.plugged import faults as plugged_faults
from workcell.motion.operators.recording import RecordingOperator
from workcell.motion.operators.recording import faults as recording_faults
from workcell.motion.operators.scripted import HoldOperator, WaypointsOperator
from workcell.motion.operators.streamed import StreamedHumanOperator
from workcell.motion.setpoint import Operator

__all__ = ["Operator", "OperatorSetup", "faults", "make_operator"]

_OF_THE_STREAM = 1
"""Keeps the faults of a stream apart from the motion of the person behind it."""


def make_operator(
    settings: scenario.Operator,
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
    *,
    seed: int = 0,
    name: str = "",
    period_s: float = 0.002,
) -> Operator:
    """The operator a scenario asks for.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        seed: The scenario's seed.
        name: The arm's name; two simulated people in one scenario do not move alike.
        period_s: Control period.

    Raises:
        InputError: the file of a recording is missing or not sound.
    """
    match settings:
        case scenario.Waypoints():
            return WaypointsOperator(settings, position_m, wxyz)
        case scenario.Recording():
            return RecordingOperator(settings, position_m, wxyz, period_s=period_s)
        case scenario.Human():
            random = np.random.default_rng([seed, zlib.crc32(name.encode())])
            person = HumanOperator(settings, position_m, wxyz, random)
            if settings.stream is None:
                return person
            return StreamedHumanOperator(
                person,
                settings.stream,
                position_m,
                wxyz,
                period_s=period_s,
                random=np.random.default_rng([seed, zlib.crc32(name.encode()), _OF_THE_STREAM]),
            )
        case scenario.Plugin():
            random = np.random.default_rng([seed, zlib.crc32(name.encode())])
            return PluggedOperator(
                settings, position_m, wxyz, arm=name, period_s=period_s, random=random
            )
        case scenario.Joints():
            return JointsOperator(settings, arm=name, period_s=period_s)
        case scenario.Live() if settings.device is not None:
            return DeviceOperator(settings, position_m, wxyz, arm=name, period_s=period_s)
        case scenario.Live():
            return LiveOperator(settings, position_m, wxyz, period_s=period_s)
    return HoldOperator(position_m, wxyz)


def faults(
    settings: scenario.Operator,
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
    *,
    duration_s: float,
    period_s: float,
    name: str,
    home_rad: tuple[float, ...],
    joints: tuple[str, ...],
) -> list[str]:
    """Why an operator could not drive its arm through a run, as far as this shows before the run.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        duration_s: Length of the run.
        period_s: Control period.
        name: Of the arm.
        home_rad: Its joint positions at the start.
        joints: Names of its joints, without the arm's own name.

    Returns:
        One sentence for each fault, naming key, value and what is allowed; empty where there is none.
    """
    if isinstance(settings, scenario.Recording):
        return recording_faults(
            settings, position_m, wxyz, duration_s=duration_s, period_s=period_s
        )
    if isinstance(settings, scenario.Plugin):
        return plugged_faults(settings, position_m, wxyz, arm=name, period_s=period_s)
    if isinstance(settings, scenario.Joints):
        return joints_faults(settings, name, home_rad, joints)
    return []
