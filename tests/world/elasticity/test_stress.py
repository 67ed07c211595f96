"""The ends of every axis: exact scaling, incompressible limit, loads at edges, of any size."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import BLOCK, BODIES, LOOSE, assert_holder_balances, forces_on, nearest_node, rectangles, write_stl
from trimesh.convex import convex_hull

from twin.errors import InputError
from twin.files import MESHES
from twin.parts.body import Block, Solid
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.theory import halfspace
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.correction import unbalanced
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.fem import TaylorHood
from twin.world.mesh.quadratic_mesh import Mesh

PUSH = (0.3, -0.5, 1.0)
SIDES = ("width_mm", "length_mm", "thickness_mm")
POINTS = np.array([[1.0, 2.0, 3.0], [5.0, 0.0, 9.0]])
FILES = {"block": "kamiyama_block", "finger": "sato_finger"}


def stiffness(body, modulus, mesh):
    material = Material(youngs_modulus_mpa=modulus)
    return Compliance(body, material, mesh, level="sketch", table=False)


@pytest.fixture(scope="module")
def both():
    return {
        name: stiffness(BODIES[name], 1.0, Mesh.read(MESHES / f"{file}.sketch.npz")) for name, file in FILES.items()
    }


@pytest.fixture
def block(both):
    return both["block"]


@pytest.fixture
def finger(both):
    return both["finger"]


def square(centre, width, body=BLOCK, force=PUSH):
    return tile(Traction.rectangle(centre, np.broadcast_to(width, 2).tolist(), force), body)


def imbalance(name, stiff, load):
    """How far the half-space's tractions on all faces are from adding up to the load, over it."""
    forces = unbalanced(TaylorHood(stiff.mesh, 0.5), LOOSE[name], [load])[0]
    total = load.force_n.sum(axis=0)
    return np.linalg.norm(forces.sum(axis=0)[:, 0] - total) / np.linalg.norm(total)


def test_tractions_on_a_tower_of_triangles_balance_the_load_and_the_clamp(tmp_path):
    """What is off here bends a tall body by many times its share."""
    height, turn = 30.0, 2.0 * np.pi * np.arange(8) / 7
    ring = 8.0 * np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    up = np.array([0.0, 0.0, height])
    corners = np.array(convex_hull(np.vstack([ring, ring + up])).triangles)
    held, sensing = ({"normal": (0, 0, z), "within_deg": 5} for z in (1, -1))
    body = Solid(file=str(write_stl(tmp_path / "tower.stl", corners)), held=held, sensing=sensing)
    stiff = Compliance(body, Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5), level="sketch", table=False)
    load = square((5.5, -1.0), 2.0, body)
    forces = unbalanced(stiff.system, body, [load])[0][:, :, 0]
    # The clamp's tractions, on seven triangles from its middle, each cut into 60 x 60 places.
    out, along = np.stack(np.meshgrid(*[(np.arange(60) + 0.5) / 60] * 2)).reshape(2, 1, -1, 1)
    places = (out * (ring[:-1, None] + along * (ring[1:] - ring[:-1])[:, None])).reshape(-1, 3)
    places += up
    areas = np.tile(out.ravel(), 7) * 64.0 * np.sin(turn[1]) / 60**2
    clamp = halfspace.stress(places, load, 0.5)[:, :, 2] * areas[:, None]
    pushed = load.force_n
    force = pushed.sum(axis=0) + clamp.sum(axis=0)
    torque = np.cross(load.centre_mm, pushed).sum(axis=0) + np.cross(places, clamp).sum(axis=0)
    size = np.linalg.norm(pushed.sum(axis=0))
    assert_allclose(forces.sum(axis=0), force, atol=2e-5 * size)
    assert_allclose(np.cross(stiff.mesh.points, forces).sum(axis=0), torque, atol=2e-5 * height * size)


def push(mesh, forces=tuple((f,) for f in PUSH)):
    return forces_on(mesh, nearest_node(mesh), forces)


POWERS = [2.0**-18, 2.0**20]
"""About four millionths and a million: even powers of two, which scale without rounding."""


@pytest.mark.parametrize("factor", [2.0**-10, 2.0**10])
def test_whole_bodies_scale_exactly_beyond_what_a_recipe_allows(block, factor):
    """From a tenth of a millimetre to a hundred metres; a recipe's range notices wrong units."""
    body = Block.model_construct(**{name: getattr(BLOCK, name) * factor for name in SIDES})
    other = stiffness(body, 1.0, replace(block.mesh, points=block.mesh.points * factor))
    load, unscaled = square((factor, -factor), 4 * factor, body), square((1, -1), 4)
    right = block.displacement(POINTS, unscaled)
    moved = other.displacement(POINTS * factor, load) * factor
    assert_allclose(moved, right, rtol=1e-12)
    assert other.expected_error(load) == pytest.approx(block.expected_error(unscaled))


@pytest.mark.parametrize("size", [2.0**-990, *POWERS, 2.0**990])
def test_force_scales_exactly(block, size):
    forces = push(block.mesh)
    scaled = block.system.solve(forces * size) / size
    assert_array_equal(scaled, block.system.solve(forces))


@pytest.mark.parametrize("nu", [-0.5, 0.4999999])
def test_ends_of_poissons_ratio(block, nu):
    forces, system = push(block.mesh, np.eye(3)), TaylorHood(block.mesh, nu)
    moved = system.solve(forces)
    assert system.factor.residual < 1e-11
    assert_holder_balances(system, 1e-9)
    at = nearest_node(block.mesh)
    assert_allclose(moved[at], moved[at].T, atol=1e-12)
    if nu > 0:
        near = 1e-6 * np.abs(moved).max()
        assert_allclose(moved, block.system.solve(forces), atol=near)


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-4])
@pytest.mark.parametrize("length", [45.0, 0.0], ids=["edge", "corner"])
def test_loads_at_an_edge_are_balanced_however_narrow(block, gap, length):
    load = square((50.0 - gap, 0.0 if length else 45.0 - gap), 2 * gap)
    assert imbalance("block", block, load) < 4e-3
    assert np.isfinite(block.displacement(np.array([[45.0, 40.0, 2.0]]), load)).all()


def test_loads_near_the_clamped_rim_are_balanced_and_leave_the_clamp_still(finger):
    """Nearer than an element the clamp is not still any more."""

    def at(z, width):
        return square((-3.0, 8.0, z), width, finger.body)

    assert imbalance("finger", finger, at(9.5, 1.0)) < 4e-3
    assert imbalance("finger", finger, at(9.99, 0.02)) < 4e-3
    points = np.array([[-3.0, 6.0, 10.0], [-2.0, 7.0, 10.0], [-3.0, 7.0, 8.0]])
    moved = np.linalg.norm(finger.displacement(points, at(8.0, 1.0)), axis=1)
    assert moved[:2].max() < 0.1 * moved[2]


def test_narrow_loads_tend_to_a_point(block):
    first, *fields = (block.displacement(POINTS, square((2, 1), w)) for w in (1e-3, 1e-6, 1e-100))
    for field in fields:
        assert_allclose(field, first, rtol=1e-6)


def pieces(load, width):
    """The same load, every rectangle cut into pieces no wider than ``width``."""
    out = []
    for one in range(len(load)):
        half, frame = load.half_mm[one], load.frames[one]
        number = np.ceil(2.0 * half / width).astype(int)
        a, b = ((np.arange(n) + 0.5) / n * 2.0 - 1.0 for n in number)
        place = np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2)
        centres = load.centre_mm[one] + (place * half) @ frame[:2]
        force = load.force_n[one] / number.prod()
        out.append(rectangles(centres, half / number, force, frame))
    return Rectangles.joined(out)


WIDE = [Traction.disk((2, 1), 6.0, PUSH), Traction.rectangle((2, 1), (12, 8), PUSH), Traction.twist((2, 1), 6.0, 10.0)]


@pytest.mark.parametrize("load", WIDE, ids=lambda load: load.terms[0].kind)
def test_wide_loads_are_the_sum_of_small_pieces(block, load):
    """Far from a load as near to it: a disk is a few dozen strips as long as the disk is wide."""
    points = np.array([[1.0, 2.0, 3.0], [9.0, -7.0, 6.0], [-11.0, 2.0, 3.0]])
    whole = tile(load, BLOCK)
    one, other = (block.displacement(points, each) for each in (whole, pieces(whole, 1.5)))
    assert_allclose(one, other, atol=2e-5 * np.abs(one).max())


def test_loads_on_an_edge_or_over_it_are_refused(block):
    for centre in ((50.0, 0.0, 0.0), (50.0 - 1e-5, 0.0, 0.0), (0.0, 45.0005, 0.0)):
        with pytest.raises(InputError, match=r"mm from the body's [xy]_max face .*move it inwards"):
            block.displacement(POINTS, rectangles(centre, 0.5, PUSH))
    words = r"hangs over the end of the sensing surface by 0.8 of its half side"
    with pytest.raises(InputError, match=words):
        block.displacement(POINTS, rectangles((49.9, 0.0, 0.0), 0.5, PUSH))
    with pytest.raises(InputError, match="partly off the sensing surface"):
        square((0, 0), (100.01, 90))


@pytest.mark.parametrize("what", ["centre_mm", "frames", "half_mm", "force_n"])
def test_rectangles_of_numbers_that_are_not_finite_are_named(block, what):
    load = rectangles((0.0, 0.0, 0.0), 0.5, PUSH)
    bad = np.array(getattr(load, what))
    bad.flat[0] = np.nan
    with pytest.raises(InputError, match=r"rectangle 0: its .* is not finite: check the load"):
        block.displacement(POINTS, replace(load, **{what: bad}))


@pytest.mark.parametrize(("name", "spread"), [("block", 20.0), ("finger", 4.0)])
def test_patches_move_each_other_alike(both, name, spread):
    """Betti: what a force on one patch does at another, it does the other way round.

    Against the finite body's part: the half-space's is symmetric by itself on a flat face.
    """
    body = BODIES[name]
    sites = body.chart_points(np.random.default_rng(5).uniform(-spread, spread, (6, 2)))
    patches = rectangles(sites, 0.05, 0.0, body.frames(sites))
    matrix = both[name].to_points(sites, patches)
    rest = matrix - halfspace.compliance(sites, patches, 1.0, 0.5)
    assert np.abs(matrix - matrix.T).max() < 0.03 * np.abs(rest).max()
