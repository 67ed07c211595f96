"""The shipped meshes lie on the true surface and pass the gates; files, keys, cache and export."""

import resource
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import pyvista
import trimesh
from slabs import block_boxes
from standard_bodies import BLOCK, DOME, FINGER, write_stl

from twin.errors import InputError, MeshError, TwinError
from twin.files import MESHES, PINNED
from twin.parts.body import Block, Finger, Solid
from twin.world.mesh import body_mesh as making
from twin.world.mesh.body_mesh import body_mesh, build_mesh
from twin.world.mesh.cover_mesh import with_cover
from twin.world.mesh.quadratic_mesh import TET_EDGES, Mesh
from twin.world.mesh.quality import Quality
from twin.world.mesh.sizing import WORLD, Sizing, WantedEdge
from twin.world.mesh.snap import snapped_mesh
from twin.world.mesh.tetrahedralise import remeshed

SHIPPED = {"kamiyama_block": BLOCK, "sato_finger": FINGER, "dome": DOME}
FILES = [f"{name}.{level}" for name in ("kamiyama_block", "sato_finger") for level in ("standard", "nominal")]
SMALL = Block(width_mm=6, length_mm=6, thickness_mm=6)
FITS_NONE = Block(width_mm=30, length_mm=90, thickness_mm=10)


def small_mesh(jitter_mm=0.0):
    """Return SMALL's mesh, its nodes moved at random before they are snapped."""
    return snapped_mesh(SMALL, *block_boxes(SMALL, (3, 3, 3), jitter_mm))


def read(name):
    """Return a shipped mesh, its body and its level."""
    body, level = name.split(".")
    return Mesh.read(MESHES / f"{name}.npz"), SHIPPED[body], level


@pytest.fixture(params=FILES)
def shipped(request):
    return read(request.param)


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(making, "cache_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", [f"{body}.{level}" for body in SHIPPED for level in ("nominal", *WORLD)])
def test_shipped_meshes_pass_the_gates_are_small_enough_to_factor_and_say_how_they_were_made(name):
    mesh, body, level = read(name)
    measured = Quality.of(mesh, body)
    assert not measured.failures()
    assert measured.least_dihedral_deg > 12
    assert measured.unknowns == mesh.unknowns == 3 * len(mesh.points) + mesh.corners
    assert abs(measured.volume_error) < 1e-4
    least, most = {"standard": (20_000, 30_000), "nominal": (7_000, 14_500)}.get(level, (3_000, 120_000))
    assert least < mesh.unknowns < most
    stored = Mesh.load(MESHES / f"{name}.npz")[1]
    assert stored["key"] == Sizing.of(body, level).mesh_key(body)
    assert stored["digest"] == mesh.digest()
    assert stored["quality"]["unknowns"] == mesh.unknowns


def test_volume_and_held_area_are_exact_on_the_block_and_near_on_the_finger(shipped):
    mesh, body, _ = shipped
    near = 2e-5 if body is FINGER else 1e-12
    volume = mesh.enclosed_volume()
    assert volume == pytest.approx(body.volume_mm3, rel=near)
    held = mesh.faces[mesh.piece == len(body.pieces) - 1]
    # a cone's flux through z = 1 is its area
    lifted = (mesh.points - [0, 0, body.base_z_mm]) * [1, 1, 0] + [0, 0, 1]
    footprint = 2 * 8 * 8 + np.pi * 64 / 2 if body is FINGER else 9000.0
    assert 3 * replace(mesh, points=lifted, faces=held).enclosed_volume() == pytest.approx(footprint, rel=near)


def test_edges_are_graded_to_the_clamped_rim(shipped):
    mesh, body, level = shipped
    pairs = np.unique(np.sort(mesh.tets[:, TET_EDGES].reshape(-1, 2), axis=1), axis=0)
    ends = mesh.points[pairs]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    wanted = WantedEdge(body, Sizing.of(body, level))(ends.mean(axis=1))
    assert 0.6 < np.median(length / wanted) < 1.4
    assert np.corrcoef(np.log(length), np.log(wanted))[0, 1] > 0.35


def test_the_key_follows_geometry_and_sizing_but_not_the_recipe_s_sources():
    sizing = Sizing.of(BLOCK, "standard")
    key = sizing.mesh_key(BLOCK)
    assert key == sizing.mesh_key(BLOCK.model_copy(update={"source": "somewhere"}))
    assert key != sizing.mesh_key(BLOCK.model_copy(update={"thickness_mm": 40.001}))
    assert key != replace(sizing, growth=0.45).mesh_key(BLOCK)
    assert key != Sizing.of(BLOCK, "nominal").mesh_key(BLOCK)


def test_snapping_undoes_a_disturbed_surface():
    mesh = small_mesh(jitter_mm=0.3)
    assert Quality.of(mesh, SMALL).largest_offset_mm < 1e-12
    assert mesh.enclosed_volume() == pytest.approx(216, rel=1e-13)
    faces_at = np.sum(np.abs(SMALL.piece_distances(mesh.points)) < 1e-12, axis=1)
    assert np.sum(faces_at == 3) == 8
    assert np.bincount(mesh.piece).tolist() == [18] * 6


def test_mid_side_nodes_are_in_vtk_order_and_halfway_on_flat_bodies():
    mesh = small_mesh(jitter_mm=0.2)
    tet_edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    for cells, edges in ((mesh.tets, tet_edges), (mesh.faces, [(0, 1), (1, 2), (2, 0)])):
        first = cells.shape[1] - len(edges)
        for side, ends in enumerate(edges):
            halfway = mesh.points[cells[:, ends]].mean(axis=1)
            np.testing.assert_allclose(mesh.points[cells[:, first + side]], halfway, atol=1e-12)


COVERED = with_cover(small_mesh(jitter_mm=0.1), SMALL, 0.5)


@pytest.fixture
def written(tmp_path):
    COVERED.write(tmp_path / "m.npz", {"key": "k"})
    return tmp_path / "m.npz"


def test_a_file_round_trip_keeps_every_bit_read_only(written):
    again = Mesh.read(written)
    assert again.digest() == COVERED.digest() != replace(COVERED, region=0 * COVERED.region).digest()
    np.testing.assert_array_equal(again.region, COVERED.region)
    for array in (*vars(again).values(), *vars(COVERED).values()):
        assert isinstance(array, int) or not array.flags.writeable
    assert again.points.dtype == np.float64
    assert again.tets.dtype == again.faces.dtype == again.piece.dtype == np.int64
    assert list(written.parent.iterdir()) == [written]


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(TwinError, match="No space"):
        small_mesh().write(tmp_path / "m.npz", {})
    assert list(tmp_path.iterdir()) == []


def foreign_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("hello.txt", "hello")


def bare_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


def flipped(data):
    return data[:2000] + bytes([data[2000] ^ 0xFF]) + data[2001:]


def swapped(path):
    """Arrays that make a mesh, but not that of the digest."""
    with np.load(path) as file:
        np.savez(path, **{**file, "piece": file["piece"][::-1]})


DAMAGES = {
    "missing": (lambda path: path.unlink(), "no such mesh file.*twin mesh"),
    "swapped": (swapped, "digest"),
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:-400]),
    "half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "flipped byte": lambda path: path.write_bytes(flipped(path.read_bytes())),
    "text": lambda path: path.write_text("solid cube\n"),
    "foreign zip": foreign_zip,
    "foreign arrays": lambda path: np.savez(path, points=np.zeros((3, 3))),
    "bare array": bare_array,
    "pickled": lambda path: np.savez(path, points=np.array([{}], dtype=object)),
    "empty": lambda path: path.write_bytes(b""),
}


NOT_WHOLE = r"m\.npz: not a whole mesh file .*--rebuild"


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_broken_or_foreign_file_is_refused_with_its_name_and_the_remedy(written, damage):
    spoil, words = DAMAGES[damage] if isinstance(DAMAGES[damage], tuple) else (DAMAGES[damage], NOT_WHOLE)
    spoil(written)
    with pytest.raises(InputError, match=words):
        Mesh.read(written)


TURNED = [0, 2, 1, 3, 4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: {"points": np.where(m.points > 2, np.nan, m.points)}, "not finite"),
        (lambda m: {"tets": m.tets[:, :4]}, r"tets have shape .* 10"),
        (lambda m: {"tets": m.tets + 1}, "tets name nodes"),
        (lambda m: {"faces": m.faces - 1}, "faces name nodes"),
        (lambda m: {"tets": m.tets[:, TURNED]}, "no positive volume"),
        (lambda m: {"piece": m.piece[:-1]}, "piece has shape"),
        (lambda m: {"corners": 2}, "corner nodes"),
    ],
)
def test_arrays_that_make_no_mesh_are_refused(tmp_path, change, message):
    mesh = small_mesh()
    replace(mesh, **change(mesh)).write(tmp_path / "m.npz", {})
    with pytest.raises(InputError, match=message):
        Mesh.read(tmp_path / "m.npz")


def test_a_body_is_built_once_then_cached_and_a_broken_entry_is_mended(own_cache, monkeypatch):
    built = []

    def build(body, sizing, *, progress=None):
        built.append(body)
        mesh = small_mesh(jitter_mm=0.1)
        return mesh, Quality.of(mesh, body)

    monkeypatch.setattr(making, "build_mesh", build)
    first = body_mesh(SMALL, "standard")
    assert body_mesh(SMALL, "standard").digest() == first.digest()
    assert len(built) == 1
    body_mesh(SMALL, "nominal")
    assert len(built) == 2
    for entry in own_cache.iterdir():
        entry.write_bytes(b"broken")
    assert body_mesh(SMALL, "standard").digest() == first.digest()
    assert len(built) == 3
    body_mesh(SMALL, "standard", rebuild=True)
    assert len(built) == 4
    assert len(list(own_cache.iterdir())) == 2


@pytest.fixture
def no_mesher(own_cache, monkeypatch):
    def build(*_, **__):
        raise MeshError("asked for a mesh")

    monkeypatch.setattr(making, "build_mesh", build)


def test_shipped_bodies_need_no_mesher(no_mesher, shipped):
    mesh, body, level = shipped
    assert body_mesh(body, level).digest() == mesh.digest()


@pytest.mark.parametrize("body", [FITS_NONE, Finger(radius_mm=8, barrel_mm=12, skirt_mm=2)])
def test_what_no_stretched_mesh_fits_is_meshed(no_mesher, body):
    with pytest.raises(MeshError, match="asked for a mesh"):
        body_mesh(body, "coarse")


@pytest.mark.parametrize(
    "body",
    [
        Block(width_mm=50, length_mm=45, thickness_mm=20),
        Block(width_mm=90, length_mm=100, thickness_mm=25),
        Finger(radius_mm=10, barrel_mm=10, skirt_mm=2.5),
    ],
)
def test_a_shipped_mesh_is_stretched_to_another_size(no_mesher, body):
    mesh = body_mesh(body, "coarse")
    assert not Quality.of(mesh, body).failures()
    a, b, c, d = (mesh.points[mesh.tets[:, i]] for i in range(4))
    straight = np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))).sum() / 6.0
    near = 1e-9 if isinstance(body, Block) else 0.02
    assert straight == pytest.approx(body.volume_mm3, rel=near)


def test_the_given_mesh_is_stretched_to_the_thickness_of_a_made_sensor(no_mesher, tmp_path):
    """A dataset's processes make no mesh: every sensor with a tolerance of thickness failed."""
    drawn, made = (Block(width_mm=50, length_mm=45, thickness_mm=t) for t in (20, 20.4))
    with PINNED.to(tmp_path), pytest.raises(MeshError, match="not among the given ones"):
        body_mesh(made, "coarse")
    mesh = body_mesh(drawn, "coarse")
    mesh.write(tmp_path / Sizing.of(drawn, "coarse").mesh_file(drawn), {"level": "coarse", "body": drawn.geometry()})
    with PINNED.to(tmp_path):
        assert body_mesh(made, "coarse").points == pytest.approx(mesh.points * [1, 1, 1.02])


@pytest.fixture
def small_solid(tmp_path):
    """SMALL as triangles."""
    box = trimesh.creation.box(extents=(6, 6, 6)).triangles + np.array([0, 0, 3])
    ends = {"held": {"normal": (0, 0, 1)}, "sensing": {"normal": (0, 0, -1)}}
    return Solid(file=str(write_stl(tmp_path / "box.stl", box)), **ends)


def test_the_first_good_try_is_taken_and_bad_ones_are_told(monkeypatch, small_solid):
    tries, lines = iter([0.9, 0.1]), []
    monkeypatch.setattr(making.Request, "solve", lambda *_, **__: block_boxes(SMALL, (3, 3, 3)))
    monkeypatch.setattr(making, "remeshed", lambda *_: block_boxes(SMALL, (3, 3, 3), next(tries)))
    sizing = replace(Sizing.of(small_solid, "standard"), unknowns=small_mesh().unknowns)
    mesh, measured = build_mesh(small_solid, sizing, progress=lambda line, share: lines.append(line))
    assert measured.failures() == []
    np.testing.assert_allclose(mesh.points, small_mesh(jitter_mm=0.1).points, atol=1e-12)
    assert len(lines) == 2
    assert "dihedral" in lines[0]


def test_a_build_gives_up_with_the_reason_when_no_try_is_good(monkeypatch, small_solid):
    for place, step in ((making.Request, "solve"), (making, "remeshed")):
        monkeypatch.setattr(place, step, lambda *_, **__: block_boxes(SMALL, (3, 3, 3)))
    sizing = replace(Sizing.of(small_solid, "standard"), unknowns=1_000_000)
    with pytest.raises(MeshError, match=r"none of 30 meshes of the solid.*wanted: 1000000"):
        build_mesh(small_solid, sizing)


def test_needles_and_flat_elements_are_mended_the_same_every_time():
    spoilt = small_mesh(jitter_mm=0.75)
    points, tets = spoilt.points[: spoilt.corners], spoilt.tets[:, :4]
    assert Quality.dihedral_angles(points, tets).min() < 5
    made = [remeshed(points, tets, np.full(len(points), 1.8), 0.1, 40.0) for _ in range(2)]
    assert Quality.dihedral_angles(*made[0]).min() > 12
    for one, other in zip(*made, strict=True):
        np.testing.assert_array_equal(one, other)
    body = snapped_mesh(SMALL, *made[0])
    assert not Quality.of(body, SMALL).failures()
    assert body.enclosed_volume() == pytest.approx(216, rel=1e-12)


def test_a_mesh_that_can_t_be_read_is_refused_not_mended():
    points, tets = block_boxes(SMALL, (3, 3, 3))
    with pytest.raises(MeshError, match="can't be improved"):
        remeshed(points * [1, 1, 0], tets, np.full(len(points), 1.8), 0.1, 40.0)


def test_edges_of_40_degrees_are_kept_as_a_tower_of_nine_sides_is_meshed(tmp_path):
    tower = trimesh.creation.cylinder(radius=5, height=12, sections=9)
    ends = {"held": {"normal": (0, 0, 1)}, "sensing": {"normal": (0, 0, -1)}}
    file = write_stl(tmp_path / "tower.stl", tower.triangles + np.array([0, 0, 6]))
    body = Solid(file=str(file), **ends)
    mesh, measured = build_mesh(body, Sizing.of(body, "sketch"))
    assert measured.failures() == []
    assert mesh.enclosed_volume() == pytest.approx(body.volume_mm3, rel=1e-12)


@pytest.mark.parametrize("size", [(6, 6, 6), (60, 6, 5), (8, 8, 30), (40, 40, 2), (25, 24, 4)])
def test_a_block_s_mesh_is_made_by_rule(size):
    body = Block(**dict(zip(("width_mm", "length_mm", "thickness_mm"), size, strict=True)))
    sizing = Sizing.of(body, "coarse")
    mesh, measured = build_mesh(body, sizing)
    assert measured.failures() == []
    assert measured.least_dihedral_deg > 20
    assert 1.0 <= measured.unknowns / sizing.unknowns < 1.7
    assert abs(measured.volume_error) < 1e-12
    assert mesh.digest() == build_mesh(body, sizing)[0].digest()


@pytest.mark.slow
@pytest.mark.parametrize("body", [FINGER, Finger(radius_mm=6, barrel_mm=10, skirt_mm=1)])
def test_a_finger_is_rebuilt_within_the_gates(own_cache, body):
    measured = Quality.of(body_mesh(body, "nominal", rebuild=True), body)
    assert not measured.failures()
    assert abs(measured.volume_error) < 5e-5


def test_of_two_that_make_a_mesh_at_once_both_take_the_first(own_cache, monkeypatch):
    """Meshing isn't deterministic, so that answers would differ by the mesh's error."""
    made, quicker = [], []

    def build(body, sizing, progress):
        mesh = Mesh.read(MESHES / "kamiyama_block.nominal.npz")
        made.append(mine := replace(mesh, points=mesh.points * (1.0 + len(made))))
        if len(made) == 1:  # while the first is at it, a second begins and ends
            quicker.append(body_mesh(body, "nominal"))
        return mine, Quality.of(mine, body)

    monkeypatch.setattr(making, "build_mesh", build)
    found = body_mesh(FITS_NONE, "nominal").digest()
    assert found == quicker[0].digest() == made[1].digest() != made[0].digest()


def test_the_exported_mesh_has_the_bodys_volume(tmp_path):
    mesh = body_mesh(FINGER, "nominal")
    mesh.export(FINGER, tmp_path / "deep" / "finger.vtu")
    grid = pyvista.read(tmp_path / "deep" / "finger.vtu")
    assert grid.n_cells == len(mesh.tets)
    # straight tetrahedra cut the curved corners
    assert grid.volume == pytest.approx(FINGER.volume_mm3, rel=0.02)
    assert grid.point_data["depth_mm"].min() == pytest.approx(0, abs=1e-9)
    with pytest.raises(InputError, match=r"exported as \.vtu"):
        mesh.export(FINGER, tmp_path / "finger.stl")
    most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, most[1]))  # as on a full disk
    try:
        with pytest.raises(TwinError, match="written"):
            mesh.export(FINGER, tmp_path / "full.vtu")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
    assert not (tmp_path / "full.vtu").exists()
