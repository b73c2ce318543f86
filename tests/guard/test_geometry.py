"""Which geometry the check takes, and what it refuses by name."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from workcell.errors import InputError
from workcell.guard.geometry import collect_geometry, load_scene

from .cell import ARMS, scene_text

TETRAHEDRON = "0 0 0  .1 0 0  0 .1 0  0 0 .1"
ALL_FACES = "0 2 1  0 1 3  1 2 3  0 3 2"
# The same surface as a file of separate triangles writes it: every corner of its own.
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])


def one_body(geoms: str, *, assets: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{assets}</asset><worldbody><body name='nurse/link'>"
        f"<joint name='nurse/J1'/><inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/>{geoms}"
        "</body></worldbody></mujoco>"
    )


def mesh(vertices: str, faces: str) -> str:
    return f"<mesh name='shell' vertex='{vertices}' face='{faces}'/>"


def test_housing_is_preferred_and_capsules_of_an_arm_never_count():
    model = one_body(
        "<geom name='h' type='box' size='.1 .1 .1' group='2'/>"
        "<geom name='rough' type='sphere' size='.2' group='3'/>"
        "<geom name='c' type='capsule' size='.2 .1' group='4'/>"
    )
    geometry = collect_geometry(model, ("nurse",))
    assert [piece.name for piece in geometry.pieces] == ["h"]
    assert geometry.missing == ()


def test_without_housing_any_other_geometry_serves():
    model = one_body(
        "<geom type='sphere' size='.2' group='0'/>"
        "<geom name='c' type='capsule' size='.2 .1' group='4'/>"
    )
    (piece,) = collect_geometry(model, ("nurse",)).pieces
    assert (piece.name, piece.owner) == ("nurse/link#0", "nurse")


def test_an_arm_of_nothing_but_capsules_is_named_as_missing():
    model = one_body("<geom name='c' type='capsule' size='.2 .1' group='4'/>")
    geometry = collect_geometry(model, ("nurse",))
    assert geometry.pieces == ()
    assert geometry.missing == ("nurse/link", "nurse")


def test_an_obstacle_that_is_only_a_watched_primitive_is_that_primitive():
    model = mujoco.MjModel.from_xml_string(
        scene_text(extra="").replace('name="post"', 'name="post" group="4"')
    )
    owners = {piece.name: piece.owner for piece in collect_geometry(model, ARMS).pieces}
    assert owners["post"] == "world"
    assert owners["nurse/tool_tip"] == "nurse"


@pytest.mark.parametrize("repeat_corners", [False, True])
def test_a_closed_mesh_is_accepted_however_its_file_counts_vertices(repeat_corners: bool):
    faces = np.array(ALL_FACES.split(), dtype=int).reshape(-1, 3)
    vertices = CORNERS
    if repeat_corners:
        vertices = CORNERS[faces.ravel()]
        faces = np.arange(len(vertices)).reshape(-1, 3)
    text = mesh(" ".join(map(str, vertices.ravel())), " ".join(map(str, faces.ravel())))
    model = one_body("<geom type='mesh' mesh='shell' group='2'/>", assets=text)
    assert len(collect_geometry(model, ("nurse",)).pieces) == 1


def test_an_open_mesh_counts_as_its_hull():
    """Nothing but the hull is measured, so a surface with a hole is as good as a closed one."""
    faces = ALL_FACES.rsplit("  ", 1)[0]
    assets = mesh(TETRAHEDRON, faces).replace("/>", " inertia='shell'/>")
    model = one_body("<geom name='cover' type='mesh' mesh='shell' group='2'/>", assets=assets)
    assert [piece.name for piece in collect_geometry(model, ("nurse",)).pieces] == ["cover"]


def test_all_faults_are_reported_at_once():
    assets = "<hfield name='hills' nrow='2' ncol='2' size='1 1 1 1'/>"
    model = one_body(
        "<geom name='ground' type='hfield' hfield='hills' group='2'/>",
        assets=assets,
    )
    with pytest.raises(InputError) as caught:
        collect_geometry(model, ("nurse", "doctor"))
    text = str(caught.value)
    assert len(caught.value.faults) == 2
    assert "arm 'doctor'" in text
    assert "'ground'" in text


def test_a_scene_that_is_missing_or_broken_is_refused_with_its_path(tmp_path: Path):
    with pytest.raises(InputError, match="no such scene file"):
        load_scene(tmp_path / "nowhere.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><geom size='0'/></worldbody></mujoco>")
    with pytest.raises(InputError, match=r"broken\.xml: the scene does not compile: .*size 0"):
        load_scene(broken)
