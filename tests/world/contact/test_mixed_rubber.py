"""Rubber at finite strain: closed forms of the laws, homogeneous stretch of both meshes, slopes, a sliding sphere."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import twin
from twin.parts.body import Block, Finger
from twin.parts.material import Material
from twin.world.contact.mixed_rubber import MixedRubber
from twin.world.contact.probe_gap import Approach
from twin.world.contact.round_slab import Slab
from twin.world.contact.whole_body import LAST_STEP, Rubber, RubberContact, SurfaceTouch
from twin.world.elasticity.strain_law import cofactor_slope, cofactors, strain_law
from twin.world.mesh.bisection import refined
from twin.world.mesh.body_mesh import body_mesh

LAWS = [
    Material(law="neo_hookean"),
    Material(law="neo_hookean", poisson_ratio=0.47),
    Material(law="mooney_rivlin", law_ratios=(0.6,)),
    Material(law="yeoh", law_ratios=(0.3, 0.1)),
    Material(law="yeoh", law_ratios=(0.9, 1.25), poisson_ratio=0.45),
]
every_law = pytest.mark.parametrize("material", LAWS, ids=lambda one: f"{one.law}-{one.poisson_ratio}")
both_meshes = pytest.mark.parametrize("kind", ["slab", "body"])

TURN = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
TURN *= np.linalg.det(TURN)
BODY = Block(width_mm=6, length_mm=5, thickness_mm=4)
RADIUS, THICK = 5.0, 3.0
GRID = Slab.Grid(RADIUS * np.array([0, 0.08, 0.16, 0.24, 0.32, 0.6, 1.0]), np.array([0, 0.3, 0.6, 0.9, 1.7, THICK]), 4)


def energy_slopes(material, first):
    """Return dW/dI1 and dW/dI2 for a shear modulus of 1 at an I1, by the textbook's constants."""
    ratios = material.law_ratios
    if material.law == "mooney_rivlin":
        return 0.5 / (1.0 + ratios[0]), 0.5 * ratios[0] / (1.0 + ratios[0])
    if material.law == "yeoh":
        return 0.5 * (1.0 + 2.0 * ratios[0] * (first - 3.0) + 3.0 * ratios[1] * (first - 3.0) ** 2), 0.0
    return 0.5, 0.0


def stretched(material, stretch):
    """Return the stretch of the sides of rubber in tension, which are free, and the nominal stress, E = 1 MPa."""
    nu = material.poisson_ratio
    if nu == 0.5:
        first, second = energy_slopes(material, stretch**2 + 2.0 / stretch)
        return stretch**-0.5, 2.0 / 3.0 * (stretch - stretch**-2) * (first + second / stretch)

    def slopes(thin):
        # W(I1) - (J - 1) + ((1 - 8 c11) + lambda) (J - 1)^2 / 2, c11 the factor of (I1 - 3)^2, by each stretch
        by_first = 2.0 * energy_slopes(material, stretch**2 + 2.0 * thin**2)[0]
        bend = energy_slopes(material, 4.0)[0] - energy_slopes(material, 2.0)[0]  # 4 c11: an odd part's
        swollen = (1.0 - 2.0 * bend + 2.0 * nu / (1.0 - 2.0 * nu)) * (stretch * thin**2 - 1.0) - 1.0
        return by_first * stretch + swollen * thin**2, by_first + swollen * stretch

    thin = brentq(lambda one: slopes(one)[1], 1.0, 0.4 if stretch > 1.0 else 1.6, xtol=1e-14)
    return thin, slopes(thin)[0] / (2.0 * (1.0 + nu))


def stress_at(law, gradient, pressure):
    """Return P for a shear modulus of 1."""
    cofactor, ratio = cofactors(gradient)
    return law.stress(gradient, cofactor, ratio) + pressure * cofactor


@every_law
@pytest.mark.parametrize("shear", [0.1, 1.0])
def test_simple_shear_is_the_closed_form(material, shear):
    """Cauchy's stresses 2 (W1 + W2) g, and 2 W1 g^2 and -2 W2 g^2 as differences of normal ones (Rivlin 1948)."""
    gradient = np.eye(3)
    gradient[0, 1] = shear
    cauchy = stress_at(strain_law(material), gradient, 0.3) @ gradient.T
    first, second = energy_slopes(material, 3.0 + shear**2)
    assert cauchy[0, 1] == pytest.approx(2.0 * (first + second) * shear, rel=1e-12)
    assert cauchy[0, 0] - cauchy[2, 2] == pytest.approx(2.0 * first * shear**2, rel=1e-11)
    assert cauchy[1, 1] - cauchy[2, 2] == pytest.approx(-2.0 * second * shear**2, rel=1e-11, abs=1e-12)


@every_law
def test_law_turns_with_the_frame_and_is_linear_theory_at_rest(material):
    law = strain_law(material)
    rng = np.random.default_rng(5)
    gradient = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert stress_at(law, turn @ gradient, 0.7) == pytest.approx(turn @ stress_at(law, gradient, 0.7), abs=1e-12)
    assert stress_at(law, turn, 0.0) == pytest.approx(np.zeros((3, 3)), abs=1e-12)
    cofactor, ratio = cofactors(np.eye(3))
    small = rng.standard_normal((3, 3))
    slope = law.slope(np.eye(3), cofactor, ratio, cofactor_slope(np.eye(3)))
    linear = small + small.T + law.bulk * np.trace(small) * np.eye(3)
    assert np.einsum("ijkl,kl->ij", slope, small) == pytest.approx(linear, abs=1e-12)


def rubber_of(kind, material):
    """Return rubber and the places (N, axes) of its nodes."""
    if kind == "body":
        rubber = Rubber(body_mesh(BODY, "sketch"), BODY, material)
        return rubber, rubber.mesh.points
    return Slab(GRID, material), GRID.places


def put(rubber, moved, pressure=0.0):
    unknowns = np.full(rubber.size, pressure)
    unknowns[: moved.size] = moved.ravel()
    return unknowns


@both_meshes
@pytest.mark.parametrize("stretch", [0.5, 0.9, 1.7, 2.0])
@every_law
def test_homogeneous_stretch_is_in_balance_and_carries_the_closed_form(kind, material, stretch):
    """A patch test at large strain, of the body also turned: the nominal stress is 2 (l - l^-2) (W1 + W2 / l)
    (Treloar 1975), of compressible rubber the slope of its energy; the sides are free, E = 1 MPa."""
    thin, nominal = stretched(material, stretch)
    rubber, points = rubber_of(kind, material)
    z = points[:, -1]
    ends = np.isclose(z, z.min()) | np.isclose(z, z.max())
    side = np.isclose(points[:, 0], points[:, 0].max())
    if kind == "slab":
        gradient, area = np.diag([thin, stretch]), math.pi * RADIUS**2
        free = ~ends & (points[:, 0] > 0.0)
    else:
        gradient, area = TURN @ np.diag([thin, thin, stretch]), 30.0
        free = ~ends
        side &= ~ends & (np.abs(points[:, 1]) < 2.5 - 1e-9)  # only nodes that lie on no other side
    out, along = gradient[:, 0] / thin, gradient[:, -1] / stretch
    moved = points @ (gradient - np.eye(len(out))).T
    # The pressure under which the sides are free, from what they carry without it.
    before = rubber.displacement(rubber.resistance(put(rubber, moved)))
    per_pressure = rubber.displacement(rubber.resistance(put(rubber, moved, 1.0))) - before
    pressure = -float((before[side] @ out).sum() / (per_pressure[side] @ out).sum())
    whole = rubber.resistance(put(rubber, moved, pressure))
    force = rubber.displacement(whole)
    for end, sign in ((z.max(), 1.0), (z.min(), -1.0)):
        assert force[np.isclose(z, end)].sum(axis=0) @ along == pytest.approx(sign * area * nominal, rel=1e-9)
    assert np.abs(force[free]).max() < 1e-9
    assert np.abs(whole[moved.size :]).max() < 1e-10


@every_law
def test_twisted_rubber_carries_rivlins_torque_and_pushes_its_ends_apart(material):
    """Rivlin (1949): the torque is the integral of 2 t R^2 (W1 + W2) over the section, the force along the axis that
    of -t^2 R^2 (W1 + 2 W2), t the twist: as work of the rubber's forces in twist and in stretch of one volume."""
    mesh = refined(body_mesh(BODY, "sketch"), BODY, lambda points: np.full(len(points), 0.9))
    rubber, (x, y, z) = Rubber(mesh, BODY, material), mesh.points.T
    twist, step = 0.15, 1e-4

    def moved(twist, stretch):
        cos, sin = np.cos(twist * z), np.sin(twist * z)
        return np.column_stack([cos * x - sin * y, sin * x + cos * y, stretch**1.5 * z]) / stretch**0.5 - mesh.points

    force = rubber.displacement(rubber.resistance(put(rubber, moved(twist, 1.0), 0.3)))
    by_twist = (moved(twist + step, 1.0) - moved(twist - step, 1.0)) / (2.0 * step)
    by_stretch = (moved(twist, 1.0 + step) - moved(twist, 1.0 - step)) / (2.0 * step)
    at, weights = np.polynomial.legendre.leggauss(8)
    squared = np.add.outer((3.0 * at) ** 2, (2.5 * at) ** 2)
    first, second = energy_slopes(material, 3.0 + twist**2 * squared)
    volume = np.multiply.outer(3.0 * weights, 2.5 * weights) * 4.0 / (2.0 * (1.0 + material.poisson_ratio))
    torque = np.sum(volume * 2.0 * twist * squared * (first + second))
    push = -np.sum(volume * twist**2 * squared * (first + 2.0 * second))
    assert np.sum(force * by_twist) == pytest.approx(torque, rel=2e-3)
    assert np.sum(force * by_stretch) == pytest.approx(push, rel=1e-2)


@both_meshes
@every_law
def test_tangent_is_symmetric_and_the_slope_of_the_resistance(kind, material):
    rubber, points = rubber_of(kind, material)
    rng = np.random.default_rng(2)
    way = rng.standard_normal(rubber.size)
    if kind == "body":
        moved = 0.1 * np.sin(points @ rng.standard_normal((3, 3)))
        turned = (points + moved) @ TURN.T - points
        force, after = (rubber.displacement(rubber.resistance(put(rubber, one, 0.2))) for one in (moved, turned))
        assert after == pytest.approx(force @ TURN.T, abs=1e-10)
    else:
        moved = 0.02 * rng.standard_normal(points.shape)
        for one in (moved, rubber.displacement(way)):
            one[points[:, 0] == 0.0, 0] = 0.0  # nothing leaves the axis
    unknowns = put(rubber, moved, 0.2)
    step = 1e-6
    slope = (rubber.resistance(unknowns + step * way) - rubber.resistance(unknowns - step * way)) / (2.0 * step)
    tangent = rubber.tangent(unknowns)
    assert tangent @ way == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())
    assert abs(tangent - tangent.T).max() < 1e-12 * abs(tangent).max()


class Place(MixedRubber):
    """Nodes on a line, whose displacements are the numbers (n,) of a place."""

    _axes = 1

    def __init__(self, unknowns):
        super().__init__(LAWS[0])
        self.unknowns, self._moves = unknowns, len(unknowns)


def mixed(step, start, tolerance, seen=None):
    """Return the place (n,) where mixed steps end."""
    mix = MixedRubber.mixing(len(start) if seen is None else seen, 5)
    steps = (lambda one: Place(step(one.unknowns))), Place(start), 40, tolerance
    return Place(start).newton(*steps, lambda one: Place(mix(one.unknowns))).unknowns


def test_mixed_steps_solve_what_plain_steps_leave():
    """Steps with five rates, of which one grows: six changes suffice (H. F. Walker and P. Ni 2011). The second half of
    the numbers follows the first, as pressures do."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.standard_normal((10, 10)))[0]
    matrix = turn @ np.diag(np.repeat([-1.5, -0.6, 0.2, 0.5, 0.9], 2)) @ turn.T
    wanted, taken = rng.standard_normal(20), []

    def step(place):
        taken.append(place)
        return wanted + np.tile(matrix @ (place - wanted)[:10], 2)

    assert mixed(step, np.zeros(20), 1e-10, seen=10) == pytest.approx(wanted, abs=1e-9)
    assert len(taken) <= 8


def test_mixed_steps_do_not_end_where_one_returns_to_the_last_ones_end():
    """From 0 to 1 to 3/2, and mixed from 2 back to 3/2, which the next one would leave: only 5/3 stays."""
    found = mixed(lambda x: np.minimum(1.0 + x / 2.0, 2.5 - x / 2.0), np.zeros(1), 1e-6)
    assert found == pytest.approx([5.0 / 3.0], abs=1e-5)


@pytest.mark.parametrize("linear", [True, False], ids=["linear", "finite"])
@pytest.mark.parametrize("direction", [None, "normal"], ids=["down", "normal"])
def test_gap_and_push_have_their_slopes(direction, linear):
    body = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
    mesh = body_mesh(body, "sketch")
    at = (-2.0, 3.0, *body.surface_from_above(np.array([[-2.0, 3.0]]))[0, 2:])
    press = twin.Press(probe=twin.Sphere(diameter_mm=3), at_mm=at, direction=direction, indentation_mm=0.5)
    approach = Approach.of_press(press, body)
    touch = SurfaceTouch(mesh, body, approach, False, [(approach.touch_mm, 0.5)])
    moved = 0.05 * np.sin(mesh.points)
    pose = np.array([0.1, -0.05, 0.4, 0.02, -0.03, 0.01])
    step = 1e-5

    def meet(shift=0.0, motion=0.0):
        return touch.meet(moved + shift, pose + motion, linear=linear)

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


@pytest.mark.parametrize("friction", [pytest.param(0.2, marks=pytest.mark.slow), 0.8])
def test_sphere_that_slides_is_rubbed_by_the_coefficient_times_its_pressure_along_the_deformed_surface(friction):
    """What the rubber resists with, less the pressure along the present normals, is friction: at its bound
    once the points slide, and on the way there below it."""
    deep, steps = 0.3, 5
    body = Block(width_mm=10, length_mm=10, thickness_mm=5)
    press = twin.Press(probe=twin.Sphere(diameter_mm=6), indentation_mm=deep)
    approach = Approach.of_press(press, body)

    def wanted(points):
        return 0.9 + 0.8 * np.maximum(np.linalg.norm(points - approach.touch_mm, axis=1) - 1.2, 0.0)

    mesh = refined(body_mesh(body, "sketch"), body, wanted, local=True)
    touch = SurfaceTouch(mesh, body, approach, True, [(approach.touch_mm, 2.5)])
    contact = RubberContact(mesh, body, LAWS[0], [touch], 1.0, friction)
    rubber = contact.rubber
    by_motion = np.zeros((1, 6), bool)
    place = deep * np.eye(6)[2][None]
    guess = replace(contact.at_rest(), pose=place, active=touch.rest_gap(np.zeros(6))[0] < deep / 2)
    state = contact.rubbed(contact.at_rest(), guess, by_motion, place, LAST_STEP, linear=False)
    shares = []
    for step in range(1, steps + 1):
        place = np.array([[2.5 * friction * deep * step / steps, 0.0, deep, 0.0, 0.0, 0.0]])
        state = contact.rubbed(state, state, by_motion, place, LAST_STEP, linear=False)
        moved = rubber.displacement(state.unknowns)
        on_body = rubber.displacement(rubber.resistance(state.unknowns))[np.unique(touch.nodes)].sum(axis=0)
        met = touch.meet(moved, state.pose[0], linear=False)
        on = state.pressure > 0.0
        push = (state.pressure * touch.area_mm2)[on, None] * met.push[on]
        normal = met.normal[on]
        way = np.array([1.0, 0.0, 0.0]) - normal[:, :1] * normal
        way /= np.linalg.norm(way, axis=1)[:, None]
        most = friction * np.linalg.norm(push, axis=1) @ way[:, 0]
        shares.append((on_body - push.sum(axis=0))[0] / most)
    assert state.slips[on].mean() > 0.95
    assert shares[-1] == pytest.approx(1.0, abs=1e-2)
    assert np.all(np.diff(shares) > -1e-3)
    assert shares[0] < 0.7
    assert state.force[0, :3] == pytest.approx(on_body, abs=2e-3 * state.force[0, 2])
