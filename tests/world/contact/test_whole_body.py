"""Rubber on tetrahedra: homogeneous stretch in closed form, frame invariance, tangents, and the gap's slopes."""

import numpy as np
import pytest
from stretched_rubber import LAWS, every_law, nominal_stress

import twin
from twin.parts.body import Block, Finger
from twin.world.contact.probe_gap import approach_of
from twin.world.contact.whole_body import Anchors, Rubber, SurfaceTouch
from twin.world.mesh.body_mesh import body_mesh

BODY = Block(width_mm=6, length_mm=5, thickness_mm=4)
TURN = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
TURN *= np.linalg.det(TURN)


def rubber_of(material):
    return Rubber(body_mesh(BODY, "sketch"), BODY, material)


def put(rubber, moved, pressure=0.0):
    unknowns = np.full(rubber.size, pressure)
    unknowns[: moved.size] = moved.ravel()
    return unknowns


@pytest.mark.parametrize("stretch", [0.6, 1.7])
@pytest.mark.parametrize("material", [LAWS[0], LAWS[2], LAWS[3]], ids=lambda one: one.law)
def test_turned_homogeneous_stretch_carries_the_closed_form(material, stretch):
    """A patch test at large strain and turn: nominal stress 2 (l - l^-2) (W1 + W2 / l), E = 1 MPa, the sides free."""
    rubber = rubber_of(material)
    points = rubber.mesh.points
    gradient = TURN @ np.diag([stretch**-0.5, stretch**-0.5, stretch])
    moved = points @ (gradient - np.eye(3)).T
    before = rubber.displacement(rubber.resistance(put(rubber, moved)))
    per_pressure = rubber.displacement(rubber.resistance(put(rubber, moved, 1.0))) - before
    low, high = np.array(BODY.bounds_mm)
    side = np.isclose(points[:, 0], high[0])
    for end in (1, 2):  # only nodes that lie on no other side
        side &= (points[:, end] > low[end] + 1e-9) & (points[:, end] < high[end] - 1e-9)
    out = TURN[:, 0]
    pressure = -float((before[side] @ out).sum() / (per_pressure[side] @ out).sum())
    whole = rubber.resistance(put(rubber, moved, pressure))
    force = rubber.displacement(whole)
    top = np.isclose(points[:, 2], high[2])
    bottom = np.isclose(points[:, 2], low[2])
    assert np.abs(force[~top & ~bottom]).max() < 1e-9
    nominal = nominal_stress(material, stretch)
    area = (high - low)[0] * (high - low)[1]
    assert force[top].sum(axis=0) == pytest.approx(nominal * area * TURN[:, 2], abs=1e-8)
    swollen = whole[moved.size :]
    assert np.abs(swollen).max() < 1e-10


@every_law
def test_forces_turn_with_the_frame_and_the_tangent_is_their_slope(material):
    rubber = rubber_of(material)
    points = rubber.mesh.points
    rng = np.random.default_rng(2)
    moved = 0.1 * np.sin(points @ rng.standard_normal((3, 3)))
    unknowns = put(rubber, moved, 0.2)
    turned = put(rubber, (points + moved) @ TURN.T - points, 0.2)
    force = rubber.resistance(unknowns)
    assert rubber.displacement(rubber.resistance(turned)) == pytest.approx(
        rubber.displacement(force) @ TURN.T, abs=1e-10
    )
    way = rng.standard_normal(rubber.size)
    step = 1e-5
    slope = (rubber.resistance(unknowns + step * way) - rubber.resistance(unknowns - step * way)) / (2.0 * step)
    tangent = rubber.tangent(unknowns)
    assert tangent @ way == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())
    assert abs(tangent - tangent.T).max() < 1e-12


@pytest.mark.parametrize("linear", [True, False], ids=["linear", "finite"])
@pytest.mark.parametrize("direction", [None, "normal"], ids=["down", "normal"])
def test_gap_and_push_have_their_slopes(direction, linear):
    body = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
    mesh = body_mesh(body, "sketch")
    at = (-2.0, 3.0, *body.surface_from_above(np.array([[-2.0, 3.0]]))[0, 2:])
    press = twin.Press(probe=twin.Sphere(diameter_mm=3), at_mm=at, direction=direction, indentation_mm=0.5)
    approach = approach_of(press, body)
    touch = SurfaceTouch(mesh, body, approach, False, [(approach.touch_mm, 0.5)])
    moved = 0.05 * np.sin(mesh.points)
    pose = np.array([0.1, -0.05, 0.4, 0.02, -0.03, 0.01])
    anchors = Anchors.none(len(touch.rest_mm))
    step = 1e-5

    def meet(shift=0.0, motion=0.0):
        return touch.meet(moved + shift, pose + motion, anchors, linear=linear)

    def slope_of(name, more, less):
        return (getattr(more, name)[some] - getattr(less, name)[some]) / (2.0 * step)

    here = meet()
    some = np.abs(here.gap) < 0.3
    assert some.sum() > 5
    for motion in range(6):
        nudge = step * np.eye(6)[motion]
        around = meet(motion=nudge), meet(motion=-nudge)
        assert here.per_motion[some, motion] == pytest.approx(slope_of("gap", *around), abs=2e-5)
    for axis in range(3):
        nudge = step * np.eye(3)[axis]
        around = meet(nudge), meet(-nudge)
        assert here.push[some, axis] == pytest.approx(slope_of("gap", *around), abs=1e-6)
        assert here.bend[some][:, :, axis] == pytest.approx(slope_of("push", *around), abs=1e-4)
