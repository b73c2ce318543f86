"""A run drawn over its reference: one panel for each of the quantities that differ most tellingly.

Comes in: the two excerpts and their comparison. Goes out: a picture with the reference as a broad
grey line (or dots, where only some ticks are known), the run as a thin dark one, and a mark where they
part.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from workcell.regression.agreement import TTC_SIGNALS, Difference
from workcell.regression.compare import Comparison
from workcell.regression.excerpt import Excerpt, condensed
from workcell.view.limits import TTC_CAP_IN_T_MIN
from workcell.view.palette import COMMANDED, DANGER, unit_rgb

PANELS = 6
"""Quantities drawn; beyond it they would be too low to read."""
SPARSE = 0.5
"""Below this part of known ticks a reference is drawn as dots."""


def draw(run: Excerpt, reference: Excerpt, result: Comparison, out_png: Path) -> Path:
    """Draw the first quantities that differ; two that agree are drawn in the usual ones.

    Returns:
        The path written.
    """
    drawn = [d for d in result.differences if d.largest is not None][:PANELS]
    names = [d.column for d in drawn] or [n for n in ("ttc_s", "qpos") if n in reference.values]
    figure, axes = plt.subplots(
        len(names), 1, sharex=True, squeeze=False, figsize=(9.0, 1.2 + 1.9 * len(names))
    )
    period_s = float(reference.identity.settings.get("simulation", {}).get("period_s", 1.0))
    by_name = {d.column: d for d in drawn}
    for axis, name in zip(axes[:, 0], names, strict=True):
        entry = by_name[name].entry if name in by_name else None
        mine, theirs = series(run, reference, name, entry)
        sparse = len(reference.ticks) < SPARSE * reference.length
        axis.plot(
            reference.ticks * period_s, theirs, "o" if sparse else "-",
            color="0.7", linewidth=4, markersize=5, label="reference",
        )  # fmt: skip
        axis.plot(run.ticks * period_s, mine, color=unit_rgb(COMMANDED), linewidth=1, label="run")
        if name in by_name:
            axis.axvline(by_name[name].first_time_s, color=unit_rgb(DANGER), linewidth=1)
        axis.set_ylabel(_label(name, by_name.get(name)), fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0, 0].set_title(result.headline(), fontsize=9)
    axes[0, 0].legend(fontsize=8, loc="upper right")
    axes[-1, 0].set_xlabel("time [s]", fontsize=8)
    figure.tight_layout()
    figure.savefig(out_png, dpi=110, metadata={"Software": None})
    plt.close(figure)
    return out_png


def series(
    run: Excerpt, reference: Excerpt, name: str, entry: int | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One curve of each: a scalar, or an entry of a vector (the first where none is named)."""
    column, _, condensation = name.partition("|")
    mine, theirs = run.values[column], reference.values[name]
    if condensation:
        mine = condensed(mine)[condensation]
    if mine.ndim > 1:
        mine, theirs = mine[:, entry or 0], theirs[:, entry or 0]
    mine, theirs = mine.astype(float), theirs.astype(float)
    if name in TTC_SIGNALS:
        # Beyond it nothing is about to happen, and the curves would be flat below.
        cap_s = TTC_CAP_IN_T_MIN * reference.identity.settings["control"]["t_min_s"]
        mine, theirs = np.minimum(mine, cap_s), np.minimum(theirs, cap_s)
    return mine, theirs


def _label(name: str, difference: Difference | None) -> str:
    if difference is None or difference.entry is None:
        return name
    return f"{name}[{difference.entry}]"
