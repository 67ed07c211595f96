"""Solved fields on disk: equal to a solve, never outliving what made them, and never in the way."""

import os

import numpy as np
import pytest

from twin.parts.body import Finger
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.world.elasticity import store
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.solve import factorisations
from twin.world.elasticity.tile import tile
from twin.world.mesh.mesh import read_mesh

FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
POINTS = np.array([[0.0, 0.0, 1.0], [1.0, -1.0, 2.0]])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.store.cache_folder", lambda: tmp_path)
    return tmp_path


def stiff(nu=0.5):
    mesh = read_mesh(MESHES / "sato_finger.sketch.npz")
    return Compliance(FINGER, Material(poisson_ratio=nu), mesh, level="sketch")


def load(x=0.0):
    return tile(Traction.bump((x, 0), 1.0, (0.1, 0, 1)), FINGER, 0.4)


def patches():
    return tile(Traction.rectangle((0.5, 0.5), (2.0, 2.0), (0, 0, 1)), FINGER, 0.2)


def solves(action):
    before = factorisations()
    result = action()
    return result, factorisations() - before


def test_a_second_process_reads_what_the_first_solved(folder):
    first, count = solves(lambda: (stiff().displacement(POINTS, load()), stiff().to_points(POINTS, patches())))
    assert count == 2
    again, count = solves(lambda: (stiff().displacement(POINTS, load()), stiff().to_points(POINTS, patches())))
    assert count == 0
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[1], first[1])


def test_moved_markers_read_the_kept_fields_of_separate_patches(folder, monkeypatch):
    apart = tile(Traction.rectangle((0, 0), (6.0, 6.0), (0, 0, 1)), FINGER, 2.0)
    points = np.vstack([POINTS, POINTS + 0.5, POINTS + 1.0])
    first, count = solves(lambda: stiff().to_points(points, apart))
    assert count == 1
    assert solves(lambda: stiff().to_points(points + 0.1, apart))[1] == 0
    monkeypatch.setattr("twin.world.elasticity.spread.KEPT_BYTES", 0)
    again, count = solves(lambda: stiff().to_points(points, apart))
    assert count == 1
    np.testing.assert_allclose(again, first, atol=1e-6 * np.abs(first).max())


def test_another_load_material_or_code_is_another_field(folder, monkeypatch):
    stiff().displacement(POINTS, load())
    assert solves(lambda: stiff().displacement(POINTS, load(0.1)))[1] == 1
    assert solves(lambda: stiff(0.49).displacement(POINTS, load()))[1] == 1
    monkeypatch.setattr("twin.world.elasticity.store._code", lambda: b"changed")
    assert solves(lambda: stiff().displacement(POINTS, load()))[1] == 1


@pytest.mark.parametrize("damage", [b"", b"no", None])
def test_a_damaged_field_is_solved_anew(folder, damage):
    first = stiff().displacement(POINTS, load())
    (path,) = folder.glob("field-*.npy")
    path.write_bytes(path.read_bytes()[:-8] if damage is None else damage)
    again, count = solves(lambda: stiff().displacement(POINTS, load()))
    np.testing.assert_allclose(again, first, rtol=1e-12)
    assert count == 1


def test_single_precision_is_as_good_as_said(folder):
    exact = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(store.kept("a" * 64, lambda: exact, single=True), exact, atol=6e-8 * np.abs(exact).max())


def test_a_cache_that_cannot_be_written_costs_time_only(folder, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.store.cache_folder", lambda: folder / "missing")
    assert solves(lambda: stiff().displacement(POINTS, load()))[1] == 1


def test_the_oldest_fields_make_room(folder, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.store.LIMIT_BYTES", 2500)
    monkeypatch.setattr("twin.world.elasticity.store.EVERY", 1)
    for i, name in enumerate("abc"):
        monkeypatch.setitem(store._written, "fields", 0)
        store.kept(name * 64, lambda: np.zeros(125))
        os.utime(folder / f"field-{name * 40}.npy", (i, i))
    store.kept("a" * 64, lambda: np.zeros(125))  # used again, so it stays
    monkeypatch.setitem(store._written, "fields", 0)
    store.kept("d" * 64, lambda: np.zeros(125))
    assert sorted(path.name[6] for path in folder.glob("field-*.npy")) == ["a", "d"]
