"""Where a person wants a tool: the wish that mouse, keys and sticks move, and the hand that follows it.

The wish is where the gizmo is. The hand is what is offered to the live operator: it follows the wish,
no faster than a hand moves, and on a leash, so that a wish far away never pulls harder than one nearby:

    hand = the point nearest to the wish with |hand - tool| <= LEASH_M,  |Δhand| <= HAND_M_S dt

and likewise in rotation. A wish that the tool has stopped short of is out of reach: once the person
lets go of it, it comes back to the tool.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell.motion.orientation import rotation_between, turned

Vector = NDArray[np.float64]
Pose = tuple[Vector, Vector]
"""(3,) position in m and (4,) unit quaternion, in the world."""

LEASH_M = 0.25
LEASH_RAD = 1.0
"""Farthest the hand is from the tool; chosen as the way the target needs to reach its full speed and to stop
from it, twice over."""
HAND_M_S = 1.5
HAND_RAD_S = 6.0
"""Fastest motion of the hand; chosen below what the live operator takes for a leap of the stream."""
SHORT_M = 0.03
SHORT_RAD = 0.25
"""A tool that stands this far from its target is short of it; chosen five times the lag of a tool in motion."""
STANDING_M_S = 0.02
SETTLED_S = 0.3
"""A tool this slow for this long has come as near as it can."""


class Marker:
    """One live arm's marker.

    Args:
        position_m, wxyz: The tool's pose at the start.
    """

    def __init__(self, position_m: Vector, wxyz: Vector):
        self.wish: Pose = (np.array(position_m), np.array(wxyz))
        self.hand: Pose = self.wish
        self.held = False
        """Whether the person has the gizmo in the hand."""
        self.clutched = False
        """Whether the clutch is open: the wish moves, and the tool stands."""
        self.out_of_reach = False
        """Whether the tool has stopped short of its target."""
        self._short_s = 0.0

    def place(self, position_m: Vector, wxyz: Vector) -> None:
        """Put the wish somewhere: a drag of the gizmo."""
        self.wish = (np.array(position_m, dtype=float), _unit(np.array(wxyz, dtype=float)))

    def push(self, way_m: Vector, turn_rad: Vector) -> None:
        """Move the wish: keys, buttons, sticks. It stays on the leash of the hand."""
        position, wxyz = self.wish
        position, wxyz = position + way_m, turned(wxyz, turn_rad)
        self.wish = _within(self.hand, (position, wxyz), LEASH_M, LEASH_RAD)

    def clutch(self, is_open: bool) -> None:
        """Open the clutch, or close it: then the wish is where the hand is, and nothing leaps."""
        if self.clutched and not is_open:
            self.wish = self.hand
        self.clutched = is_open

    def follow(self, passed_s: float, tool: Pose, short: bool, speed_m_s: float) -> Pose:
        """The hand, after some time.

        Args:
            passed_s: Since the last call.
            tool: Where the tool is.
            short: Whether the tool is short of its present target.
            speed_m_s: The tool's speed.
        """
        if not self.clutched:
            leashed = _within(tool, self.wish, LEASH_M, LEASH_RAD)
            self.hand = _within(self.hand, leashed, HAND_M_S * passed_s, HAND_RAD_S * passed_s)
        self._short_s = self._short_s + passed_s if short and speed_m_s < STANDING_M_S else 0.0
        if not short:
            self.out_of_reach = False
        elif self._short_s > SETTLED_S:
            self.out_of_reach = True
            if not self.held and not self.clutched:
                # Not to the hand: it is as far out of reach, and an arm does not settle there.
                self.wish = tool
        return self.hand


def is_short(error_m: float, error_rad: float) -> bool:
    """Whether a tool with this error is short of its target."""
    return error_m > SHORT_M or error_rad > SHORT_RAD


def _within(centre: Pose, pose: Pose, most_m: float, most_rad: float) -> Pose:
    """The pose nearest to `pose` within a distance and an angle of `centre`."""
    way = pose[0] - centre[0]
    distance = float(np.linalg.norm(way))
    position = pose[0] if distance <= most_m else centre[0] + way * (most_m / distance)
    turn = rotation_between(centre[1], pose[1])
    angle = float(np.linalg.norm(turn))
    wxyz = pose[1] if angle <= most_rad else turned(centre[1], turn * (most_rad / angle))
    return position, wxyz


def _unit(wxyz: Vector) -> Vector:
    return wxyz / np.linalg.norm(wxyz)
