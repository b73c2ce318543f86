"""What a support arm does: a sequence of jobs, each a path with its own clock.

`sequence` runs the jobs in order; `goals` says where a job goes in the surroundings of the moment.
"""

from workcell.motion.jobs.goals import (
    APPROACH_M,
    APPROACH_SIDES,
    HandOver,
    Instrument,
    Meeting,
    Surroundings,
)
from workcell.motion.jobs.sequence import REPLAN_M, REPLAN_S, JobSequence

__all__ = [
    "APPROACH_M",
    "APPROACH_SIDES",
    "REPLAN_M",
    "REPLAN_S",
    "HandOver",
    "Instrument",
    "JobSequence",
    "Meeting",
    "Surroundings",
]
