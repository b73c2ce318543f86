"""From the checker's answer to a verdict, believing nothing that contradicts itself.

The checker decides; this side repeats the decision from the numbers it was given. An answer
whose numbers and verdict disagree is not a clear, it is nonsense.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from workcell.guard.settings import CheckSettings
from workcell.guard.shared_memory import Answer
from workcell.guard.verdict import CheckState, Verdict

_NO_PAIR = (-1, -1)


def judge(
    answer: Answer,
    settings: CheckSettings,
    *,
    pieces: Sequence[str],
    missing: Sequence[str],
    expired: Sequence[str],
    tick: int,
) -> Verdict:
    """Turns an answer into a verdict.

    Args:
        answer: From the checker.
        settings: What it was told.
        pieces: Names of the pieces, in the checker's order.
        missing: Bodies and arms without geometry; with any, there is no `clear`.
        expired: Exemptions that ran out of time, for the reason of a halt.
        tick: The current tick.
    """
    fault = contradiction(answer, settings, len(pieces))
    state, pair, reason = CheckState.CLEAR, answer.pair, f"nearest {answer.distance_m:.4f} m"
    if fault is not None:
        state, pair, reason = CheckState.NONSENSE, _NO_PAIR, fault
    elif answer.distance_m <= settings.d_min_m:
        state = CheckState.HALT
        reason = f"{answer.distance_m:.4f} m is not above d_min {settings.d_min_m} m"
        if expired:
            reason += f" (expired: {', '.join(expired)})"
    elif answer.halt:
        exemption = settings.exemptions[answer.exemption_fault]
        state, pair = CheckState.HALT, answer.exempt_pair
        reason = (
            f"exemption '{exemption.name}' at {answer.exempt_distance_m:.4f} m: not above "
            f"{exemption.d_min_m} m, or closing faster than {exemption.max_closing_m_s} m/s"
        )
    elif missing:
        state, reason = CheckState.NO_GEOMETRY, missing_reason(missing)
    believed = fault is None
    exempt_m = answer.exempt_distance_m if math.isfinite(answer.exempt_distance_m) else None
    return Verdict(
        state=state,
        sequence=answer.sequence,
        tick=answer.tick,
        age_ticks=tick - answer.tick,
        distance_m=answer.distance_m if believed else None,
        pair=None if pair == _NO_PAIR else (pieces[pair[0]], pieces[pair[1]]),
        exempt_distance_m=exempt_m if believed else None,
        reason=reason,
    )


def contradiction(answer: Answer, settings: CheckSettings, n_pieces: int) -> str | None:
    """What makes an answer unbelievable, or None."""
    if not math.isfinite(answer.distance_m) or answer.distance_m > settings.ceiling_m:
        return f"the answer's distance is {answer.distance_m}, the ceiling {settings.ceiling_m} m"
    if math.isnan(answer.exempt_distance_m):
        return "the answer's exempt distance is not a number"
    for pair in (answer.pair, answer.exempt_pair):
        if pair != _NO_PAIR and not (0 <= pair[0] < pair[1] < n_pieces):
            return f"the answer names the pair {pair} of {n_pieces} pieces"
    if not -1 <= answer.exemption_fault < len(settings.exemptions):
        return f"the answer names exemption {answer.exemption_fault}"
    too_near = answer.distance_m <= settings.d_min_m
    if answer.halt != (too_near or answer.exemption_fault >= 0):
        says = "halt" if answer.halt else "clear"
        return f"the answer says {says} at {answer.distance_m} m"
    if answer.distance_m < settings.ceiling_m and answer.pair == _NO_PAIR:
        return f"the answer names no pair at {answer.distance_m} m"
    return None


def missing_reason(missing: Sequence[str]) -> str:
    """Why a check of an arm without geometry is not a pass."""
    return "no high-resolution geometry for " + ", ".join(missing)
