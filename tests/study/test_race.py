"""A race: the same variations for every strategy, and one row each."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from workcell.errors import InputError
from workcell.study import race, report, sweep


class InTurn(ThreadPoolExecutor):
    """Runs in this process, one after another."""

    def submit(self, fn, *args, **kwargs):
        future = super().submit(lambda: None)
        future.result()
        done = type(future)()
        done.set_result(fn(*args, **kwargs))
        return done


def test_strategies_drive_the_same_variations_and_get_a_row_each(tmp_path):
    page = race.race(
        ["planar_crossing"],
        ["ttc", "paper_scaling"],
        tmp_path,
        InTurn(1),
        runs=1,
        seed=3,
        ahead=2,
        overrides=["simulation.duration_s=5.0"],
    )
    rows = report.read(tmp_path / "planar_crossing")
    assert [row["setting"] for row in rows] == [
        "control.strategy=ttc",
        "control.strategy=paper_scaling",
    ]
    varied = [{k: v for k, v in row.items() if k.startswith("vary.")} for row in rows]
    assert varied[0] == varied[1]
    text = page.read_text()
    assert "| `ttc` |" in text
    assert "| `paper_scaling` |" in text
    assert rows[0]["deviation_m"] is not None
    assert rows[0]["jerk_rms_rad_s3"] > 0.0


def test_a_race_needs_two_strategies_that_exist(tmp_path):
    with pytest.raises(InputError, match="needs at least two"):
        race.race(["planar_crossing"], ["ttc"], tmp_path, InTurn(1), runs=1, seed=0, ahead=1)
    with pytest.raises(InputError, match="unknown strategy 'no'"):
        race.race(["planar_crossing"], ["ttc", "no"], tmp_path, InTurn(1), runs=1, seed=0, ahead=1)


def test_a_disturbed_race_is_disturbed_although_the_scenario_varies_noise_and_latency():
    """What was drawn overwrote what was set: every row was that of the undisturbed race."""
    drawn = [
        sweep.plan("planar_crossing", runs=1, seed=3, overrides=(*race.SETTINGS, *more))
        for more in ((), race.DISTURBED)
    ]
    (plain,), (disturbed,) = (list(plan.variations.values()) for plan in drawn)
    values = disturbed.draw(3, 0)
    simulation = disturbed.scenario(values).simulation
    assert simulation.latency_ticks == 2
    assert simulation.position_noise_rad == 0.001
    assert simulation.velocity_noise_rad_s == 0.01
    # All else is drawn as in the undisturbed race.
    assert len(values) > 5
    assert values.items() <= plain.draw(3, 0).items()
