"""Films: what is drawn when, in which colour, into which file."""

import numpy as np
import pytest
from PIL import Image

from workcell.errors import InputError
from workcell.view import film as films
from workcell.view import stills
from workcell.view.film import AMBER, GREEN, RED, Clip, film, gauge_colour


@pytest.fixture
def clip(run):
    return Clip(run.trace, run.scene, "two arms")


def made(*arguments, **options):
    try:
        return film(*arguments, **options)
    except stills.NoPictures as error:
        pytest.skip(str(error))


def test_the_gauge_turns_from_green_to_red():
    assert gauge_colour(np.nan, 1.0) == GREEN
    assert gauge_colour(2.5, 1.0) == GREEN
    assert gauge_colour(1.5, 1.0) == AMBER
    assert gauge_colour(1.0, 1.0) == RED
    assert gauge_colour(1.0, 0.5) == AMBER


def test_a_film_shows_the_run_at_the_stated_speed(clip, run, tmp_path):
    """Six seconds at threefold speed, five pictures a second: two seconds of film."""
    path = made([clip], tmp_path / "film.webp", speed=3.0, fps=5, height=120)
    with Image.open(path) as picture:
        assert picture.n_frames == 10
        pictures = []
        for k in range(picture.n_frames):
            picture.seek(k)
            pictures.append(np.asarray(picture.convert("RGB"), dtype=int))
            assert picture.info["duration"] == 200
    assert np.abs(pictures[0] - pictures[5]).mean() > 1, "something moves"
    assert list(tmp_path.iterdir()) == [path]


def test_runs_stand_side_by_side(clip, tmp_path):
    one = made([clip], tmp_path / "one.gif", fps=2, height=120, end_s=1.0)
    three = made([clip] * 3, tmp_path / "three.gif", fps=2, height=120, end_s=1.0)
    with Image.open(one) as a, Image.open(three) as b:
        assert b.size == (2 * a.width, 2 * a.height)
        assert a.n_frames == b.n_frames


def test_an_mp4_is_readable(clip, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = made([clip], tmp_path / "film.mp4", fps=4, height=120, end_s=1.0)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 5
    assert seconds == pytest.approx(1.25, abs=0.05)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"speed": 0.0}, "--speed 0: allowed is 0.01 to 1000"),
        ({"fps": 1000}, "--fps 1000"),
        ({"height": 7}, "--height 7"),
        ({"start_s": 3.0, "end_s": 2.0}, "0 <= start < end"),
        ({"speed": float("nan")}, "--speed nan"),
    ],
)
def test_what_no_film_can_be_made_of_is_refused(clip, tmp_path, options, said):
    with pytest.raises(InputError, match=said):
        film([clip], tmp_path / "film.webp", **options)
    with pytest.raises(InputError, match="allowed endings are"):
        film([clip], tmp_path / "film.avi")
    with pytest.raises(InputError, match="5 runs; allowed is 1 to 4"):
        film([clip] * 5, tmp_path / "film.webp")


def test_the_bar_is_full_at_t_min(clip, run):
    """At the tick of the smallest time to collision the bar fills its frame, in red."""
    tick = int(np.nanargmin(run.trace["ttc_s"]))
    panel = films._Panel(clip, run.trace["time_s"][[0, tick]], 240)
    free, held = (np.asarray(panel._panel(k), dtype=int) for k in (0, 1))
    red = [(np.abs(p - RED).sum(axis=2) < 12).sum() for p in (free, held)]
    assert red[1] > 200
    assert red[0] == 0
