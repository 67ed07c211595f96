"""The way to the mesher: surface and sizes that go in, the guard around the child, and what is refused."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from twin.errors import InputError, MeshError
from twin.parts.body import Block, Finger
from twin.world.mesh import tetrahedralise as guarded
from twin.world.mesh.sizing import WantedEdge, background, default_sizing, rim_points
from twin.world.mesh.snap import onto_pieces, signed_volumes
from twin.world.mesh.surface import outer_surface
from twin.world.mesh.tetrahedralise import Request, tetrahedralise

BLOCK = Block(width_mm=10, length_mm=8, thickness_mm=6)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)


def request_for(body: Block, edge_mm: float = 3.0) -> Request:
    vertices, triangles = outer_surface(body, 1.0)
    points, tets, edge = background(body, default_sizing(body, "nominal"))
    return Request(
        vertices=vertices,
        triangles=triangles,
        background_points=points,
        background_tets=tets,
        background_edge_mm=np.full_like(edge, edge_mm),
        coarse_mm=edge_mm,
    )


def enclosed(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)


def test_the_block_s_surface_is_its_eight_corners():
    vertices, triangles = outer_surface(BLOCK, 0.5)
    assert vertices.shape == (8, 3)
    assert triangles.shape == (12, 3)
    assert enclosed(vertices, triangles) == pytest.approx(BLOCK.volume_mm3, rel=1e-12)


def test_the_finger_s_surface_converges_with_the_square_of_the_spacing():
    error = [1 - enclosed(*outer_surface(FINGER, spacing)) / FINGER.volume_mm3 for spacing in (1.6, 0.8)]
    assert 0 < error[1] < error[0] < 0.02
    assert error[0] / error[1] == pytest.approx(4, rel=0.35)


def test_a_body_that_is_not_convex_is_refused():
    class Hollow(Block):
        @property
        def volume_mm3(self) -> float:
            return 0.9 * super().volume_mm3

    with pytest.raises(MeshError, match="only convex bodies"):
        outer_surface(Hollow(width_mm=10, length_mm=8, thickness_mm=6), 1.0)


def test_projection_reaches_surface_edge_and_corner_of_the_finger():
    on = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    start = np.array([(3, 2, 1.5), (-7.6, 3, 1.0), (-7.8, 7.7, 9.6), (1, 2, 3)], dtype=float)
    found = onto_pieces(FINGER, start, on)
    distance = FINGER.piece_distances(found)
    assert np.max(np.abs(distance[on])) < 1e-13
    np.testing.assert_allclose(found[2], (-8, 8, 10), atol=1e-12)
    np.testing.assert_array_equal(found[3], start[3])
    away = start[0] - [0, 0, 8]
    np.testing.assert_allclose(found[0], np.array([0, 0, 8]) + 8 * away / np.linalg.norm(away), atol=1e-12)


def test_wanted_edges_at_rim_and_window_and_their_growth():
    sizing = default_sizing(FINGER, "standard")
    wanted = WantedEdge(FINGER, sizing)
    rim = rim_points(FINGER, 0.2)
    on_rim = np.abs(FINGER.piece_distances(rim))
    assert np.max(on_rim[:, -1]) < 1e-9
    assert np.max(np.min(on_rim[:, :-1], axis=1)) < 1e-9
    assert np.max(wanted(rim)) < sizing.rim_mm + sizing.growth * 0.2
    assert wanted(np.zeros((1, 3)))[0] == pytest.approx(sizing.fine_mm, abs=0.01)
    inside = np.random.default_rng(0).uniform((-8, -8, 0), (8, 8, 10), (4000, 3))
    edge = wanted(inside)
    assert np.max(edge) == pytest.approx(sizing.coarse_mm)
    step = np.linalg.norm(inside[1:] - inside[:-1], axis=1)
    assert np.max(np.abs(np.diff(edge)) / step) <= sizing.growth + 1e-9


@pytest.mark.parametrize("body", [BLOCK, FINGER], ids=["block", "finger"])
def test_the_background_grid_pads_the_body_and_fills_its_box(body):
    points, tets, edge = background(body, default_sizing(body, "nominal"))
    low, high = np.array(body.bounds_mm)
    assert np.all(points.min(axis=0) < low)
    assert np.all(points.max(axis=0) > high)
    volume = signed_volumes(points, tets)
    assert np.min(np.abs(volume)) > 0
    assert np.abs(volume).sum() == pytest.approx(np.prod(np.ptp(points, axis=0)))
    assert np.all(edge > 0)


def without_a_face(request: Request) -> dict[str, object]:
    return {"triangles": request.triangles[1:]}


def with_a_turned_face(request: Request) -> dict[str, object]:
    return {"triangles": np.concatenate([request.triangles[:1, ::-1], request.triangles[1:]])}


def with_nan(request: Request) -> dict[str, object]:
    return {"vertices": np.where(request.vertices > 4, np.nan, request.vertices)}


def with_a_bad_index(request: Request) -> dict[str, object]:
    return {"triangles": request.triangles + 1}


def with_quads(request: Request) -> dict[str, object]:
    return {"triangles": np.zeros((6, 4), dtype=np.int64)}


def with_nothing(request: Request) -> dict[str, object]:
    return {"triangles": request.triangles[:0]}


def with_zero_edges(request: Request) -> dict[str, object]:
    return {"background_edge_mm": 0 * request.background_edge_mm}


@pytest.mark.parametrize(
    "change",
    [without_a_face, with_a_turned_face, with_nan, with_a_bad_index, with_quads, with_nothing, with_zero_edges],
)
def test_what_the_mesher_can_t_survive_never_reaches_it(monkeypatch, change):
    def child(*_: object) -> None:
        raise AssertionError("the child was started")

    monkeypatch.setattr(guarded, "_run_child", child)
    request = request_for(BLOCK)
    with pytest.raises(InputError):
        tetrahedralise(Request(**{**vars(request), **change(request)}))


def test_a_child_over_its_time_limit_is_killed(tmp_path):
    began = time.monotonic()
    pid = tmp_path / "pid"
    code = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    with pytest.raises(MeshError, match=r"time limit of 1 s"):
        guarded._run_child([sys.executable, "-S", "-c", code], str(tmp_path), 1.0)
    assert time.monotonic() - began < 20
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


def test_a_real_request_over_its_time_limit_is_an_error_and_leaves_no_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(MeshError, match="time limit"):
        tetrahedralise(request_for(BLOCK), limit_s=0.05)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
        ("import sys; sys.exit('out of luck')", "exit code 1: out of luck"),
    ],
)
def test_a_child_that_dies_is_reported_in_words(tmp_path, code, message):
    with pytest.raises(MeshError, match=message):
        guarded._run_child([sys.executable, "-S", "-c", code], str(tmp_path), 30.0)


def test_an_interrupt_of_the_parent_kills_the_child(tmp_path):
    pid = tmp_path / "pid"
    child = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    parent = (
        "import sys\nfrom twin.world.mesh.tetrahedralise import _run_child\n"
        f"_run_child([sys.executable, '-S', '-c', {child!r}], {str(tmp_path)!r}, 60.0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stderr=subprocess.DEVNULL) as running:
        deadline = time.monotonic() + 30
        while not (pid.exists() and pid.read_text()) and time.monotonic() < deadline:
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        running.wait(timeout=20)
    assert running.returncode != 0
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


def test_a_result_that_lost_part_of_the_body_is_refused():
    request = request_for(BLOCK)
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
    with pytest.raises(MeshError, match=r"fill 0\.1666.* mm3 of the surface's 480"):
        guarded._checked_result(request, points, np.array([[0, 1, 2, 3]]))
    with pytest.raises(MeshError, match="0 tetrahedra"):
        guarded._checked_result(request, points, np.zeros((0, 4), dtype=np.int64))


@pytest.mark.slow
def test_the_real_mesher_fills_a_small_block_with_positive_tetrahedra():
    points, tets = tetrahedralise(request_for(BLOCK))
    volumes = signed_volumes(points, tets)
    assert np.min(volumes) > 0
    assert volumes.sum() == pytest.approx(BLOCK.volume_mm3, rel=0.01)
    assert len(np.unique(tets)) == len(points)
