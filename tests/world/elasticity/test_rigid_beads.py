"""Stiff beads for one press after another: the kept map against the formulas; the option, off unless asked."""

import json

import numpy as np
import pytest

import twin
from twin.errors import RecipeError
from twin.files import SCENES
from twin.parts.body import Block
from twin.parts.markers import MarkerLayer, MarkerSet
from twin.sense.calibration import read_calibration
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene
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
    markers = MarkerSet.place(BODY, LAYERS)
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
    assert StiffBeads.of(MarkerSet.place(BODY, layers), layers) is None


DRAWN = {"tolerance.preset": "none"}
STIFF = {"markers.red.stiff": True, "markers.blue.stiff": True}
ASIDE = {"markers.red.offset_mm": [0.2, 0.2], "markers.blue.offset_mm": [0.2, 0.2]}


@pytest.mark.parametrize(
    ("force_n", "largest", "red", "sideways"), [((0, 0, 1), 1.34, 0.436, -2.43), ((1, 0, 0), 1.16, 0.322, -0.566)]
)
def test_beads_change_what_the_study_found(force_n, largest, red, sideways) -> None:
    """In percent, second order, as stored in benchmarks/results/inclusions.json; the option is of first order."""
    load = twin.Traction.disk((0, 0), 2.5, force_n)
    passive, sensor = (twin.Sensor(load_scene("kamiyama_pillar", {**DRAWN, **more})) for more in ({}, STIFF))
    points, stiff = passive.motion(load), sensor.motion(load)
    change = 100 * (stiff.displacement_mm - points.displacement_mm)
    size = np.linalg.norm(points.displacement_mm, axis=1).max()
    assert np.linalg.norm(change, axis=1).max() / size == pytest.approx(largest, abs=0.02)
    assert np.linalg.norm(change[sensor.actual.markers.of("red")], axis=1).max() / size == pytest.approx(red, abs=0.01)
    flat = points.displacement_mm[:, :2]
    assert np.vdot(change[:, :2], flat) / np.vdot(flat, flat) == pytest.approx(sideways, abs=0.04)
    assert 0 < 100 * (stiff.error - points.error) < 0.2 * largest
    np.testing.assert_array_equal(stiff.gradient, points.gradient)
    np.testing.assert_array_equal(sensor.nominal_markers.points, passive.nominal_markers.points)


def test_rubber_contact_and_software_know_nothing_of_beads() -> None:
    load, inside = twin.Traction.disk((0, 0), 2.5, (0, 0, 1)), np.array([[1.0, 0.0, 0.0], [0.5, 0.2, 3.0]])
    passive, sensor = (twin.Sensor(load_scene("kamiyama_pillar", more)) for more in ({}, STIFF))
    np.testing.assert_array_equal(sensor.displacement(inside, load), passive.displacement(inside, load))
    assert sensor.press().indentation_mm == passive.press().indentation_mm
    near = sensor.nominal_markers.points[:20]
    sites = sensor.rectangles(load)
    np.testing.assert_array_equal(
        sensor.nominal_compliance.to_points(near, sites), passive.nominal_compliance.to_points(near, sites)
    )


def test_beads_without_load_stay() -> None:
    sensor = twin.Sensor(load_scene("kamiyama_pillar", STIFF))
    assert not sensor.motion(twin.Load()).displacement_mm.any()


@pytest.mark.parametrize(
    ("scene", "changed", "said"),
    [
        ("kamiyama_pillar", {"markers.red.kind": "print"}, "markers.red: stiff = true: a print strains"),
        ("sato_press", {}, "markers.red: stiff = true: a print strains"),
        ("sato_press", {"markers.red.kind": "bead"}, "in a block only, this body is a finger"),
        ("kamiyama_pillar", {"material.poisson_ratio": 0.491}, "may be as low as 0.4885"),
        ("kamiyama_pillar", {"cover.youngs_modulus_mpa": 5.0}, "a cover of another material than the body's"),
        ("kamiyama_pillar", {"markers.red.depth_mm": 0.9}, "0.9 mm from the sensing surface, but must be at least 1"),
        ("kamiyama_pillar", {"markers.red.pitch_mm": 0.8}, "0.8 mm from each other, but must be at least 1 mm"),
        ("kamiyama_pillar", {"markers.red.depth_mm": 3.1, **ASIDE}, "1.07 mm from those of markers.blue, but must be"),
        ("kamiyama_pillar", {"body.thickness_mm": 20}, "14 mm from a side or the base"),
    ],
)
def test_what_the_correction_does_not_hold_for_is_refused(scene, changed, said) -> None:
    size = {"markers.red.diameter_mm": 0.6} if "markers.blue" in said else {}
    with pytest.raises(RecipeError, match=said.replace("(", r"\(")):
        load_scene(scene, {**changed, **size, "markers.red.stiff": True})


def test_a_tolerance_of_none_allows_the_lowest_poisson_ratio() -> None:
    assert load_scene("kamiyama_pillar", {**DRAWN, **STIFF, "material.poisson_ratio": 0.49}).markers["red"].stiff


def test_layers_are_soft_unless_said_and_old_calibrations_stay_valid() -> None:
    for name in ("kamiyama_pillar", "sato_press"):
        scene = load_scene(name)
        assert not any(layer.stiff for layer in scene.markers.values())
    stored = json.loads(read_calibration(SCENES / "sato_calibration.npz").provenance)
    for law in ("linear", "neo_hookean"):  # calibration presses stick: they are linear theory's by every law
        assert calibration_of(twin.Sensor(load_scene("sato_press", {"material.law": law}))).facts == stored
    digests = [calibration_of(twin.Sensor(load_scene("kamiyama_pillar", keys))).facts["digest"] for keys in ({}, STIFF)]
    assert digests[0] != digests[1]
