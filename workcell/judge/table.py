"""The verdict for people: a few lines of text."""

from __future__ import annotations

from workcell.judge.verdict import Approach, ArmVerdict, Verdict


def lines(verdict: Verdict) -> list[tuple[str, str]]:
    """Rows of (what, value), in the order in which they matter."""
    rows = [("states", _states(verdict))]
    if not verdict.contacts:
        rows.append(("contact", "none"))
    for contact in verdict.contacts:
        shares = ", ".join(f"{arm} {v:+.3f} m/s" for arm, v in contact.closing_m_s.items())
        told = f"{' and '.join(contact.pair)} at {contact.time_s:.3f} s, closed by {shares}"
        rows.append((f"contact, {contact.cause}", told))
    rows += [
        ("smallest distance, solids", _distance(verdict.smallest_m, verdict.smallest_pair)),
        ("smallest distance, capsules", _distance(verdict.capsules_m, verdict.capsules_pair)),
        ("smallest time to collision", _approach(verdict.measured)),
        ("the same, commanded", _approach(verdict.commanded)),
    ]
    for name, arm in verdict.arms.items():
        rows += [(f"{name} ({arm.role})", text) for text in _arm(arm)]
    return rows


def _states(verdict: Verdict) -> str:
    seconds = verdict.ticks * verdict.period_s
    told = f"of the {verdict.states}, {verdict.ticks} ticks, {seconds:.2f} s"
    if verdict.states == "belief":
        told += ": this trace is from before the plant's state was logged"
    return told


def _arm(arm: ArmVerdict) -> list[str]:
    told = []
    if arm.own is not None:
        told.append(
            f"own time to collision {_approach(arm.own)}; {arm.short_ticks} ticks below 0.99 t_min, "
            f"{arm.forced_ticks} forced by others"
        )
    motion = arm.motion
    error = "tool error" if arm.role == "priority" else "deviation from path"
    told.append(
        f"{error} {1e3 * motion.target_error_m:.2f} mm, rms {1e3 * motion.target_error_rms_m:.2f} mm"
    )
    fastest = f"fastest point {motion.peak_point_speed_m_s:.3f} m/s"
    if motion.capped_ticks is not None:
        fastest += f", {motion.capped_ticks} ticks above the cap"
    told.append(fastest)
    if motion.jerk_rms_rad_s3 is not None:
        told.append(
            f"joint jerk rms {motion.jerk_rms_rad_s3:.3g} rad/s³, peak {motion.jerk_peak_rad_s3:.3g} rad/s³"
        )
    return told


def _approach(found: Approach) -> str:
    if found.ttc_s is None or found.pair is None:
        return "nothing closed"
    return f"{found.ttc_s:.4f} s at {found.time_s:.3f} s, {' and '.join(found.pair)}"


def _distance(distance_m: float | None, pair: tuple[str, str] | None) -> str:
    if distance_m is None or pair is None:
        return "no pairs"
    return f"{1e3 * distance_m:.2f} mm, {' and '.join(pair)}"
