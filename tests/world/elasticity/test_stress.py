"""The ends of every axis: exact scaling, incompressible limit, slivers, loads at edges and of any width and size.

`benchmarks/stress.py` looks for the breaking points between and beyond these; `test_soundness` has what is refused.
"""

from dataclasses import replace

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.body import Block, Finger
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.fem import TaylorHood
from twin.world.elasticity.residual import nodal_forces
from twin.world.elasticity.tile import join, tile
from twin.world.mesh.mesh import read_mesh

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
PUSH = (0.3, -0.5, 1.0)
SIDES = ("width_mm", "length_mm", "thickness_mm")


class LooseBlock(Block):
    """A block that is held nowhere, so that tractions of the half-space are integrated all round."""

    @property
    def held_pieces(self):
        return ()


class LooseFinger(Finger):
    """A finger that is held nowhere."""

    @property
    def held_pieces(self):
        return ()


LOOSE = {
    "block": LooseBlock(width_mm=100, length_mm=90, thickness_mm=40),
    "finger": LooseFinger(radius_mm=8, barrel_mm=8, skirt_mm=2),
}


@pytest.fixture(scope="module")
def block():
    mesh = read_mesh(MESHES / "kamiyama_block.sketch.npz")
    return Compliance(BLOCK, Material(youngs_modulus_mpa=1.0), mesh, level="sketch", table=False)


@pytest.fixture(scope="module")
def finger():
    mesh = read_mesh(MESHES / "sato_finger.sketch.npz")
    return Compliance(FINGER, Material(youngs_modulus_mpa=1.0), mesh, level="sketch", table=False)


def imbalance(name, stiff, load):
    """How far the half-space's tractions on all faces are from adding up to the load, over the load."""
    forces = nodal_forces(stiff.mesh, LOOSE[name], load, load.force_n[:, :, None], 0.5).sum(axis=0)[:, 0]
    total = load.force_n.sum(axis=0)
    return float(np.linalg.norm(forces - total) / np.linalg.norm(total))


def push(mesh, force=PUSH):
    forces = np.zeros((len(mesh.points), 3, 1))
    forces[int(np.argmin(np.linalg.norm(mesh.points, axis=1)))] = np.array(force)[:, None]
    return forces


POWERS = [2.0**-18, 2.0**20]
"""Four millionths, above the least modulus, and a million, about: even powers of two, by which numbers and their roots
scale without rounding."""


@pytest.mark.parametrize("factor", POWERS)
def test_modulus_scales_exactly(block, factor):
    points, load = np.array([[1.0, 2.0, 3.0], [5.0, 0.0, 9.0]]), tile(Traction.rectangle((0, 0), (4, 4), PUSH), BLOCK)
    other = Compliance(BLOCK, Material(youngs_modulus_mpa=min(factor, 1e6)), block.mesh, level="sketch", table=False)
    other.__dict__["system"] = block.system
    scaled = other.displacement(points, load) * other.material.youngs_modulus_mpa
    np.testing.assert_allclose(scaled, block.displacement(points, load), rtol=1e-14)


@pytest.mark.parametrize("factor", POWERS)
def test_length_scales_exactly(block, factor):
    forces = push(block.mesh)
    scaled = TaylorHood(replace(block.mesh, points=block.mesh.points * factor), 0.5)
    np.testing.assert_array_equal(scaled.solve(forces) * factor, block.system.solve(forces))


@pytest.mark.parametrize("factor", [2.0**-10, 2.0**10])
def test_whole_bodies_scale_exactly_beyond_what_a_recipe_allows(block, factor):
    """From a tenth of a millimetre to a hundred metres; a recipe's 5 to 500 mm are there to notice wrong units."""
    body = Block.model_construct(**{name: getattr(BLOCK, name) * factor for name in SIDES})
    mesh = replace(block.mesh, points=block.mesh.points * factor)
    other = Compliance(body, block.material, mesh, level="sketch", table=False)
    points = np.array([[1.0, 2.0, 3.0], [5.0, 0.0, 9.0]])
    load, unscaled = (
        tile(Traction.rectangle((s, -s), (4 * s, 4 * s), PUSH), of) for s, of in ((factor, body), (1.0, BLOCK))
    )
    right = block.displacement(points, unscaled)
    np.testing.assert_allclose(other.displacement(points * factor, load) * factor, right, rtol=1e-12)
    assert other.expected_error(load) == pytest.approx(block.expected_error(unscaled))


@pytest.mark.parametrize("size", [2.0**-990, *POWERS, 2.0**990])
def test_force_scales_exactly(block, size):
    forces = push(block.mesh)
    np.testing.assert_array_equal(block.system.solve(forces * size) / size, block.system.solve(forces))


@pytest.mark.parametrize("nu", [-0.5, 0.4999999])
def test_ends_of_poissons_ratio(block, nu):
    forces = np.concatenate([push(block.mesh, axis) for axis in np.eye(3)], axis=2)
    system = TaylorHood(block.mesh, nu)
    moved = system.solve(forces)
    assert system.factor.residual < 1e-11
    np.testing.assert_allclose(system.reaction(forces), -np.eye(3), atol=1e-9)
    at = int(np.argmin(np.linalg.norm(block.mesh.points, axis=1)))
    np.testing.assert_allclose(moved[at], moved[at].T, atol=1e-12)
    if nu > 0:
        np.testing.assert_allclose(moved, block.system.solve(forces), atol=1e-6 * np.abs(moved).max())


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-4])
def test_loads_at_an_edge_are_balanced_however_narrow(block, gap):
    for centre in ((50.0 - gap, 0.0), (50.0 - gap, 45.0 - gap)):
        load = tile(Traction.rectangle(centre, (2 * gap, 2 * gap), PUSH), BLOCK)
        assert imbalance("block", block, load) < 4e-3
        assert np.isfinite(block.displacement(np.array([[45.0, 40.0, 2.0]]), load)).all()


def test_loads_near_the_clamped_rim_are_balanced_and_leave_the_clamp_still(finger):
    """Nearer than an element the clamp is not still any more: `benchmarks/stress.py` says how far that goes."""
    for centre, width in ((9.5, 1.0), (9.99, 0.02)):
        load = tile(Traction.rectangle((-3.0, 8.0, centre), (width, width), PUSH), FINGER)
        assert imbalance("finger", finger, load) < 4e-3
    load = tile(Traction.rectangle((-3.0, 8.0, 8.0), (1.0, 1.0), PUSH), FINGER)
    points = np.array([[-3.0, 6.0, 10.0], [-2.0, 7.0, 10.0], [-3.0, 7.0, 8.0]])
    moved = np.linalg.norm(finger.displacement(points, load), axis=1)
    assert moved[:2].max() < 0.1 * moved[2]


def test_narrow_loads_tend_to_a_point(block):
    points = np.array([[1.0, 2.0, 3.0], [5.0, 0.0, 9.0]])
    fields = [
        block.displacement(points, tile(Traction.rectangle((2, 1), (w, w), PUSH), BLOCK)) for w in (1e-3, 1e-6, 1e-100)
    ]
    for field in fields[1:]:
        np.testing.assert_allclose(field, fields[0], rtol=1e-6)


def pieces(load, width):
    """The same load, every rectangle cut into pieces no wider than ``width``."""
    out = []
    for centre, frame, half, force in zip(load.centre_mm, load.frames, load.half_mm, load.force_n, strict=True):
        number = np.ceil(2.0 * half / width).astype(int)
        a, b = ((np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in number)
        for place in np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2):
            out.append((centre + (place * half) @ frame[:2], frame, half / number, force / number.prod()))
    middles, frames, halves, forces = (np.array(each) for each in zip(*out, strict=True))
    return Rectangles(centre_mm=middles, frames=frames, half_mm=halves, force_n=forces)


@pytest.mark.parametrize("load", [Traction.disk((2, 1), 6.0, PUSH), Traction.rectangle((2, 1), (12, 8), PUSH),
                                  Traction.twist((2, 1), 6.0, 10.0)], ids=lambda load: load.terms[0].kind)  # fmt: skip
def test_wide_loads_are_the_sum_of_small_pieces(block, load):
    """Far from a load as near to it: a disk is a few dozen strips as long as the disk is wide."""
    points, whole = np.array([[1.0, 2.0, 3.0], [9.0, -7.0, 6.0], [-11.0, 2.0, 3.0]]), tile(load, BLOCK)
    one, other = (block.displacement(points, each) for each in (whole, pieces(whole, 1.5)))
    np.testing.assert_allclose(one, other, atol=2e-5 * np.abs(one).max())


def test_a_load_over_the_whole_face_is_the_sum_of_its_quarters(block):
    points = np.array([[1.0, 2.0, 3.0], [40.0, -30.0, 9.0], [0.0, 0.0, 30.0]])
    whole = tile(Traction.rectangle((0, 0), (100, 90), PUSH), BLOCK)
    quarter = tuple(np.array(PUSH) / 4)
    centres = [(x, y) for x in (-25.0, 25.0) for y in (-22.5, 22.5)]
    parts = join([tile(Traction.rectangle(c, (50, 45), quarter), BLOCK) for c in centres])
    one, other = block.displacement(points, whole), block.displacement(points, parts)
    np.testing.assert_allclose(one, other, atol=0.01 * np.abs(one).max())


def rectangles(centre, half=0.5):
    return Rectangles(
        centre_mm=np.array([centre], float),
        frames=np.eye(3)[None],
        half_mm=np.full((1, 2), half),
        force_n=np.array([PUSH]),
    )


def test_loads_on_an_edge_or_over_it_are_refused(block):
    points = np.array([[1.0, 2.0, 3.0]])
    for centre in ((50.0, 0.0, 0.0), (50.0 - 1e-5, 0.0, 0.0), (0.0, 45.0005, 0.0)):
        with pytest.raises(InputError, match=r"mm from the body's [xy]_max face .*move it inwards"):
            block.displacement(points, rectangles(centre))
    with pytest.raises(InputError, match=r"hangs over the end of the sensing surface by 0.8 of its half side"):
        block.displacement(points, rectangles((49.9, 0.0, 0.0)))
    with pytest.raises(InputError, match="partly off the sensing surface"):
        tile(Traction.rectangle((0, 0), (100.01, 90), PUSH), BLOCK)


@pytest.mark.parametrize("what", ["centre_mm", "frames", "half_mm", "force_n"])
def test_rectangles_of_numbers_that_are_not_finite_are_named(block, what):
    load = rectangles((0.0, 0.0, 0.0))
    bad = np.array(getattr(load, what))
    bad.flat[0] = np.nan
    with pytest.raises(InputError, match=r"rectangle 0: its .* is not finite: check the load"):
        block.displacement(np.array([[1.0, 2.0, 3.0]]), replace(load, **{what: bad}))


@pytest.mark.parametrize("name", ["block", "finger"])
def test_patches_move_each_other_alike(name, request):
    """Betti: what a force on one patch does at another, the same force on the other does at the first.

    Told against the finite body's part, because the half-space's is symmetric by itself on a flat face.
    """
    stiff = request.getfixturevalue(name)
    body, spread = (BLOCK, 20.0) if name == "block" else (FINGER, 4.0)
    sites = body.chart_points(np.random.default_rng(5).uniform(-spread, spread, (6, 2)))
    patches = Rectangles(
        centre_mm=sites, frames=body.frames(sites), half_mm=np.full((6, 2), 0.05), force_n=np.zeros((6, 3))
    )
    matrix = stiff.to_points(sites, patches)
    rest = matrix - halfspace.compliance(sites, patches, 1.0, 0.5)
    assert np.abs(matrix - matrix.T).max() < 0.03 * np.abs(rest).max()


@pytest.mark.parametrize("name", ["block", "finger"])
def test_dot_products_with_the_adjoint_agree(name, request):
    """<y, C f> by the compliance's columns is <C^T y, f> read off one field; the rows of C belong to the points."""
    stiff = request.getfixturevalue(name)
    body = BLOCK if name == "block" else FINGER
    rng = np.random.default_rng(7)
    load = tile(Traction.rectangle((0.5, 0.3), (0.4, 0.4), PUSH), body, 0.1)
    load = replace(load, force_n=rng.normal(size=load.force_n.shape))
    points = body.chart_points(rng.uniform(-4, 4, (9, 2)), depth_mm=1.5)
    weights = rng.normal(size=(9, 3))
    forward = float(np.sum(weights * stiff.displacement(points, load)))
    backward = float((stiff.to_points(points, load).T @ weights.ravel()) @ load.force_n.ravel())
    assert backward == pytest.approx(forward, rel=1e-5 if name == "block" else 1e-2)
