"""A piecewise cubic curve, looked up at one place at a time.

SciPy makes the curve and is quick at many places together; for a single one nearly all of its time goes
into taking the question in. Here the same polynomials are plain floats, and bisection finds the piece.
"""

from __future__ import annotations

from bisect import bisect_right

from scipy.interpolate import PPoly


class Cubic:
    """The polynomials of a curve of one or more coordinates, clamped to its ends.

    Args:
        curve: Of order 3, with K knots and C coordinates, or none for a single one.
    """

    def __init__(self, curve: PPoly):
        self._knots: list[float] = curve.x.tolist()
        coefficients = curve.c.reshape(4, len(self._knots) - 1, -1)
        self._pieces: list[list[list[float]]] = coefficients.transpose(1, 2, 0).tolist()
        """Of every piece, for every coordinate: the four coefficients, highest power first, of the way from its knot."""
        self.end = self._knots[-1]
        """The last knot."""

    def value(self, at: float) -> list[float]:
        """(C,) the curve at a place."""
        t, piece = self._piece(at)
        return [((a * t + b) * t + c) * t + d for a, b, c, d in piece]

    def value_and_slope(self, at: float) -> tuple[list[float], list[float]]:
        """(C,) the curve at a place and (C,) its derivative there; beyond an end, those of the end."""
        t, piece = self._piece(at)
        value = [((a * t + b) * t + c) * t + d for a, b, c, d in piece]
        slope = [(3.0 * a * t + 2.0 * b) * t + c for a, b, c, _ in piece]
        return value, slope

    def _piece(self, at: float) -> tuple[float, list[list[float]]]:
        knots = self._knots
        # The last knot begins no piece.
        k = bisect_right(knots, at, 1, len(knots) - 1) - 1
        return min(max(at, knots[0]), knots[-1]) - knots[k], self._pieces[k]
