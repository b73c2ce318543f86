"""May it go on: the final check on high-resolution geometry, in a process of its own.

`FinalCheck` asks, `HaltLatch` and `brake` act on the verdict; docs/final_check.md explains.
"""

from workcell.guard.halt import HaltLatch, HaltReport, brake, braking_time_s
from workcell.guard.monitor import FinalCheck
from workcell.guard.settings import CheckSettings, Exemption
from workcell.guard.verdict import CheckState, Verdict

__all__ = [
    "CheckSettings",
    "CheckState",
    "Exemption",
    "FinalCheck",
    "HaltLatch",
    "HaltReport",
    "Verdict",
    "brake",
    "braking_time_s",
]
