"""Look for the variation of a scenario that breaks the controller: `workcell falsify`.

    search   differential evolution over the unit cube that [vary] spans, worst score first
    shrink   every key that need not differ from the file goes back to it, then the run is cut short
    write    the case as a scenario whose [expect] states the law it breaks

A score measures how far a run is from breaking its law and goes below zero where it does, so the
search has something to follow before it finds a failure. Generations are scored as a whole, which
makes the search the same on any number of workers. Nothing found is no proof: N runs, none failed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.scenario import Bound, Scenario
from workcell.study import workers
from workcell.study.outcome import Outcome
from workcell.study.sweep import make_run
from workcell.study.vary import Variations

Target = Literal["distance", "ttc", "tool_error", "impasse"]

TOOL_ERROR_LIMIT_M = 0.002
"""What counts as a disturbed tool unless asked otherwise: the accuracy to which paths are found within reach."""
TTC_SLACK = 1e-3
"""Share of t_min that a commanded time to collision may be short: the rounding of solver and factor."""
REFUSED = 1e3
"""Score of a variation that cannot be run: worse for the search than any that can."""
UNKNOWN_M = 1.0
"""Score where no support arm's motion closed any pair below the judge's ceiling: any length beyond it."""
TOUCH_M = 1e-9
"""A touch scores below zero however shallow."""
POPULATION = 16
"""Members of a generation; chosen as a few for each of the handful of keys that matter, so that a
hundred runs are six generations."""
GENERATION_SEED = 0xFA15
"""Keeps the search apart from sweeps of the same seed; any fixed number does."""
JOURNAL_FILE = "tried.jsonl"
CASE_FILE = "case.toml"
SHORTEST_SHARE = 0.1
"""Of the duration; a run is not cut shorter."""


@dataclass(frozen=True)
class Case:
    """The worst that a search has found."""

    target: str
    """What was looked for."""
    fails: bool
    """Whether it breaks its law."""
    score: float
    """Below zero where it does; in the unit of the law."""
    values: dict[str, Any]
    """The keys in which it differs from the scenario file."""
    scenario: Scenario
    """As a scenario of its own; with the law as its expectation if it fails."""
    outcome: Outcome
    """What came of it."""
    tried: int
    """Runs made to find and to shrink it."""


def falsify(
    variations: Variations,
    target: Target,
    out: Path,
    executor: Executor,
    *,
    runs: int,
    seed: int,
    limit: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Case:
    """Search, shrink and write down the worst case.

    Args:
        variations: Of the scenario; their ranges are the space that is searched.
        target: `distance`: smallest distance that a support arm's own motion closes, a contact fails.
            `ttc`: smallest commanded time to collision, below t_min fails. `tool_error`: of a
            priority arm. `impasse`: jobs undone and no progress.
        out: Folder for tried.jsonl, case.toml and the case's run folder `case/`.
        executor: Who makes the runs.
        runs: Of the search, rounded down to whole generations; shrinking takes a few more.
        seed: Of the search.
        limit: In place of the law's own: m for distance and tool_error, s for ttc.
        progress: Called with (runs made, runs of the search).

    Raises:
        InputError: nothing can be searched, or no variation could be run.
    """
    if runs < 2 * POPULATION:
        raise InputError(f"--runs {runs}: allowed is {2 * POPULATION} or more, two generations")
    if not variations.keys:
        raise InputError("the scenario has no [vary] table: nothing to search")
    out.mkdir(parents=True, exist_ok=True)
    law = Law(target, limit)
    with (out / JOURNAL_FILE).open("w", encoding="utf-8", buffering=1) as journal:
        trials = _Trials(variations, law, executor, journal.write)
        worst = _search(trials, runs, seed, progress)
        values, outcome = worst
        scenario = variations.scenario(values)
        fails = law.score(outcome, scenario) < 0.0
        if fails:
            values, scenario, outcome = _shrink(trials, values, outcome)
    content = scenario.model_dump(mode="json") | {
        "name": f"{scenario.name}_{target}",
        "description": f"found by falsify, {target}: {law.describe(outcome, scenario)}",
    }
    case = scenario_file.validate(content, None)
    if fails:
        case = case.model_copy(update={"expect": law.expectation(case)})
    (out / CASE_FILE).write_text(case.to_toml(), encoding="utf-8")
    runner.run(case, out / "case")
    score = law.score(outcome, scenario)
    return Case(target, fails, score, values, case, outcome, trials.count)


@dataclass(frozen=True)
class Law:
    """What must hold in every run, as a number that is negative where it does not."""

    target: Target
    """Which law."""
    limit: float | None
    """In place of its own limit."""

    def score(self, row: Outcome, scenario: Scenario) -> float:
        """How far the run is from breaking the law; smaller is worse."""
        if row.status not in ("ran", "fault"):
            return REFUSED
        if self.target == "distance":
            if row.contact_cause in ("support", "both"):
                return min(row.smallest_support_m or 0.0, -TOUCH_M)
            return (UNKNOWN_M if row.smallest_support_m is None else row.smallest_support_m) - (
                self.limit or 0.0
            )
        if self.target == "ttc":
            bound = (
                scenario.control.t_min_s * (1.0 - TTC_SLACK) if self.limit is None else self.limit
            )
            shortest = row.smallest_ttc_command_own_s
            return bound if shortest is None else shortest - bound
        if self.target == "tool_error":
            return (TOOL_ERROR_LIMIT_M if self.limit is None else self.limit) - (
                row.tool_error_m or 0.0
            )
        # Late is towards never: the search follows the time at which the jobs were done.
        spare_s = scenario.simulation.duration_s - (row.done_s or scenario.simulation.duration_s)
        return -1.0 if row.impasse else spare_s

    def describe(self, row: Outcome, scenario: Scenario) -> str:
        """The result in a few words."""
        return {
            "distance": f"a support arm's motion closed to {_shown(row.smallest_support_m, 'm')}, contact: {row.contact_cause or 'none'}",
            "ttc": f"commanded time to collision {_shown(row.smallest_ttc_command_own_s, 's')} at t_min {scenario.control.t_min_s:.3g} s",
            "tool_error": f"priority tool off by {_shown(row.tool_error_m, 'm')}",
            "impasse": "stood with jobs undone"
            if row.impasse
            else f"done at {_shown(row.done_s, 's')}",
        }[self.target]

    def expectation(self, scenario: Scenario) -> dict[str, Bound]:
        """The law as bounds on the summary of a run."""
        if self.target == "distance":
            return {"contact": Bound(equals=False)}
        if self.target == "ttc":
            bound = (
                scenario.control.t_min_s * (1.0 - TTC_SLACK) if self.limit is None else self.limit
            )
            return {"smallest_ttc_command_own_s": Bound(min=bound)}
        if self.target == "tool_error":
            bound = TOOL_ERROR_LIMIT_M if self.limit is None else self.limit
            return {
                f"{a.name}.max_tool_error_m": Bound(max=bound) for a in scenario.arm if not a.job
            }
        duration_s = scenario.simulation.duration_s
        return {f"{a.name}.path_done_s": Bound(max=duration_s) for a in scenario.arm if a.job}


class _Trials:
    """Makes runs and remembers how many."""

    def __init__(
        self,
        variations: Variations,
        law: Law,
        executor: Executor,
        write: Callable[[str], object],
    ):
        self.variations, self.law, self.count = variations, law, 0
        self._executor, self._write = executor, write

    def make(
        self, batch: Iterable[tuple[dict[str, Any], Scenario | None]]
    ) -> Iterator[tuple[dict[str, Any], Scenario | None, Outcome, float]]:
        """Runs of a batch, in its order: values, scenario, outcome, score."""
        submitted = []
        for values, scenario in batch:
            future = self._executor.submit(make_run, scenario, self.count, "", "", False)
            submitted.append((values, scenario, future))
            self.count += 1
        wait([future for *_, future in submitted])
        for values, scenario, future in submitted:
            error = future.exception()
            if error is not None and workers.death(error) is None:
                raise error
            died = Outcome(self.count, "", "died", reason=str(error))
            outcome = died if error is not None else future.result().outcome
            if outcome.status == "interrupted":
                raise KeyboardInterrupt
            score = REFUSED if scenario is None else self.law.score(outcome, scenario)
            row = {"score": score, "values": values, **asdict(outcome)}
            self._write(json.dumps(row) + "\n")
            yield values, scenario, outcome, score

    def concrete(self, values: dict[str, Any]) -> Scenario | None:
        """The scenario with these values; None where they do not go together."""
        try:
            return self.variations.scenario(values)
        except InputError:
            return None


def _search(
    trials: _Trials, runs: int, seed: int, progress: Callable[[int, int], None] | None
) -> tuple[dict[str, Any], Outcome]:
    """Differential evolution; returns values and outcome of the worst run."""
    worst: tuple[float, dict[str, Any], Outcome] | None = None
    rng = np.random.default_rng([seed, GENERATION_SEED])

    def evaluate(_: object, points: Iterable[NDArray[np.float64]]) -> list[float]:
        nonlocal worst
        batch = [trials.variations.at(np.asarray(point)) for point in points]
        scores = []
        for values, _scenario, outcome, score in trials.make(
            (values, trials.concrete(values)) for values in batch
        ):
            scores.append(score)
            if worst is None or score < worst[0]:
                worst = score, values, outcome
        if progress:
            progress(trials.count, runs)
        return scores

    width = trials.variations.width
    # As a mapping, since the stubs of scipy know neither of the two kinds of argument marked here.
    options: dict[str, Any] = {
        "init": rng.random((POPULATION, width)),  # an array of members
        "workers": evaluate,  # a map over the members of a generation
        "updating": "deferred",
        "maxiter": runs // POPULATION - 1,
        "tol": 0.0,
        "rng": rng,
        "polish": False,
    }
    # The function itself is never called: a generation is scored as a whole, by `evaluate`.
    differential_evolution(lambda point: 0.0, [(0.0, 1.0)] * width, **options)
    if worst is None or worst[0] >= REFUSED:
        raise InputError("none of the variations tried could be run; narrow [vary]")
    return worst[1], worst[2]


def _shrink(
    trials: _Trials, values: dict[str, Any], outcome: Outcome
) -> tuple[dict[str, Any], Scenario, Outcome]:
    """Bring a failing case nearer to the file as long as it fails: fewer keys, then less time."""
    nominal = trials.variations.nominal()
    kept = dict(values)
    scenario = trials.variations.scenario(kept)
    for key in values:
        fewer = {k: v for k, v in kept.items() if k != key}
        # Left out is as in the file.
        candidate = trials.concrete({**{key: nominal[key]}, **fewer})
        for _, _, after, score in trials.make([(fewer, candidate)]):
            if candidate is not None and score < 0.0:
                kept, scenario, outcome = fewer, candidate, after
    shortest_s = SHORTEST_SHARE * scenario.simulation.duration_s
    while scenario.simulation.duration_s > 2.0 * shortest_s:
        half = scenario.simulation.model_copy(
            update={"duration_s": scenario.simulation.duration_s / 2.0}
        )
        candidate = scenario.model_copy(update={"simulation": half})
        [(_, _, after, score)] = trials.make([(kept, candidate)])
        if score >= 0.0:
            break
        scenario, outcome = candidate, after
    return kept, scenario, outcome


def _shown(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:.4g} {unit}"
