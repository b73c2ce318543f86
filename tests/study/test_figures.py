"""The pictures of a sweep."""

from __future__ import annotations

from dataclasses import asdict

from workcell.study import figures
from workcell.study.outcome import Outcome


def test_every_setting_that_was_tried_is_named_even_one_that_never_gets_done(tmp_path, monkeypatch):
    rows = [
        asdict(
            Outcome(
                run, setting, "ran", done=done, done_s=10.0 + run if done else None, smallest_m=0.1
            )
        )
        for run in range(3)
        for setting, done in (("criterion=none", False), ("criterion=artc", True))
    ]
    drawn = []
    monkeypatch.setattr(figures, "_save", lambda figure, path: drawn.append(figure) or path)
    figures.draw(rows, tmp_path)
    for figure in drawn:
        (legend,) = [axes.get_legend() for axes in figure.axes if axes.get_legend()]
        named = [text.get_text() for text in legend.get_texts()]
        assert [name.split(" ")[0] for name in named] == ["criterion=none", "criterion=artc"]
