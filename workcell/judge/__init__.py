"""The independent judge of a run: what really happened, and whose motion it was.

It sees the plant's states and the scene file, and nothing of what the controller or the final check made of
them: its distances are MuJoCo's, its velocities those of MuJoCo's bodies. It shares no code with either.

    scene      whose each geom is, which pairs are judged
    watch      distances of many pairs over many poses, measured only where they can matter
    contact    the first touch of the high-resolution geometry, and whose motion closed the gap
    approach   times to collision of the watched capsules, blamed pair by pair
    motion     speeds of points, deviation from the path, jerk
    verdict    all of it for a run folder
    table      the verdict for people
"""

from workcell.judge.contact import Contact, ContactWatch
from workcell.judge.scene import JudgedScene
from workcell.judge.verdict import Verdict, judge_run, judge_trace

__all__ = ["Contact", "ContactWatch", "JudgedScene", "Verdict", "judge_run", "judge_trace"]
