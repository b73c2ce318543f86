import dataclasses
import logging

import numpy as np
import pytest
from matplotlib.image import imread

from workcell.errors import InputError, TraceError
from workcell.view import stills
from workcell.view.figures import paper_figures
from workcell.view.instants import time_stamps


@pytest.fixture(scope="module")
def drawn(run, tmp_path_factory):
    return paper_figures(run.trace, run.scene, tmp_path_factory.mktemp("figures"))


def test_the_figures_are_there(drawn):
    names = {path.name for path in drawn}
    assert names >= {"figure3.png", "figure4.png", "overview.png"}
    for path in drawn:
        picture = imread(path)
        assert picture.shape[1] > 1000
        assert picture[..., :3].std() > 0.05, "something is drawn"
    assert not list(drawn[0].parent.glob("*.part"))


def test_the_cell_is_seen_from_one_place(run):
    qpos = run.trace["qpos"][[0, 600, 0]]
    try:
        first, second, third = stills.render(run.scene, qpos, width=200, height=150)
    except stills.NoPictures as error:
        pytest.skip(str(error))
    assert (first == third).all(), "the same position gives the same picture"
    differs = (first != second).any(axis=2)
    assert 0 < differs.mean() < 0.5, "one arm moved, camera and the rest stand"


def test_a_repeat_gives_the_same_bytes_and_without_opengl_no_cell(
    run, drawn, tmp_path, monkeypatch, caplog
):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with caplog.at_level(logging.WARNING):
        written = paper_figures(run.trace, run.scene, tmp_path)
    assert [path.name for path in written] == ["figure3.png", "figure4.png", "overview.png"]
    before = {path.name: path.read_bytes() for path in drawn}
    assert all(path.read_bytes() == before[path.name] for path in written)
    assert "figure5 is left out: MuJoCo cannot draw here (disable:" in caplog.text


def test_figures_for_print_are_vectors_and_the_same_again(run, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    written = paper_figures(run.trace, run.scene, tmp_path / "a", formats=["pdf", "svg"])
    again = paper_figures(run.trace, run.scene, tmp_path / "b", formats=["pdf", "svg"])
    assert len(written) == 6
    for one, two in zip(written, again, strict=True):
        assert one.read_bytes() == two.read_bytes()
        assert one.read_bytes().startswith(b"%PDF" if one.suffix == ".pdf" else b"<?xml")
    with pytest.raises(InputError, match="format eps: allowed is png, pdf, svg"):
        paper_figures(run.trace, run.scene, tmp_path, formats=["eps"])


def test_arms_are_told_apart_by_their_colour(run):
    qpos = run.trace["qpos"][[0]]
    try:
        (plain,) = stills.render(run.scene, qpos, width=200, height=150)
        (tinted,) = stills.render(run.scene, qpos, width=200, height=150, arms=["surgeon", "nurse"])
    except stills.NoPictures as error:
        pytest.skip(str(error))
    changed = (plain != tinted).any(axis=2)
    assert 0.005 < changed.mean() < 0.5
    hue = tinted[changed].astype(int)
    blue, orange = hue[:, 2] > hue[:, 0] + 20, hue[:, 0] > hue[:, 2] + 20
    assert blue.mean() > 0.2
    assert orange.mean() > 0.2


def test_stamps_tell_the_two_encounters(run):
    trace = run.trace
    one, two, three, four = time_stamps(trace)
    mode = trace["mode"]
    distance = trace["pair_distance_m"].min(axis=1)
    assert (mode[one - 1], mode[one]) == ("run", "scale")
    assert distance[two] == distance[one:three].min()
    assert (mode[three - 1], mode[three]) == ("run", "scale")
    assert (mode[four - 1], mode[four]) == ("scale", "halt")


def part(trace, start, stop):
    return dataclasses.replace(trace, rows=trace.table.slice(start, stop - start))


@pytest.mark.parametrize(("start", "stop"), [(0, 100), (0, 600), (300, 400), (0, 4), (0, 1)])
def test_stamps_fit_any_trace(run, start, stop):
    trace = part(run.trace, start, stop)
    stamps = time_stamps(trace)
    assert list(stamps) == sorted(stamps)
    assert stamps[0] >= 0
    assert stamps[-1] < len(trace)
    if stop - start > 10:
        assert len(set(stamps)) == 4


def test_a_single_encounter_is_told_from_onset_to_end(run):
    stamps = time_stamps(part(run.trace, 0, 600))
    scaled = run.trace["nurse.scale"][:600] < 1
    assert stamps[0] == np.argmax(scaled)
    assert stamps[3] == 599


def test_an_empty_trace_is_refused(run, tmp_path):
    with pytest.raises(TraceError, match="no rows to draw"):
        paper_figures(part(run.trace, 0, 0), run.scene, tmp_path)
