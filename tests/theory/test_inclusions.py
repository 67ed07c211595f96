"""Beads: Faxen and the stresslet against a rigid sphere; the point force by its laws."""

import numpy as np
import pytest
from standard_bodies import rectangles

from benchmarks.bead_motion import bead_motion
from twin.theory import halfspace
from twin.theory.inclusions import dipole_displacement, mean_on_sphere, point_force, stresslet

SHEAR = 0.4


def sphere_points(count):
    """(count, 3) even points on the unit sphere (a spiral)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def turning(arms):
    """(n, 3, 3) matrices that turn an angle into the motion angle x arm."""
    return np.cross(np.eye(3)[None], arms[:, None]).swapaxes(1, 2)


def endless(points, sources, nu):
    """(n, m, 3, 3) mm/N: a point force in an endless body (Kelvin), typed here anew."""
    away = points[:, None] - sources[None]
    r = np.linalg.norm(away, axis=2)[..., None, None]
    outer = away[..., :, None] * away[..., None, :]
    return ((3 - 4 * nu) * np.eye(3) / r + outer / r**3) / (16 * np.pi * SHEAR * (1 - nu))


def free_sphere(outside, radius, green, centre=(0, 0, 0)):
    """Motion (3,) of a free rigid sphere in the field ``outside``, and its dipole (3, 3).

    Point forces on a smaller sphere, so that the whole field on the surface is a rigid motion.
    """
    skin, inner = sphere_points(320) * radius, sphere_points(130) * 0.5 * radius
    pushes = green(skin + centre, inner + centre).transpose(0, 2, 1, 3).reshape(3 * len(skin), -1)
    rigid = np.concatenate([np.tile(np.eye(3), (len(skin), 1)), turning(skin).reshape(-1, 3)], axis=1)
    balance = np.concatenate([np.tile(np.eye(3), (1, len(inner))), np.hstack(list(-turning(inner)))])
    matrix = np.block([[pushes, -rigid], [balance / SHEAR, np.zeros((6, 6))]])
    wanted = np.concatenate([-outside(skin + centre).ravel(), np.zeros(6)])
    answer, *_ = np.linalg.lstsq(matrix, wanted, rcond=1e-10)
    forces = answer[:-6].reshape(-1, 3)
    assert np.abs(matrix @ answer - wanted).max() < 2e-3 * np.abs(wanted).max(), "too few point forces"
    return answer[-6:-3], np.einsum("nj,nk->jk", forces, inner)


@pytest.mark.parametrize("nu", [0.2, 0.5])
def test_sphere_moves_with_the_mean_over_its_surface(nu):
    """u_x = z^2 + ... in equilibrium: laplacian (2, 0, 0) at nu = 1/2; it moves by a^2/3."""

    def bent(p):
        x, _, z = p.T
        k = 0.0 if nu == 0.5 else (1 - 2 * nu) / (2 * (1 - nu))
        return np.column_stack([z * z - k * x * x, 0 * x, 0 * x]) + 0.3 * p[:, [1, 2, 0]]

    radius = 0.7
    moved, _ = free_sphere(bent, radius, lambda p, s: endless(p, s, nu))
    assert moved == pytest.approx(mean_on_sphere(bent, np.zeros((1, 3)), radius)[0], abs=2e-4)
    if nu == 0.5:
        assert moved[0] == pytest.approx(radius**2 / 3, abs=2e-4)


def test_dipole_is_the_stresslet():
    strain = np.array([[1.0, 0.4, 0.1], [0.4, -0.3, 0.2], [0.1, 0.2, -0.7]])
    _, dipole = free_sphere(lambda p: p @ strain, 0.7, lambda p, s: endless(p, s, 0.5))
    dipole -= np.eye(3) * np.trace(dipole) / 3  # an even one moves nothing in incompressible rubber
    assert 0.5 * (dipole + dipole.T) == pytest.approx(stresslet(strain[None], 0.7, SHEAR)[0], abs=3e-3)


def under_surface(points, sources):
    shape = (len(points), len(sources), 3)
    return point_force(np.broadcast_to(points[:, None], shape), np.broadcast_to(sources, shape), SHEAR)


def test_two_beads_under_a_free_surface():
    """One 4 radii deep, 6.6 from the other: against the sphere solved in the other's field."""
    centres, radius = np.array([[0.0, 0.0, 1.0], [1.5, 0.6, 1.4]]), 0.25
    strain = np.array([[1.0, 0.4, 0.0], [0.4, -0.3, 0.0], [0.0, 0.0, -0.7]])
    motion = bead_motion(lambda p: p @ strain, lambda p: np.tile(strain, (len(p), 1, 1)), centres, radius, SHEAR)
    other = stresslet(strain[None], radius, SHEAR)
    solved, _ = free_sphere(
        lambda p: p @ strain + dipole_displacement(p, centres[1:], other, SHEAR), radius, under_surface, centres[0]
    )
    change = np.linalg.norm(motion.change[0])
    assert np.linalg.norm(solved - motion.passive[0] - motion.change[0]) < 0.05 * change


def test_point_force_meets_its_laws():
    """Symmetric, no divergence, no traction on the surface; the half-space for a force on it."""
    points = np.array([[0.3, -0.8, 1.7], [2.0, 1.0, 0.4]])
    a, b = points[:1], points[1:]
    assert under_surface(a, b)[0, 0] == pytest.approx(under_surface(b, a)[0, 0].T, rel=1e-12)
    step = 1e-30

    def slopes(p):
        return np.stack([point_force(p + 1j * step * k, b[0], SHEAR).imag / step for k in np.eye(3)], axis=-1)

    inside, above = slopes(a[0]), slopes(np.array([0.3, -0.8, 0.0]))
    assert np.einsum("iji->j", inside) == pytest.approx(np.zeros(3), abs=1e-12)
    assert above[0, :, 2] + above[2, :, 0] == pytest.approx(np.zeros(3), abs=1e-12)
    assert above[1, :, 2] + above[2, :, 1] == pytest.approx(np.zeros(3), abs=1e-12)
    force = rectangles(np.zeros(3), 0.0, np.eye(3)[0])
    known = halfspace.compliance(points, force, 3 * SHEAR, 0.5).reshape(2, 3, 3)
    assert under_surface(points, np.zeros((1, 3)))[:, 0] == pytest.approx(known, rel=1e-10)


def test_point_force_is_in_equilibrium():
    """G laplacian(u) is a pressure's gradient away from the force: its slopes are symmetric."""
    source, at, step = np.array([0.2, 0.1, 1.0]), np.array([1.0, -0.4, 0.6]), 0.02

    def laplacian(p):
        sides = [point_force(p + s * step * k, source, SHEAR) for k in np.eye(3) for s in (1, -1)]
        return (sum(sides) - 6 * point_force(p, source, SHEAR)) / step**2

    sides = [(laplacian(at + step * k) - laplacian(at - step * k)) / (2 * step) for k in np.eye(3)]
    slopes = np.stack(sides, axis=-1)
    assert slopes == pytest.approx(slopes.transpose(2, 1, 0), abs=0.01 * np.abs(slopes).max())
