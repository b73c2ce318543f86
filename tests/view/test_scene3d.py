import mujoco
import numpy as np
import pytest

from workcell.errors import TraceError
from workcell.view.scene3d import Triangles, geom_triangles, joined

SHAPES = {
    "box": ('type="box" size="0.1 0.2 0.3"', 8 * 0.1 * 0.2 * 0.3),
    "sphere": ('type="sphere" size="0.2"', 4 / 3 * np.pi * 0.2**3),
    "capsule": ('type="capsule" size="0.1 0.2"', np.pi * 0.1**2 * (0.4 + 4 / 3 * 0.1)),
    "cylinder": ('type="cylinder" size="0.1 0.2"', np.pi * 0.1**2 * 0.4),
    "ellipsoid": ('type="ellipsoid" size="0.1 0.2 0.3"', 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
    "mesh": ('type="mesh" mesh="wedge"', 0.3 * 0.2 * 0.1 / 6),
}


def surface(attributes: str) -> tuple[Triangles, mujoco.MjModel]:
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><asset><mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.2 0  0 0 0.1"/></asset>
        <worldbody><geom name="g" {attributes} pos="0.5 -0.4 0.3" euler="30 40 50"/></worldbody>
        </mujoco>""")
    return geom_triangles(model, 0), model


def volume(found: Triangles) -> float:
    """By the divergence theorem: right only for a closed surface whose triangles all face out."""
    a, b, c = (found.vertices[found.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("name", SHAPES)
def test_surfaces_are_closed_and_face_out(name):
    attributes, exact = SHAPES[name]
    found, _ = surface(attributes)
    assert volume(found) == pytest.approx(exact, rel=0.02)
    corners = found.vertices[found.faces]
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    real = np.linalg.norm(plane, axis=1) > 1e-9
    at_corner = np.einsum("ik,ijk->ij", plane, found.normals[found.faces])
    assert (at_corner[real] > 0).all(), "a normal points inwards"
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-6)


def test_the_surface_is_where_the_geom_is():
    found, model = surface(SHAPES["box"][0])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    local = (found.vertices - data.geom_xpos[0]) @ data.geom_xmat[0].reshape(3, 3)
    np.testing.assert_allclose(np.abs(local), np.tile([0.1, 0.2, 0.3], (len(local), 1)))


def test_joining_keeps_triangles_apart():
    box, ball = (surface(SHAPES[name][0])[0] for name in ("box", "sphere"))
    assert volume(joined([box, ball])) == pytest.approx(volume(box) + volume(ball))


def test_what_cannot_be_drawn_is_named():
    with pytest.raises(TraceError, match="geom 'g': a mjGEOM_PLANE cannot be drawn"):
        surface('type="plane" size="1 1 0.1"')
