"""Colours of figures and viewer, once: an arm keeps its colour wherever it is drawn."""

from __future__ import annotations

Rgb = tuple[int, int, int]

ARM_COLOURS: tuple[Rgb, ...] = (
    (0, 114, 178),
    (230, 120, 0),
    (0, 158, 115),
    (170, 90, 160),
)
"""In the order of the trace's arms, repeated if there are more. Chosen after Okabe and Ito's set,
which people with colour-blindness can tell apart, darkened where thin lines would be faint."""

MEASURED: Rgb = (20, 130, 150)
"""Curves must be told from the ground on white paper and in a dark viewer alike."""
COMMANDED: Rgb = (150, 90, 200)
LIMIT: Rgb = (200, 40, 40)
DANGER: Rgb = (235, 70, 70)
CLOSEST: Rgb = (240, 220, 80)

MODE_COLOURS: dict[str, Rgb] = {
    "run": (90, 190, 110),
    "scale": (240, 200, 60),
    "self_motion": (110, 170, 240),
    "yield": (255, 150, 50),
    "hold": (150, 150, 150),
    "halt": (235, 70, 70),
    "stop": (235, 70, 70),
}
"""Rungs from free to stopped; an unknown one is drawn in `OTHER_MODE`."""
OTHER_MODE: Rgb = (190, 190, 200)


def arm_colour(index: int) -> Rgb:
    """Colour of the arm at this place in the trace's list of arms."""
    return ARM_COLOURS[index % len(ARM_COLOURS)]


def unit_rgb(colour: Rgb) -> tuple[float, float, float]:
    """The colour as three numbers from 0 to 1."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255
