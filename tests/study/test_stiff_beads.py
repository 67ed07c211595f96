"""The option of stiff beads: off unless asked, worth what the study found, in the truth only, refused where unknown."""

import json

import numpy as np
import pytest

import twin
from twin.errors import RecipeError
from twin.files import SCENES
from twin.sense.calibration import read_calibration
from twin.study.calibrate import calibration_of
from twin.study.recipe import load_scene

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
