"""Meshes: the shipped ones lie on the true surface and pass the gates; files, keys and the cache behave."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import twin.world.mesh.body_mesh
import twin.world.mesh.build
from twin.errors import InputError, MeshError, TwinError
from twin.parts.body import Block, Body, Finger
from twin.places import MESHES
from twin.world.mesh.body_mesh import body_mesh, mesh_key
from twin.world.mesh.mesh import Mesh, read_mesh, read_provenance, write_mesh
from twin.world.mesh.quality import check, enclosed_volume, offsets, quality
from twin.world.mesh.sizing import Level, WantedEdge, default_sizing
from twin.world.mesh.snap import quadratic, snapped

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
SHIPPED: list[tuple[str, Body, Level]] = [
    ("kamiyama_block", BLOCK, "standard"),
    ("kamiyama_block", BLOCK, "nominal"),
    ("sato_finger", FINGER, "standard"),
    ("sato_finger", FINGER, "nominal"),
]
KUHN = np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)])
SMALL = Block(width_mm=6, length_mm=6, thickness_mm=6)


def cube_of_tets(cells: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return linear tetrahedra that fill the block SMALL."""
    axis = np.linspace(0, 6, cells + 1)
    grid = np.stack(np.meshgrid(axis - 3, axis - 3, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape((cells + 1,) * 3)
    cube = [number[i : i + cells, j : j + cells, k : k + cells].ravel() for k in (0, 1) for j in (0, 1) for i in (0, 1)]
    return grid, np.stack(cube, axis=1)[:, KUHN].reshape(-1, 4)


def small_mesh(jitter_mm: float = 0.0) -> Mesh:
    """Return SMALL's mesh, made from nodes that were moved at random by up to ``jitter_mm`` before snapping."""
    points, tets = cube_of_tets()
    points = points + np.random.default_rng(1).uniform(-jitter_mm, jitter_mm, points.shape)
    on_surface, triangles, piece = snapped(SMALL, points, tets)
    return Mesh(**vars(quadratic(SMALL, on_surface, tets, triangles, piece)))


def face_normals(mesh: Mesh) -> np.ndarray:
    """Return (f, 3) area vectors of the straight boundary triangles, mm2."""
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


@pytest.fixture(params=SHIPPED, ids=lambda entry: f"{entry[0]}.{entry[2]}")
def shipped(request: pytest.FixtureRequest) -> tuple[Mesh, Body, Level, Path]:
    name, body, level = request.param
    path = MESHES / f"{name}.{level}.npz"
    return read_mesh(path), body, level, path


def test_shipped_meshes_pass_the_gates_and_are_small_enough_to_factor(shipped):
    mesh, body, level, _ = shipped
    measured = check(mesh, body)
    assert measured.least_dihedral_deg > 12
    assert measured.unknowns == mesh.unknowns == 3 * len(mesh.points) + mesh.corners
    assert (20_000 < mesh.unknowns < 30_000) if level == "standard" else (7_000 < mesh.unknowns < 14_500)


def test_boundary_nodes_lie_on_the_true_surface_and_inner_nodes_inside(shipped):
    mesh, body, _, _ = shipped
    boundary = np.unique(mesh.faces)
    distance = body.piece_distances(mesh.points)
    assert np.max(np.min(np.abs(distance[boundary]), axis=1)) < 1e-9
    assert np.min(distance) > -1e-9
    inner = np.setdiff1d(np.arange(len(mesh.points)), boundary)
    assert np.min(distance[inner]) > 1e-3 * mesh.points.max()


def test_faces_point_out_of_their_piece_and_close_the_body(shipped):
    mesh, body, _, _ = shipped
    area = face_normals(mesh)
    assert np.linalg.norm(area.sum(axis=0)) < 1e-9 * np.linalg.norm(area, axis=1).sum()
    inward = body.piece_normals(mesh.points[mesh.faces[:, :3]].mean(axis=1))[np.arange(len(area)), mesh.piece]
    cosine = np.einsum("ij,ij->i", -inward, area) / np.linalg.norm(area, axis=1)
    assert np.min(cosine) > 0.97


def test_volume_and_held_area_are_exact_on_the_block_and_near_on_the_finger(shipped):
    mesh, body, _, _ = shipped
    curved = isinstance(body, Finger)
    assert enclosed_volume(mesh.points, mesh.faces) == pytest.approx(body.volume_mm3, rel=2e-5 if curved else 1e-12)
    held = mesh.faces[mesh.piece == len(body.pieces) - 1]
    lifted = (mesh.points - [0, 0, body.base_z_mm]) * [1, 1, 0] + [0, 0, 1]  # a cone's flux through z = 1 is its area
    footprint = 2 * 8 * 8 + np.pi * 64 / 2 if curved else 9000.0
    assert 3 * enclosed_volume(lifted, held) == pytest.approx(footprint, rel=2e-5 if curved else 1e-12)


def test_quadratic_faces_carry_the_finger_s_volume_far_better_than_straight_ones():
    mesh = read_mesh(MESHES / "sato_finger.standard.npz")
    straight = mesh.points.copy()
    for side, (a, b) in enumerate([(0, 1), (1, 2), (2, 0)]):
        straight[mesh.faces[:, 3 + side]] = mesh.points[mesh.faces[:, [a, b]]].mean(axis=1)
    exact = FINGER.volume_mm3
    curved_error = abs(enclosed_volume(mesh.points, mesh.faces) / exact - 1)
    straight_error = abs(enclosed_volume(straight, mesh.faces) / exact - 1)
    assert straight_error > 1e-3
    assert curved_error < straight_error / 100


def test_edges_are_graded_to_the_clamped_rim(shipped):
    mesh, body, level, _ = shipped
    pairs = np.unique(np.sort(mesh.tets[:, [0, 1, 1, 2, 0, 2, 0, 3, 1, 3, 2, 3]].reshape(-1, 2), axis=1), axis=0)
    ends = mesh.points[pairs]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    wanted = WantedEdge(body, default_sizing(body, level))(ends.mean(axis=1))
    assert 0.6 < np.median(length / wanted) < 1.4
    assert np.corrcoef(np.log(length), np.log(wanted))[0, 1] > 0.35


def test_truth_and_nominal_never_share_a_mesh():
    for body in (BLOCK, FINGER):
        assert body_mesh(body, "standard").digest() != body_mesh(body, "nominal").digest()


def test_shipped_files_say_how_they_were_made(shipped):
    mesh, body, level, path = shipped
    told = read_provenance(path)
    assert told["key"] == mesh_key(body, default_sizing(body, level))
    assert told["digest"] == mesh.digest()
    assert told["quality"]["unknowns"] == mesh.unknowns


def test_the_key_follows_geometry_and_sizing_but_not_the_recipe_s_sources():
    sizing = default_sizing(BLOCK, "standard")
    key = mesh_key(BLOCK, sizing)
    assert key == mesh_key(BLOCK.model_copy(update={"source": "somewhere"}), sizing)
    assert key != mesh_key(BLOCK.model_copy(update={"thickness_mm": 40.001}), sizing)
    assert key != mesh_key(BLOCK, replace(sizing, growth=0.45))
    assert key != mesh_key(BLOCK, default_sizing(BLOCK, "nominal"))


def test_snapping_undoes_a_disturbed_surface():
    mesh = small_mesh(jitter_mm=0.3)
    assert np.max(offsets(mesh, SMALL)) < 1e-12
    assert enclosed_volume(mesh.points, mesh.faces) == pytest.approx(216, rel=1e-13)
    corners = [p for p in mesh.points if np.sum(np.abs(SMALL.piece_distances(p[None])[0]) < 1e-12) == 3]
    assert len(corners) == 8
    assert np.bincount(mesh.piece).tolist() == [18] * 6


def test_mid_side_nodes_are_in_vtk_order_and_halfway_on_flat_bodies():
    mesh = small_mesh(jitter_mm=0.2)
    for side, (a, b) in enumerate([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]):
        halfway = mesh.points[mesh.tets[:, [a, b]]].mean(axis=1)
        np.testing.assert_allclose(mesh.points[mesh.tets[:, 4 + side]], halfway, atol=1e-12)
    for side, (a, b) in enumerate([(0, 1), (1, 2), (2, 0)]):
        halfway = mesh.points[mesh.faces[:, [a, b]]].mean(axis=1)
        np.testing.assert_allclose(mesh.points[mesh.faces[:, 3 + side]], halfway, atol=1e-12)


def test_arrays_are_read_only():
    for mesh in (small_mesh(), read_mesh(MESHES / "sato_finger.nominal.npz")):
        for array in (mesh.points, mesh.tets, mesh.faces, mesh.piece):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_a_file_round_trip_keeps_every_bit(tmp_path):
    mesh = small_mesh(jitter_mm=0.1)
    write_mesh(mesh, tmp_path / "m.npz", {"key": "k"})
    again = read_mesh(tmp_path / "m.npz")
    assert again.digest() == mesh.digest()
    assert again.points.dtype == np.float64
    assert again.tets.dtype == again.faces.dtype == again.piece.dtype == np.int64
    assert [p.name for p in tmp_path.iterdir()] == ["m.npz"]


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def full_disk(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(TwinError, match="No space"):
        write_mesh(small_mesh(), tmp_path / "m.npz", {})
    assert list(tmp_path.iterdir()) == []


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-400])


def half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flipped_byte(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[2000] ^= 0xFF
    path.write_bytes(bytes(data))


def foreign_text(path: Path) -> None:
    path.write_text("solid cube\n")


def foreign_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("hello.txt", "hello")


def foreign_arrays(path: Path) -> None:
    np.savez(path, points=np.zeros((3, 3)))


def bare_array(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


def pickled(path: Path) -> None:
    np.savez(path, points=np.array([{}], dtype=object))


def emptied(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize(
    "damage",
    [truncated, half, flipped_byte, foreign_text, foreign_zip, foreign_arrays, bare_array, pickled, emptied],
)
def test_a_broken_or_foreign_file_is_refused_with_its_name_and_the_remedy(tmp_path, damage):
    path = tmp_path / "m.npz"
    write_mesh(small_mesh(jitter_mm=0.1), path, {})
    damage(path)
    with pytest.raises(InputError, match=r"m\.npz: not a whole mesh file .*--rebuild"):
        read_mesh(path)


def changed(mesh: Mesh, **arrays: object) -> Mesh:
    return replace(mesh, **arrays)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: changed(m, points=np.where(m.points > 2, np.nan, m.points)), "not finite"),
        (lambda m: changed(m, tets=m.tets[:, :4]), r"tets have shape .* 10"),
        (lambda m: changed(m, tets=m.tets + 1), "tets name nodes"),
        (lambda m: changed(m, faces=m.faces - 1), "faces name nodes"),
        (lambda m: changed(m, tets=m.tets[:, [0, 2, 1, 3, 4, 5, 6, 7, 8, 9]]), "no positive volume"),
        (lambda m: changed(m, piece=m.piece[:-1]), "piece has shape"),
        (lambda m: changed(m, corners=2), "corner nodes"),
    ],
)
def test_arrays_that_make_no_mesh_are_refused(tmp_path, change, message):
    write_mesh(change(small_mesh()), tmp_path / "m.npz", {})
    with pytest.raises(InputError, match=message):
        read_mesh(tmp_path / "m.npz")


def test_arrays_that_were_swapped_under_the_digest_are_refused(tmp_path):
    write_mesh(small_mesh(), tmp_path / "m.npz", {})
    with np.load(tmp_path / "m.npz") as file:
        arrays = dict(file)
    arrays["piece"] = arrays["piece"][::-1]
    np.savez(tmp_path / "m.npz", **arrays)
    with pytest.raises(InputError, match="digest"):
        read_mesh(tmp_path / "m.npz")


def test_a_missing_file_says_how_to_make_it(tmp_path):
    with pytest.raises(InputError, match=r"no such mesh file.*twin mesh"):
        read_mesh(tmp_path / "none.npz")


def test_a_new_body_is_built_once_then_cached_and_a_broken_cache_entry_is_mended(tmp_path, monkeypatch):
    built = []

    def build(body, sizing, *, progress=None):
        built.append(body)
        mesh = small_mesh(jitter_mm=0.1)
        return mesh, quality(mesh, body)

    monkeypatch.setattr(twin.world.mesh.body_mesh, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(twin.world.mesh.build, "build_mesh", build)
    first = body_mesh(SMALL, "standard")
    assert body_mesh(SMALL, "standard").digest() == first.digest()
    assert len(built) == 1
    body_mesh(SMALL, "nominal")
    assert len(built) == 2
    for entry in tmp_path.iterdir():
        entry.write_bytes(b"broken")
    assert body_mesh(SMALL, "standard").digest() == first.digest()
    assert len(built) == 3
    body_mesh(SMALL, "standard", rebuild=True)
    assert len(built) == 4
    assert len(list(tmp_path.iterdir())) == 2


def test_shipped_bodies_need_no_mesher(tmp_path, monkeypatch):
    def build(*_: object, **__: object) -> None:
        raise AssertionError("the mesher was called")

    monkeypatch.setattr(twin.world.mesh.body_mesh, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(twin.world.mesh.build, "build_mesh", build)
    for name, body, level in SHIPPED:
        assert body_mesh(body, level).digest() == read_mesh(MESHES / f"{name}.{level}.npz").digest()


def test_the_best_of_the_good_tries_is_kept_and_bad_ones_are_told(monkeypatch):
    tries = iter([0.0, 0.6, 0.1, 0.3, 0.2])
    lines: list[str] = []
    monkeypatch.setattr(twin.world.mesh.build, "_one", lambda *_: small_mesh(jitter_mm=next(tries)))
    sizing = replace(default_sizing(SMALL, "standard"), unknowns=small_mesh().unknowns)
    mesh, measured = twin.world.mesh.build.build_mesh(SMALL, sizing, progress=lambda line, share: lines.append(line))
    assert measured.failures() == []
    assert mesh.digest() == small_mesh().digest()  # the undisturbed grid has the best angles
    assert len(lines) == 4
    assert "dihedral" in lines[1]


def test_a_build_gives_up_with_the_reason_when_no_try_is_good(monkeypatch):
    monkeypatch.setattr(twin.world.mesh.build, "_one", lambda *_: small_mesh())
    sizing = replace(default_sizing(SMALL, "standard"), unknowns=1_000_000)
    with pytest.raises(MeshError, match=r"none of 10 meshes of the block.*wanted: 1000000"):
        twin.world.mesh.build.build_mesh(SMALL, sizing)


@pytest.mark.slow
def test_a_real_build_through_the_guarded_mesher_passes_and_is_cached(tmp_path, monkeypatch):
    monkeypatch.setattr(twin.world.mesh.body_mesh, "cache_folder", lambda: tmp_path)
    body = Block(width_mm=10, length_mm=10, thickness_mm=6)
    lines: list[str] = []
    mesh = body_mesh(body, "nominal", rebuild=True, progress=lambda line, share: lines.append(line))
    assert check(mesh, body).volume_error == pytest.approx(0, abs=1e-12)
    assert lines
    count = len(lines)
    assert body_mesh(body, "nominal", progress=lambda line, share: lines.append(line)).digest() == mesh.digest()
    assert len(lines) == count


@pytest.mark.slow
@pytest.mark.parametrize("body", [FINGER, Finger(radius_mm=6, barrel_mm=10, skirt_mm=1)], ids=["sato", "other"])
def test_a_finger_is_rebuilt_within_the_gates(tmp_path, monkeypatch, body):
    monkeypatch.setattr(twin.world.mesh.body_mesh, "cache_folder", lambda: tmp_path)
    measured = check(body_mesh(body, "nominal", rebuild=True), body)
    assert abs(measured.volume_error) < 5e-5


@pytest.mark.parametrize(
    "body",
    [
        Block(width_mm=50, length_mm=45, thickness_mm=20),
        Block(width_mm=90, length_mm=100, thickness_mm=25),
        Finger(radius_mm=10, barrel_mm=10, skirt_mm=2.5),
    ],
)
def test_a_shipped_mesh_is_stretched_to_another_size(body, monkeypatch, tmp_path):
    monkeypatch.setattr("twin.world.mesh.body_mesh.cache_folder", lambda: tmp_path)
    mesh = body_mesh(body, "coarse")
    assert not quality(mesh, body).failures()
    a, b, c, d = (mesh.points[mesh.tets[:, i]] for i in range(4))
    straight = np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))).sum() / 6.0
    assert straight == pytest.approx(body.volume_mm3, rel=1e-9 if isinstance(body, Block) else 0.02)


@pytest.mark.parametrize(
    "body", [Block(width_mm=30, length_mm=90, thickness_mm=10), Finger(radius_mm=8, barrel_mm=12, skirt_mm=2)]
)
def test_what_no_stretched_mesh_fits_is_meshed(body, monkeypatch, tmp_path):
    monkeypatch.setattr("twin.world.mesh.body_mesh.cache_folder", lambda: tmp_path)

    def build(*arguments, **words):
        raise MeshError("asked for a mesh")

    monkeypatch.setattr("twin.world.mesh.build.build_mesh", build)
    with pytest.raises(MeshError, match="asked for a mesh"):
        body_mesh(body, "coarse")


def test_of_two_that_make_a_mesh_at_once_both_take_the_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Meshing isn't deterministic, so that answers would differ by the mesh's error."""
    body, made = Block(width_mm=6, length_mm=6, thickness_mm=6), []
    monkeypatch.setattr(twin.world.mesh.body_mesh, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(twin.world.mesh.body_mesh, "_stretched", lambda body, level: None)

    def build(body: Body, sizing: object, progress: object) -> tuple[Mesh, object]:
        mesh = read_mesh(MESHES / "kamiyama_block.nominal.npz")
        made.append(mine := replace(mesh, points=mesh.points * (1.0 + len(made))))
        if len(made) == 1:  # while the first is at it, a second begins and ends
            quicker.append(body_mesh(body, "nominal"))
        return mine, SimpleNamespace(described=dict)

    quicker: list[Mesh] = []
    monkeypatch.setattr(twin.world.mesh.build, "build_mesh", build)
    assert body_mesh(body, "nominal").digest() == quicker[0].digest() == made[1].digest() != made[0].digest()
