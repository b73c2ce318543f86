"""What a number of runs does and does not say about the runs not made.

A rate of k failures in n runs gets its exact (Clopper-Pearson) interval; zero failures thereby
become an upper bound, not a zero. Two settings tried on the same variations are compared by their
paired differences: of numbers with Student's interval of the mean, which only needs enough pairs
for their mean to be near normal; of events with exact intervals of the pairs that disagree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, sem, t

CONFIDENCE = 0.95
"""Of every interval; chosen as what readers expect where nothing else is said."""


@dataclass(frozen=True)
class Rate:
    """How often something happened, and how often it may happen in the long run."""

    count: int
    """Runs in which it happened."""
    runs: int
    """Runs that could show it."""
    low: float
    """Lower end of the two-sided interval; 0 if it never happened."""
    high: float
    """Upper end; for none in n runs the one-sided bound, near 3/n."""

    def __str__(self) -> str:
        if not self.runs:
            return "no runs"
        if self.count == 0:
            return f"0 of {self.runs} (below {percent(self.high)})"
        return f"{self.count} of {self.runs}, {percent(self.count / self.runs)} ({percent(self.low)} to {percent(self.high)})"


@dataclass(frozen=True)
class Difference:
    """A paired difference between two settings, or nothing where there are too few pairs."""

    pairs: int
    """Variations with a value under both settings."""
    mean: float | None
    """Mean of second minus first; None without pairs."""
    low: float | None
    """Lower end of the interval of the mean; None with fewer than two pairs."""
    high: float | None
    """Upper end."""

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.low is not None and self.high is not None and not self.low <= 0.0 <= self.high

    def text(self, factor: float = 1.0) -> str:
        """For people, in another unit; an asterisk where the interval leaves out zero."""
        if self.mean is None:
            return "no pairs"
        if self.low is None or self.high is None:
            return f"{factor * self.mean:+.3g} (one pair)"
        if self.low == self.high == 0.0:
            return "the same in all pairs"
        mark = " *" if self.is_clear else ""
        return f"{factor * self.mean:+.3g} ({factor * self.low:+.3g} to {factor * self.high:+.3g}){mark}"


def rate(count: int, runs: int, confidence: float = CONFIDENCE) -> Rate:
    """The exact interval of a rate.

    Args:
        count: Runs in which it happened, 0 to `runs`.
        runs: Runs made.
        confidence: Of the interval; where none or all of the runs show it, all of the risk is on
            the one side that is open (for none in n: high = 1 - (1 - confidence)^(1/n)).
    """
    if not 0 <= count <= runs:
        raise ValueError(f"count is {count}; it must be between 0 and runs, {runs}")
    if runs == 0:
        return Rate(0, 0, 0.0, 1.0)
    open_side = {0: "less", runs: "greater"}.get(count, "two-sided")
    found = binomtest(count, runs, alternative=open_side).proportion_ci(confidence, method="exact")
    return Rate(count, runs, float(found.low), float(found.high))


def paired(first: ArrayLike, second: ArrayLike, confidence: float = CONFIDENCE) -> Difference:
    """The mean of second - first over the variations in which both have a value.

    Args:
        first, second: (n,) values under two settings, in the same order of variations; NaN where
            a run has none.
        confidence: Of the interval.
    """
    change = np.asarray(second, dtype=float) - np.asarray(first, dtype=float)
    change = change[np.isfinite(change)]
    n = len(change)
    if n == 0:
        return Difference(0, None, None, None)
    mean = float(change.mean())
    if n == 1:
        return Difference(1, mean, None, None)
    error = float(sem(change))
    if error == 0.0:  # the same change in all pairs: no spread to judge by
        return Difference(n, mean, mean, mean)
    low, high = t.interval(confidence, n - 1, loc=mean, scale=error)
    return Difference(n, mean, float(low), float(high))


def paired_events(
    first: ArrayLike, second: ArrayLike, confidence: float = CONFIDENCE
) -> Difference:
    """The difference of two rates, second - first, on the same variations.

    The pairs that show the event under one setting only are two counts; each gets its exact interval
    at half the risk, so that the interval of their difference holds whatever their correlation, and
    pairs that all agree give bounds, not a certainty.

    Args:
        first, second: (n,) whether each variation showed the event.
        confidence: Of the interval.
    """
    before, after = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    n = len(before)
    if n == 0:
        return Difference(0, None, None, None)
    share = 1.0 - (1.0 - confidence) / 2.0
    gained = rate(int(np.sum(after & ~before)), n, share)
    lost = rate(int(np.sum(before & ~after)), n, share)
    mean = (gained.count - lost.count) / n
    return Difference(n, mean, gained.low - lost.high, gained.high - lost.low)


def percent(share: float) -> str:
    """A share for people, small ones with digits enough to see them."""
    return f"{100.0 * share:.3g} %"
