"""Stiff beads for one press after another: the kept map against the formulas."""

import numpy as np
import pytest

from twin.parts.body import Block
from twin.parts.markers import MarkerLayer, place
from twin.theory.inclusions import dipole_displacement, mean_on_sphere, stresslet
from twin.world.elasticity import rigid_beads
from twin.world.elasticity.rigid_beads import StiffBeads

BODY = Block(width_mm=60, length_mm=60, thickness_mm=40)
GRID = {"columns": 4, "rows": 3, "pitch_mm": 1.5, "colour": (1, 1, 1)}
LAYERS = {
    "red": MarkerLayer(depth_mm=5, diameter_mm=0.6, stiff=True, **GRID),
    "soft": MarkerLayer(depth_mm=4, diameter_mm=0.3, offset_mm=(0.75, 0.75), kind="print", **GRID),
    "blue": MarkerLayer(depth_mm=3, diameter_mm=0.4, stiff=True, **GRID),
}
SHEAR = 0.7


def field(p):
    """An uneven field without divergence."""
    x, y, z = p.T
    return 1e-3 * np.column_stack([z * z + y + x, x * z + 2 * y, x * y - 0.5 * x * x - 3 * z])


def gradient(p):
    x, y, z = p.T
    zero = 0 * x
    rows = [[zero + 1, zero + 1, 2 * z], [z, zero + 2, x], [y - x, x, zero - 3]]
    return 1e-3 * np.array(rows).transpose(2, 0, 1)


@pytest.mark.parametrize("most", [rigid_beads.MOST_KEPT, 0])
def test_every_layer_has_its_own_size_and_soft_ones_are_pushed_along(most, monkeypatch):
    monkeypatch.setattr(rigid_beads, "MOST_KEPT", most)
    markers = place(BODY, LAYERS)
    beads = StiffBeads.of(markers, LAYERS)
    assert (beads.per_strain is None) == (most == 0)
    change = beads.change(field, gradient(markers.points))
    slopes = gradient(markers.points)
    strain = 0.5 * (slopes + slopes.swapaxes(1, 2))
    known = np.zeros_like(markers.points)
    for name, radius in (("red", 0.3), ("blue", 0.2)):
        mine = markers.of(name)
        dipoles, centres = stresslet(strain[mine], radius, SHEAR), markers.points[mine]
        for row, point in enumerate(markers.points):
            known[row] += dipole_displacement(
                point[None],
                centres,
                dipoles,
                SHEAR,
                np.array([row - mine.start if row in range(*mine.indices(36)) else -1]),
            )[0]
        known[mine] += mean_on_sphere(field, centres, radius) - field(centres)
    assert change == pytest.approx(known, abs=1e-6 * np.abs(known).max())
    assert np.abs(change[markers.of("soft")]).max() > 0.1 * np.abs(change).max()


def test_without_a_stiff_layer_there_is_nothing_to_change():
    layers = {name: layer.model_copy(update={"stiff": False}) for name, layer in LAYERS.items()}
    assert StiffBeads.of(place(BODY, layers), layers) is None
