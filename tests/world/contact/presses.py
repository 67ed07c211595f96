"""Presses on a half-space in closed form, for the tests of contact."""

import math

import numpy as np
import trimesh
from standard_bodies import BLOCK

from twin.parts.load import Rectangles
from twin.parts.press import Cylinder, Pillar, Press, Sphere, Step
from twin.theory import halfspace
from twin.world.contact.pressing import press

STUCK = math.inf


class HalfSpace:
    """The compliance of a half-space under every patch's own tangent plane, made symmetric."""

    one_material = True

    def __init__(self, youngs_modulus_mpa=1.0, poisson_ratio=0.5):
        self.rubber = youngs_modulus_mpa, poisson_ratio

    def to_points(self, points, rectangles):
        return halfspace.compliance(points, rectangles, *self.rubber)

    def surface(self, rectangles):
        found = halfspace.compliance(rectangles.centre_mm, rectangles, *self.rubber)
        return (found + found.T) / 2.0


def pressed(wanted, body=BLOCK, e=1.0, nu=0.5, across=16, on=None, **more):
    """Press on a half-space, or on a compliance ``on`` of its own."""
    surface = HalfSpace(e, nu) if on is None else on
    more |= {"patches_across": across, "youngs_modulus_mpa": e, "poisson_ratio": nu}
    return press(wanted, body, surface, **more)


def settled(compliance, wanted):
    """Return the forces on cells that a rigid face sinks by ``wanted``, none of which pulls."""
    touching = wanted > 0.0
    for _ in range(100):
        force = np.zeros(len(wanted))
        force[touching] = np.linalg.solve(compliance[np.ix_(touching, touching)], wanted[touching])
        following = np.where(touching, force >= 0.0, compliance @ force < wanted - 1e-12)
        if np.array_equal(following, touching):
            return force
        touching = following
    raise AssertionError("the cells in contact don't settle")


def ball(diameter_mm, **keys):
    return Press(probe=Sphere(diameter_mm=diameter_mm), **keys)


def punch(diameter_mm, **keys):
    return Press(probe=Cylinder(diameter_mm=diameter_mm), **keys)


def face(width_mm, **keys):
    return Press(probe=Pillar(width_mm=width_mm), **keys)


def down(move_z):
    return Step(move_mm=(None, None, move_z))


def sideways(x):
    return Step(move_mm=(x, None, None))


def push(z, **more):
    """Return a step of a given push whose other motions stay as they are, unless given."""
    return Step(force_n={"z": z}, **more)


def pushed(x=0.0, y=0.0, z=0.5, torque=None):
    """Return a step of a whole force."""
    return Step(force_n=(x, y, z), torque_nmm=torque)


def only(state):
    (term,) = state.load.terms
    assert isinstance(term, Rectangles)
    return term


def centre_of(state):
    """Return (3,) the centre of pressure along z, mm."""
    patches = only(state)
    return patches.force_n[:, 2] @ patches.centre_mm / patches.force_n[:, 2].sum()


def radii_of(state):
    """Return (k,) the patches' distances from the axis, mm."""
    return np.hypot(*only(state).centre_mm[:, :2].T)


def shear_of(state):
    """Return (k,) tangential tractions, MPa."""
    along = state.pressure_mpa[:, None] * only(state).frames[:, 2]
    return np.linalg.norm(state.traction_mpa - along, axis=1)


def assert_coulomb(state, mu, share=1e-8):
    """Tractions leave Coulomb's cone by less than a share of the peak pressure."""
    assert np.max(shear_of(state) - mu * state.pressure_mpa) <= share * state.peak_pressure_mpa


def patch_areas(state):
    return 4.0 * np.prod(only(state).half_mm, axis=1)


def hull(points):
    """Return vertices and outward triangles of a convex solid."""
    solid = trimesh.convex.convex_hull(points)
    return np.asarray(solid.vertices), np.asarray(solid.faces)


def jacobian_of(turning):
    """Return (k, 3, 4) how patches follow three motions and a turn, (2, k) along x and y."""
    carried = np.zeros((np.shape(turning)[1], 3, 4))
    carried[:, range(3), range(3)] = 1.0
    carried[:, :2, 3] = np.transpose(turning)
    return carried
