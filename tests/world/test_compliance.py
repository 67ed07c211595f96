"""Compliance against converged solutions of an independent program, and against its own symmetries."""

import json
from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError, OutOfBodyError
from twin.parts.body import Block, Finger
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.world.compliance import Compliance
from twin.world.mesh import read_mesh
from twin.world.solve import factorisations
from twin.world.tile import join, tile

REFERENCE = Path(__file__).parent.parent / "reference"
BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
BODIES = {"block": (BLOCK, "kamiyama_block"), "finger": (FINGER, "sato_finger")}
BOUND = {("block", "truth"): 7e-4, ("block", "nominal"): 2e-3, ("finger", "truth"): 5e-3, ("finger", "nominal"): 1e-2}
CASES = {name: json.loads(str(np.load(REFERENCE / f"{name}.npz")["cases"])) for name in BODIES}
_made: dict[tuple[str, str, float, str], Compliance] = {}


def compliance(name, purpose, nu, method="subtracted"):
    """Return one shared compliance each, so that the tests factor every matrix once; tables have their own tests."""
    key = (name, purpose, nu, method)
    if key not in _made:
        body, recipe = BODIES[name]
        mesh = read_mesh(MESHES / f"{recipe}.{purpose}.npz")
        material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
        _made[key] = Compliance(body, material, mesh, purpose=purpose, method=method, table=False)
    return _made[key]


def reference_error(name, purpose, case, method="subtracted"):
    data = np.load(REFERENCE / f"{name}.npz")
    words = dict(case["load"])
    load = getattr(Traction, words.pop("kind"))(**words)
    body = BODIES[name][0]
    got = compliance(name, purpose, case["nu"], method).displacement(data["points"], tile(load, body))
    expected = data[case["key"]]
    return np.linalg.norm(got - expected, axis=1).max() / np.linalg.norm(expected, axis=1).max()


QUICK = [("block", "nominal", 0), ("block", "nominal", 3), ("finger", "nominal", 2), ("finger", "nominal", 3)]


@pytest.mark.parametrize(("name", "purpose", "index"), QUICK)
def test_reference_quick(name, purpose, index):
    assert reference_error(name, purpose, CASES[name][index]) < BOUND[name, purpose]


@pytest.mark.slow
@pytest.mark.parametrize("purpose", ["truth", "nominal"])
@pytest.mark.parametrize(("name", "case"), [(n, c) for n, cases in CASES.items() for c in cases])
def test_reference_all(name, purpose, case):
    assert reference_error(name, purpose, case) < BOUND[name, purpose]


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 2])
def test_plain_taylor_hood_agrees_where_the_mesh_resolves_the_load(axis):
    """Without the half-space the mesh has to carry the load itself: a wide bump agrees, a narrow one less."""
    points = np.load(REFERENCE / "finger.npz")["points"]
    for radius, bound in ((4.0, 0.01), (2.0, 0.03)):
        tiles = tile(Traction.bump((0, 0), radius, tuple(np.eye(3)[axis])), FINGER)
        one, other = (
            compliance("finger", "truth", 0.5, method).displacement(points, tiles)
            for method in ("direct", "subtracted")
        )
        assert np.abs(one - other).max() < bound * np.abs(other).max()


def test_second_press_factors_nothing_and_moving_markers_neither():
    stiff = compliance("finger", "nominal", 0.5)
    points = np.array([[0.0, 0.0, 2.0], [1.0, 1.0, 3.0]])
    stiff.displacement(points, tile(Traction.bump((0, 0), 1.0, (0, 0, 1)), FINGER))
    before = factorisations()
    stiff.displacement(points, tile(Traction.bump((1, 1), 1.0, (0.2, 0, 1)), FINGER))
    stiff.displacement(points + 0.5, tile(Traction.bump((1, 1), 1.0, (0.2, 0, 1)), FINGER))
    assert factorisations() == before


@pytest.mark.parametrize(("name", "at"), [("block", (2.0, 1.0)), ("finger", (1.0, 0.5))])
def test_superposition_modulus_and_gradient(name, at):
    body, stiff = BODIES[name][0], compliance(name, "nominal", 0.5)
    rng = np.random.default_rng(4)
    points = body.chart_points(rng.uniform(-4, 4, (12, 2)), depth_mm=1.5)
    one = tile(Traction.rectangle(at, (0.5, 0.5), (0.2, 0.1, 1)), body, 0.25)
    two = tile(Traction.rectangle((-1.0, -2.0), (0.5, 0.5), (0, 1, 0)), body, 0.25)
    both = stiff.displacement(points, join([one, two]))
    parts = stiff.displacement(points, one) + stiff.displacement(points, two)
    np.testing.assert_allclose(both, parts, atol=2e-3 * np.abs(both).max())
    softer = Compliance(body, Material(youngs_modulus_mpa=0.25), stiff.mesh, purpose="nominal", table=False)
    softer.__dict__["system"] = stiff.system
    np.testing.assert_allclose(softer.displacement(points, one), 2 * stiff.displacement(points, one), rtol=1e-12)
    step = 1e-4
    slopes = [
        (stiff.displacement(points + step * e, one) - stiff.displacement(points - step * e, one)) / (2 * step)
        for e in np.eye(3)
    ]
    gradient = stiff.gradient(points, one)
    np.testing.assert_allclose(gradient, np.stack(slopes, axis=-1), atol=0.01 * np.abs(gradient).max())
    matrix = stiff.to_points(points, one)
    np.testing.assert_allclose(
        (matrix @ one.force_n.ravel()).reshape(-1, 3), stiff.displacement(points, one), atol=5e-3 * np.abs(both).max()
    )


def test_mirror_symmetry_of_the_block():
    stiff = compliance("block", "nominal", 0.5)
    points = np.random.default_rng(6).uniform([-15, -12, 0.5], [15, 12, 9], (30, 3))
    flip = np.array([-1.0, 1.0, 1.0])
    here = stiff.displacement(points, tile(Traction.rectangle((5, 3), (2, 4), (0.5, 0.2, 1)), BLOCK))
    there = stiff.displacement(points * flip, tile(Traction.rectangle((-5, 3), (2, 4), (-0.5, 0.2, 1)), BLOCK))
    np.testing.assert_allclose(there * flip, here, atol=3e-3 * np.abs(here).max())


def test_contact_compliance_is_symmetric_positive_and_interpolated_well():
    stiff = compliance("finger", "nominal", 0.5)
    patches = tile(Traction.rectangle((1.0, 0.5), (2.0, 2.0), (0, 0, 1)), FINGER, 0.2)
    matrix = stiff.surface(patches)
    assert stiff.asymmetry < 0.02
    assert np.linalg.eigvalsh(matrix).min() > 0
    pressed = (matrix @ patches.force_n.ravel()).reshape(-1, 3)
    whole = stiff.displacement(patches.centre_mm, patches)
    np.testing.assert_allclose(pressed, whole, atol=0.01 * np.abs(whole).max())


def test_points_outside_and_loads_off_the_surface_are_refused():
    stiff = compliance("block", "nominal", 0.5)
    load = tile(Traction.rectangle((0, 0), (2, 2), (0, 0, 1)), BLOCK)
    with pytest.raises(OutOfBodyError, match="point 1"):
        stiff.displacement(np.array([[0.0, 0, 1], [0, 0, -0.1]]), load)
    sunk = Rectangles(
        centre_mm=load.centre_mm + np.array([0, 0, 1.0]), frames=load.frames, half_mm=load.half_mm, force_n=load.force_n
    )
    with pytest.raises(InputError, match="not on the sensing surface"):
        stiff.displacement(np.array([[0.0, 0, 1]]), sunk)
