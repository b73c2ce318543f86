"""An operator of your own: a surgeon's hand that goes round, and the nurse that works around it.

Any object with `setpoint(time_s)` may drive a priority arm. To name one in scenario files, make it a plug-in.
"""

import numpy as np

from workcell import Session
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint


class Ellipse:
    """Begins where it is put; position and velocity go together, so that the arm need not guess."""

    def __init__(self, position_m: np.ndarray, wxyz: np.ndarray, period_s: float = 6.0):
        self.position_m, self.wxyz, self.w = position_m, wxyz, 2.0 * np.pi / period_s

    def setpoint(self, time_s: float) -> Setpoint:
        a, w = self.w * time_s, self.w
        way_m = np.array([0.08 * (1 - np.cos(a)), 0.05 * np.sin(a), 0.0])
        speed_m_s = np.array([0.08 * w * np.sin(a), 0.05 * w * np.cos(a), 0.0])
        target = Target(self.position_m + way_m, self.wxyz, speed_m_s, np.zeros(3))
        return Setpoint(target, "ellipse")


with Session("planar_crossing", ["check.enabled=false"]) as session:
    start = session.step().arms["surgeon"]
    session.drive("surgeon", Ellipse(start.tool_position_m, start.tool_wxyz))
    rows = []
    while not session.done:
        record = session.step()
        rows.append((record.arms["surgeon"].tool_error_m, record.pair_distance_m.min()))
    print(f"tool within {max(error for error, _ in rows[2:]):.4f} m of the hand")
    print(f"nearest {min(nearest for _, nearest in rows):.4f} m; nurse: {record.arms['nurse'].job}")
