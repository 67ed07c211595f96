"""Solved fields on disk: equal to a solve, never outliving what made them; the sparse solver checks every solve."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import bmat, csr_matrix, eye, random_array
from standard_bodies import FINGER, assert_near

from twin.errors import SolveError
from twin.files import MESHES
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity import cache
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile
from twin.world.elasticity.factor import LIMIT, Factor
from twin.world.mesh import quadratic_mesh
from twin.world.mesh.quadratic_mesh import Mesh

POINTS = np.array([[0.0, 0.0, 1.0], [1.0, -1.0, 2.0]])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.cache.cache_folder", lambda: tmp_path)
    return tmp_path


def stiff(nu=0.5):
    mesh = Mesh.read(MESHES / "sato_finger.sketch.npz")
    return Compliance(FINGER, Material(poisson_ratio=nu), mesh, level="sketch")


def load(x=0.0):
    return tile(Traction.bump((x, 0), 1.0, (0.1, 0, 1)), FINGER, 0.4)


def patches():
    return tile(Traction.rectangle((0.5, 0.5), (2.0, 2.0), (0, 0, 1)), FINGER, 0.2)


def solves(action):
    before = Factor.made
    result = action()
    return result, Factor.made - before


def test_a_second_process_reads_what_the_first_solved(folder):
    first, count = solves(lambda: (stiff().displacement(POINTS, load()), stiff().to_points(POINTS, patches())))
    assert count == 2
    again, count = solves(lambda: (stiff().displacement(POINTS, load()), stiff().to_points(POINTS, patches())))
    assert count == 0
    assert_array_equal(again[0], first[0])
    assert_array_equal(again[1], first[1])


def test_moved_markers_read_the_kept_fields_of_separate_patches(folder, monkeypatch):
    apart = tile(Traction.rectangle((0, 0), (6.0, 6.0), (0, 0, 1)), FINGER, 2.0)
    points = np.vstack([POINTS, POINTS + 0.5, POINTS + 1.0])
    first, count = solves(lambda: stiff().to_points(points, apart))
    assert count == 1
    assert solves(lambda: stiff().to_points(points + 0.1, apart))[1] == 0
    monkeypatch.setattr("twin.world.elasticity.interpolated.KEPT_BYTES", 0)
    again, count = solves(lambda: stiff().to_points(points, apart))
    assert count == 1
    assert_near(again, first, 1e-6)


def test_another_load_or_material_is_another_field(folder):
    stiff().displacement(POINTS, load())
    assert solves(lambda: stiff().displacement(POINTS, load(0.1)))[1] == 1
    assert solves(lambda: stiff(0.49).displacement(POINTS, load()))[1] == 1


def test_changed_code_makes_other_fields(folder, monkeypatch, tmp_path_factory):
    """The sources of meshes are read from a copy, by the module as a new process would load it."""
    copy = tmp_path_factory.mktemp("sources") / "mesh"
    shutil.copytree(Path(quadratic_mesh.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def in_a_new_process():
        loaded = importlib.util.spec_from_file_location("loaded_again", cache.__file__)
        module = importlib.util.module_from_spec(loaded)
        monkeypatch.setitem(sys.modules, "loaded_again", module)
        loaded.loader.exec_module(module)
        monkeypatch.setattr("twin.world.elasticity.compliance.field_key", module.field_key)
        return solves(lambda: stiff().displacement(POINTS, load()))[1]

    stiff().displacement(POINTS, load())
    monkeypatch.setattr(quadratic_mesh, "__file__", str(copy / Path(quadratic_mesh.__file__).name))
    assert in_a_new_process() == 0
    with (copy / "snap.py").open("a") as source:
        source.write("CHANGED = 1\n")
    assert in_a_new_process() == 1


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"no"),
        lambda path: path.write_bytes(path.read_bytes()[:-8]),
        lambda path: np.save(path, np.load(path).astype(np.float32)),
        lambda path: np.save(path, np.load(path).T),
        lambda path: np.save(path, np.load(path) * np.nan),
    ],
    ids=["empty", "two bytes", "cut", "single", "turned", "NaN"],
)
def test_a_field_that_is_damaged_or_of_another_kind_is_solved_again(folder, spoil):
    first = stiff().displacement(POINTS, load())
    (path,) = folder.glob("field-*.npy")
    spoil(path)
    again, count = solves(lambda: stiff().displacement(POINTS, load()))
    assert_allclose(again, first, rtol=1e-12)
    assert count == 1


def test_single_precision_is_as_good_as_said(folder):
    exact = np.random.default_rng(1).normal(size=(50, 3))
    assert_near(cache.cached_field("a" * 64, lambda: exact, exact.shape, single=True), exact, 6e-8)


def test_a_cache_that_cannot_be_written_costs_time_only(folder, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.cache.cache_folder", lambda: folder / "missing")
    assert solves(lambda: stiff().displacement(POINTS, load()))[1] == 1


def test_the_oldest_fields_make_room(folder, monkeypatch):
    monkeypatch.setattr("twin.world.elasticity.cache.LIMIT_BYTES", 2500)
    monkeypatch.setattr("twin.world.elasticity.cache.EVERY", 1)
    for i, name in enumerate("abc"):
        cache.cached_field(name * 64, lambda: np.zeros(125), (125,))
        os.utime(folder / f"field-{name * 40}.npy", (i, i))
    cache.cached_field("a" * 64, lambda: np.zeros(125), (125,))  # used again, so it stays
    cache.cached_field("d" * 64, lambda: np.zeros(125), (125,))
    assert sorted(path.name[6] for path in folder.glob("field-*.npy")) == ["a", "d"]


def saddle(pressures=30, displacements=90):
    rng = np.random.default_rng(5)
    spread = random_array((displacements, displacements), density=0.05, rng=rng)
    stiffness = spread @ spread.T + eye(displacements)
    divergence = random_array((pressures, displacements), density=0.2, rng=rng)
    matrix = csr_matrix(bmat([[stiffness, divergence.T], [divergence, None]]))
    return matrix, np.concatenate([np.zeros(displacements), np.ones(pressures)])


@pytest.mark.parametrize("solver", Factor.solvers())
def test_indefinite_system_is_solved_to_the_dense_answer(solver):
    matrix, scale = saddle()
    right = np.random.default_rng(1).normal(size=(len(scale), 3))
    before = Factor.made
    factor = Factor(matrix, scale, solver)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix.toarray(), right), rtol=1e-6, atol=1e-8)
    factor.solve(right[:, 0])
    assert factor.residual < LIMIT
    assert Factor.made == before + 1


@pytest.mark.parametrize("solver", Factor.solvers())
def test_singular_system_is_refused(solver):
    free = csr_matrix(np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]]))
    with pytest.raises(SolveError, match="held"):
        Factor(free, np.zeros(3), solver).solve(np.array([1.0, 0.0, 0.0]))


def test_empty_row_and_infinite_load_are_refused():
    with pytest.raises(SolveError, match="empty rows"):
        Factor(csr_matrix(np.diag([1.0, 0.0])), np.zeros(2))
    with pytest.raises(SolveError, match="not finite"):
        Factor(csr_matrix(np.eye(2)), np.zeros(2)).solve(np.array([np.nan, 1.0]))


LIBRARIES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
MOTION = """
import sys
import numpy as np
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.discretise import tile

block = Block(width_mm=100, length_mm=90, thickness_mm=40)
stiff = Compliance(block, Material(youngs_modulus_mpa=1.0, poisson_ratio=0.5), level="nominal", table=False)
points = np.stack(np.meshgrid(np.linspace(-12, 12, 7), np.linspace(-8, 8, 3), [3.0, 6.0, 12.0]), axis=-1)
load = tile(Traction.rectangle((2, 1), (4, 3), (0.3, -0.5, 1.0)), block)
moved = stiff.displacement(points.reshape(-1, 3), load)
np.savez(sys.argv[1], moved=moved, residual=stiff.system.factor.residual)
"""


@pytest.mark.slow
def test_threads_change_no_answer(tmp_path):
    """In processes whose caches are empty, so that none finds a solved field."""
    found = {}
    for number in (1, 2, 4):
        told = {**os.environ, **dict.fromkeys(LIBRARIES, str(number)), "TWIN_CACHE": str(tmp_path / str(number))}
        file = tmp_path / f"{number}.npz"
        subprocess.run([sys.executable, "-c", MOTION, str(file)], env=told, check=True)
        with np.load(file) as answer:
            found[number] = answer["moved"]
            assert answer["residual"] < 1e-9
    for number in (2, 4):
        assert np.abs(found[number] - found[1]).max() <= 1e-10 * np.abs(found[1]).max()
