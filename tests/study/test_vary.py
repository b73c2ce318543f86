"""Draws are fixed by seed, run and key alone, stay in their ranges, and cannot ask for nonsense."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests import cells
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.scenario import Variation
from workcell.study.vary import Variations, VariedKey

VARY: dict[str, Any] = {
    "control.t_min_s": {"min": 0.8, "max": 1.2},
    "arm.nurse.home_rad": {"plus_minus": 0.1},
    "arm.nurse.job.0.dwell_s": {"mean": 0.5, "sd": 0.2, "min": 0.1, "max": 0.9},
    "control.variant": {"choices": ["relative", "static"]},
    "simulation.seed": {"min": 0, "max": 9},
    "simulation.position_noise_rad": {"min": 1e-6, "max": 1e-3, "log": True},
}


def variations(folder: Path, vary: dict[str, Any], **content: Any) -> Variations:
    return Variations(cells.load(folder, {**cells.duet(), "vary": vary, **content}))


def one(law: dict[str, Any], nominal: Any = 0.0) -> VariedKey:
    return VariedKey("key", Variation.model_validate(law), nominal)


def test_a_draw_depends_on_seed_run_and_key_alone(tmp_path: Path):
    all_of_them = variations(tmp_path, VARY)
    drawn = all_of_them.draw(5, 12)
    assert list(drawn) == list(VARY)
    for key, law in VARY.items():
        assert variations(tmp_path, {key: law}).draw(5, 12) == {key: drawn[key]}
    assert all_of_them.draw(5, 13) != drawn != all_of_them.draw(6, 12)


def test_a_variation_is_a_concrete_scenario_that_reads_back(tmp_path: Path):
    what = variations(tmp_path, VARY, expect={"contact": False})
    drawn = what.draw(0, 0)
    concrete = what.scenario(drawn)
    assert concrete.control.t_min_s == drawn["control.t_min_s"]
    nurse = next(arm for arm in concrete.arm if arm.name == "nurse")
    assert list(nurse.home_rad) == drawn["arm.nurse.home_rad"]
    assert nurse.job[0].dwell_s == drawn["arm.nurse.job.0.dwell_s"]  # type: ignore[union-attr]
    assert not concrete.vary
    assert not concrete.expect
    path = tmp_path / "again.toml"
    path.write_text(concrete.to_toml(), encoding="utf-8")
    assert scenario_file.load(path).digest() == concrete.digest()


def test_what_is_varied_does_not_change_what_a_run_of_the_file_is(tmp_path: Path):
    plain = cells.load(tmp_path, cells.duet())
    assert cells.load(tmp_path, {**cells.duet(), "vary": VARY}).digest() == plain.digest()


@given(
    # A scenario refuses numbers so small that they have lost digits.
    st.floats(-1e6, 1e6, allow_subnormal=False),
    st.floats(1e-6, 1e6),
    st.floats(0.0, 1.0, exclude_max=True),
)
def test_a_range_is_not_left(low: float, width: float, u: float):
    value = one({"min": low, "max": low + width}).value(np.array([u]))
    assert low <= value <= low + width


def test_each_law_has_the_distribution_it_names():
    u = (np.arange(2000) + 0.5) / 2000

    def drawn(law: dict[str, Any], nominal: Any = 0.0) -> np.ndarray:
        return np.array([one(law, nominal).value(np.array([x])) for x in u])

    laws = [
        ({"min": 2.0, "max": 5.0}, stats.uniform(2.0, 3.0)),
        ({"min": 1e-4, "max": 1e-1, "log": True}, stats.loguniform(1e-4, 1e-1)),
        ({"mean": 1.0, "sd": 0.3}, stats.norm(1.0, 0.3)),
        (
            {"mean": 1.0, "sd": 0.3, "min": 0.9, "max": 2.0},
            stats.truncnorm(-1 / 3, 10 / 3, 1.0, 0.3),
        ),
    ]
    for law, reference in laws:
        assert drawn(law) == pytest.approx(reference.ppf(u), rel=1e-9), law
    assert drawn({"plus_minus": 0.5}, 2.0) == pytest.approx(1.5 + u, rel=1e-12)
    whole = drawn({"min": 0, "max": 4})
    assert [np.sum(whole == k) for k in range(5)] == [400] * 5
    chosen = drawn({"choices": ["a", "b"]})
    assert [np.sum(chosen == k) for k in "ab"] == [1000] * 2


def test_the_unit_cube_covers_the_same_space_as_the_draws(tmp_path: Path):
    what = variations(tmp_path, VARY)
    assert what.width == 1 + 3 + 1 + 1 + 1 + 1
    low, high = what.at(np.zeros(what.width)), what.at(np.ones(what.width))
    assert low["control.t_min_s"] == 0.8
    assert high["control.t_min_s"] == pytest.approx(1.2)
    assert (low["simulation.seed"], high["simulation.seed"]) == (0, 9)
    assert (low["control.variant"], high["control.variant"]) == ("relative", "static")
    home = np.array(what.nominal()["arm.nurse.home_rad"])
    assert low["arm.nurse.home_rad"] == pytest.approx(home - 0.1)


@pytest.mark.parametrize(
    ("key", "law", "message"),
    [
        ("control.t_min", {"min": 0.8, "max": 1.2}, r"no key 't_min' here; allowed: t_min_s, "),
        (
            "arm.doctor.home_rad",
            {"plus_minus": 0.1},
            "no key 'doctor' here; allowed: 0, 1, surgeon, nurse",
        ),
        (
            "control.t_min_s.low",
            {"plus_minus": 0.1},
            "no key 'low' here; allowed: nothing: this is a value",
        ),
        (
            "control.t_min_s",
            {"min": -0.5, "max": 1.2},
            r'vary."control.t_min_s": control.t_min_s = -0.5',
        ),
        ("control.variant", {"choices": ["relative", "some"]}, "control.variant = 'some'"),
        ("simulation.latency_ticks", {"min": 0.0, "max": 2.5}, "simulation.latency_ticks = 2.4"),
        (
            "control.variant",
            {"plus_minus": 0.1},
            "'relative'; a number or a list of numbers is needed",
        ),
        ("control.t_min_s", {"min": 1.2, "max": 0.8}, "min must be below max"),
        ("control.t_min_s", {"min": 0.8}, "allowed is exactly one of"),
        (
            "control.t_min_s",
            {"min": 0.8, "max": 1.0, "choices": [1.0]},
            "allowed is exactly one of",
        ),
        (
            "simulation.position_noise_rad",
            {"min": 0.0, "max": 1.0, "log": True},
            "needs min above 0",
        ),
        ("vary.x", {"plus_minus": 0.1}, "no key 'vary' here"),
    ],
)
def test_what_cannot_be_varied_is_refused_by_key(
    tmp_path: Path, key: str, law: dict[str, Any], message: str
):
    with pytest.raises(InputError) as refusal:
        variations(tmp_path, {key: law})
    text = str(refusal.value)
    for part in ("vary", key, message):
        assert part in text


def test_all_refusals_come_at_once(tmp_path: Path):
    with pytest.raises(InputError) as refusal:
        variations(
            tmp_path,
            {"nothing.a": {"plus_minus": 1.0}, "control.t_min_s": {"min": -1.0, "max": 1.0}},
        )
    assert len(refusal.value.faults) == 2
