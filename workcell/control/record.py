"""What a tick leaves behind: the record that becomes a row of the trace.

Fields are the signals of `workcell.signals` under the same names; the writer of the trace takes
them apart by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass
class ArmRecord:
    """One arm's part of a tick's record; fields are the arm signals of `workcell.signals`."""

    target_position_m: NDArray[np.float64]
    target_wxyz: NDArray[np.float64]
    target_velocity_m_s: NDArray[np.float64]
    target_turn_rad_s: NDArray[np.float64]
    job: str
    path_s: float
    tool_position_m: NDArray[np.float64]
    tool_wxyz: NDArray[np.float64]
    tool_speed_m_s: float
    tool_error_m: float
    tool_error_rad: float
    elbow_position_m: NDArray[np.float64] | None
    artc_per_s: float
    armd_per_m: float
    operator_state: str = ""
    ik_status: str = ""
    scale: float = 1.0
    limiting_pair: int | None = None
    reason: str = ""
    attempt: str = ""
    mode: str = "run"


@dataclass
class TickRecord:
    """Everything a tick saw, wanted and did; fields are the cell signals of `workcell.signals`."""

    tick: int
    time_s: float
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    pair_distance_m: NDArray[np.float64]
    pair_rate_m_s: NDArray[np.float64]
    t_min_s: float
    criterion: str
    entry: str
    closest_pair: int | None
    ttc_s: float | None
    ttc_pair: int | None
    witness_i_m: NDArray[np.float64] | None
    witness_j_m: NDArray[np.float64] | None
    wanted_rad_s: NDArray[np.float64]
    command_rad_s: NDArray[np.float64]
    ttc_command_s: float | None = None
    ttc_command_pair: int | None = None
    check_distance_m: float | None = None
    check_state: str = "off"
    closing_cause: str = ""
    holders: str = ""
    mode: str = "run"
    arms: dict[str, ArmRecord] = field(default_factory=dict)
