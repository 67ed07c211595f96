"""The tabulated rest of blocks: made of the shipped meshes, equal to a solve, and honest about its limits."""

import numpy as np
import pytest

from twin.errors import InputError
from twin.parts.body import Block
from twin.parts.load import Rectangles, Traction
from twin.parts.material import Material
from twin.places import MESHES
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.solve import factorisations
from twin.world.elasticity.table import Basis, Table
from twin.world.elasticity.tabulate import (
    ROLES,
    SHIPPED,
    STANDARD,
    STEP,
    USABLE,
    _kept,
    cached_path,
    find_table,
    make_table,
    read_table,
    shipped_path,
    write_table,
)
from twin.world.elasticity.tile import tile
from twin.world.mesh.mesh import Mesh, read_mesh
from twin.world.mesh.rim import drawn_to_rim

LOADS = (
    Traction.rectangle((0, 0), (4, 4), (1, 0, 0)),
    Traction.disk((-12, 9), 3.0, (0.3, 0.2, 1)),
    Traction.twist((8, -6), 4.0, 10.0),
)


def points():
    return np.random.default_rng(1).uniform([-20, -17, 0.3], [20, 17, 9.5], (120, 3))


@pytest.mark.parametrize("role", ROLES)
def test_shipped_table_is_made_of_the_shipped_mesh(role):
    mesh = drawn_to_rim(read_mesh(MESHES / f"kamiyama_block.{SHIPPED[role]}.npz"), STANDARD)
    table = read_table(shipped_path(role))
    assert table.digest == mesh.digest(), "run python -m twin.world.elasticity.tabulate"
    assert table.error < USABLE
    assert find_table(STANDARD, role) is not None
    assert find_table(Block(width_mm=90, length_mm=90, thickness_mm=40), role) is None


@pytest.mark.parametrize("nu", [0.5, 0.42, 0.1])
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


def test_point_forces_are_the_limit_of_small_squares():
    """Points are read at one place, rectangles at nine."""
    table = find_table(STANDARD, "truth")
    assert table is not None
    rng = np.random.default_rng(2)
    centre = np.column_stack([rng.uniform(-12, 12, (9, 2)), np.zeros(9)])
    half, frames, force = np.zeros((9, 2)), np.tile(np.eye(3), (9, 1, 1)), rng.normal(size=(9, 3))
    point, square = (
        table.at(0.45).displacement(
            Basis(points=points(), box_mm=table.box_mm),
            Rectangles(centre_mm=centre, frames=frames, half_mm=half + side, force_n=force),
        )
        for side in (0.0, 1e-6)
    )
    np.testing.assert_allclose(point, square, rtol=0, atol=1e-10 * np.abs(square).max())


def test_outside_its_range_the_table_steps_back():
    table = read_table(shipped_path("nominal"))
    inside, load = np.array([[0.0, 0.0, 5.0]]), tile(LOADS[0], STANDARD)
    assert table.covers(load, 0.4)
    assert Basis(points=inside, box_mm=table.box_mm).inside
    assert not Basis(points=inside + np.array([0, 0, 6.0]), box_mm=table.box_mm).inside
    assert not Basis(points=inside - np.array([0, 41.0, 0]), box_mm=table.box_mm).inside
    assert not table.covers(load, -0.1)
    assert not table.covers(tile(Traction.rectangle((19, 0), (4, 4), (0, 0, 1)), STANDARD), 0.4)


@pytest.mark.parametrize("role", ROLES)
def test_a_table_is_small_and_written_as_it_was_read(role, tmp_path):
    path = shipped_path(role)
    assert path.stat().st_size < 45_000
    table = read_table(path)
    write_table(table, tmp_path / "t.npz")
    again = read_table(tmp_path / "t.npz")
    np.testing.assert_allclose(again.coefficients, table.coefficients, rtol=1e-12)
    largest = np.abs(table.coefficients).max()
    between = table.coefficients + 0.4 * STEP * largest
    write_table(Table(**{**vars(table), "coefficients": between}), tmp_path / "t.npz")
    lost = np.abs(read_table(tmp_path / "t.npz").coefficients - between)[_kept()]
    assert lost.max() <= 0.51 * STEP * largest


def test_foreign_file_is_refused(tmp_path):
    (tmp_path / "t.npz").write_bytes(b"no")
    with pytest.raises(InputError, match="not a table"):
        read_table(tmp_path / "t.npz")


@pytest.mark.parametrize("damage", [lambda whole: whole[:9000], lambda whole: b"", lambda whole: whole[:100]])
def test_damaged_table_is_refused_and_solved_around(tmp_path, monkeypatch, damage):
    path = tmp_path / "t.npz"
    path.write_bytes(damage(shipped_path("nominal").read_bytes()))
    with pytest.raises(InputError, match="not a table"):
        read_table(path)
    monkeypatch.setattr("twin.world.elasticity.tabulate.shipped_path", lambda role: path)
    with pytest.warns(UserWarning, match="solving without the table"):
        assert find_table(STANDARD, "nominal") is None


def test_foreign_sizes_are_refused(tmp_path):
    with np.load(shipped_path("nominal")) as file:
        arrays = {name: file[name] for name in file.files}
    words = str(arrays.pop("words")).replace('"sizes": [5', '"sizes": [7')
    np.savez(tmp_path / "t.npz", words=np.array(words), **arrays)
    with pytest.raises(InputError, match="made for other sizes"):
        read_table(tmp_path / "t.npz")


@pytest.mark.slow
def test_table_can_be_made_anew():
    mesh = drawn_to_rim(read_mesh(MESHES / "kamiyama_block.nominal.npz"), STANDARD)
    made = make_table(STANDARD, mesh).coefficients
    shipped = read_table(shipped_path("nominal")).coefficients
    np.testing.assert_allclose(shipped, made, atol=3e-6 * np.abs(made).max())


@pytest.mark.slow
def test_another_block_gets_its_table_when_many_compliances_are_asked_for(tmp_path, monkeypatch):
    """The standard block at half its size: the same mesh, scaled, so that w must be twice the standard one's."""
    half = Block(width_mm=50, length_mm=45, thickness_mm=20)
    small = {}
    for level in ("coarse", "sketch"):
        mesh = read_mesh(MESHES / f"kamiyama_block.{level}.npz")
        small[level] = Mesh(**{**vars(mesh), "points": mesh.points / 2.0})
    monkeypatch.setattr("twin.world.elasticity.tabulate.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("twin.world.elasticity.tabulate.body_mesh", lambda body, level, progress=None: small[level])
    stiff = Compliance(half, Material(youngs_modulus_mpa=0.5, poisson_ratio=0.45))
    grid = np.stack(np.meshgrid(np.linspace(-2, 2, 12), np.linspace(-2, 2, 12), indexing="ij"), -1).reshape(-1, 2)
    many = Rectangles(
        centre_mm=np.column_stack([grid, np.zeros(len(grid))]),
        frames=np.tile(np.eye(3), (len(grid), 1, 1)),
        half_mm=np.full((len(grid), 2), 0.15),
        force_n=np.random.default_rng(2).normal(size=(len(grid), 3)),
    )
    inside = points() / 2.0
    matrix = stiff.to_points(inside, many)
    assert cached_path(half, "truth").exists()
    before = factorisations()
    got = Compliance(half, stiff.material).displacement(inside, many)
    assert factorisations() == before
    twice = Rectangles(centre_mm=2 * many.centre_mm, frames=many.frames, half_mm=2 * many.half_mm, force_n=many.force_n)
    expected = 2.0 * Compliance(STANDARD, stiff.material).displacement(points(), twice)
    np.testing.assert_allclose(got, expected, atol=6e-4 * np.abs(expected).max())
    np.testing.assert_allclose((matrix @ many.force_n.ravel()).reshape(-1, 3), got, atol=1e-9)


@pytest.mark.slow
def test_a_plate_too_thin_for_the_polynomials_is_solved_instead(tmp_path, monkeypatch):
    mesh = read_mesh(MESHES / "kamiyama_block.nominal.npz")
    thin = Block(width_mm=100, length_mm=90, thickness_mm=8)
    flat = Mesh(**{**vars(mesh), "points": mesh.points * [1.0, 1.0, 0.2]})
    monkeypatch.setattr("twin.world.elasticity.tabulate.cache_folder", lambda: tmp_path)
    write_table(make_table(thin, flat), cached_path(thin, "truth"))
    assert read_table(cached_path(thin, "truth")).error > USABLE
    assert find_table(thin, "truth") is None
