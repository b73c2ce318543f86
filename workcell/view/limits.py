"""Where plots end and lines turn red: the same in figures, films, reports and recordings."""

from __future__ import annotations

TTC_CAP_IN_T_MIN = 5.0
"""Plots end at this multiple of t_min: beyond it nothing acts, and curves jump to infinity."""
DANGER_MARGIN = 1.05
"""The witness line is red below this multiple of t_min: scaling holds t at t_min, not below it."""
FALLBACK_T_MIN_S = 1.0
"""Only scales the axis of a trace that carries no t_min."""
