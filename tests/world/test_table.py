"""The tabulated rest of the standard block: made of the shipped mesh, equal to a solve, and honest about its limits."""

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.world.compliance import Compliance
from twin.world.mesh import read_mesh
from twin.world.solve import factorisations
from twin.world.table import STANDARD, make_table, read_table, shipped_path, shipped_table
from twin.world.tile import tile

LOADS = (
    Traction.rectangle((0, 0), (4, 4), (1, 0, 0)),
    Traction.disk((-12, 9), 3.0, (0.3, 0.2, 1)),
    Traction.twist((8, -6), 4.0, 10.0),
)


def points():
    return np.random.default_rng(1).uniform([-20, -17, 0.3], [20, 17, 9.5], (120, 3))


@pytest.mark.parametrize("level", ["standard", "nominal"])
def test_shipped_table_is_made_of_the_shipped_mesh(level):
    mesh = read_mesh(MESHES / f"kamiyama_block.{level}.npz")
    assert read_table(shipped_path(level)).digest == mesh.digest(), "run python -m twin.world.table"
    assert shipped_table(STANDARD, level, mesh) is not None
    assert shipped_table(Block(width_mm=90, length_mm=90, thickness_mm=40), level) is None


@pytest.mark.parametrize("nu", [0.5, 0.42])
def test_table_equals_a_solve_and_factors_nothing(nu):
    material = Material(youngs_modulus_mpa=0.5, poisson_ratio=nu)
    tabulated = Compliance(STANDARD, material, level="nominal")
    solved = Compliance(STANDARD, material, level="nominal", table=False)
    for load in LOADS:
        tiles, before = tile(load, STANDARD), factorisations()
        got, slopes = tabulated.displacement(points(), tiles), tabulated.gradient(points(), tiles)
        matrix = tabulated.to_points(points(), tiles)
        assert factorisations() == before
        expected = solved.displacement(points(), tiles)
        np.testing.assert_allclose(got, expected, atol=1e-3 * np.abs(expected).max())
        expected = solved.gradient(points(), tiles)
        np.testing.assert_allclose(slopes, expected, atol=2e-3 * np.abs(expected).max())
        np.testing.assert_allclose((matrix @ tiles.force_n.ravel()).reshape(-1, 3), got, atol=1e-9)


def test_outside_its_range_the_table_steps_back():
    table = read_table(shipped_path("nominal"))
    inside, load = np.array([[0.0, 0.0, 5.0]]), tile(LOADS[0], STANDARD)
    assert table.covers(inside, load, 0.4)
    assert not table.covers(inside + np.array([0, 0, 6.0]), load, 0.4)
    assert not table.covers(inside, load, 0.2)
    assert not table.covers(inside, tile(Traction.rectangle((19, 0), (4, 4), (0, 0, 1)), STANDARD), 0.4)


def test_foreign_file_is_refused(tmp_path):
    (tmp_path / "t.npz").write_bytes(b"no")
    with pytest.raises(InputError, match="not a table"):
        read_table(tmp_path / "t.npz")


@pytest.mark.parametrize("damage", [lambda whole: whole[:20000], lambda whole: b"", lambda whole: whole[:100]])
def test_damaged_table_is_refused_and_solved_around(tmp_path, monkeypatch, damage):
    path = tmp_path / "t.npz"
    path.write_bytes(damage(shipped_path("nominal").read_bytes()))
    with pytest.raises(InputError, match="not a table"):
        read_table(path)
    monkeypatch.setattr("twin.world.table.shipped_path", lambda level: path)
    with pytest.warns(UserWarning, match="solving without the table"):
        assert shipped_table(STANDARD, "nominal") is None


@pytest.mark.slow
def test_table_can_be_made_anew():
    made = make_table(STANDARD, read_mesh(MESHES / "kamiyama_block.nominal.npz")).coefficients
    shipped = read_table(shipped_path("nominal")).coefficients
    np.testing.assert_allclose(shipped, made, atol=1e-6 * np.abs(made).max())
