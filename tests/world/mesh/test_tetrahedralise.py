"""The way to the mesher: what goes in, the guard around the child, and what is refused."""

import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from standard_bodies import FINGER

from twin.errors import InputError, MeshError
from twin.parts.body import Block
from twin.world.mesh.body_mesh import outer_surface
from twin.world.mesh.quadratic_mesh import signed_volumes
from twin.world.mesh.sizing import Sizing, WantedEdge
from twin.world.mesh.tetrahedralise import Request

BLOCK = Block(width_mm=10, length_mm=8, thickness_mm=6)


@pytest.fixture(scope="module")
def request_of_block():
    vertices, triangles = outer_surface(BLOCK, 1.0)
    points, tets, edge = WantedEdge(BLOCK, Sizing.of(BLOCK, "nominal")).background()
    return Request(
        vertices=vertices,
        triangles=triangles,
        background_points=points,
        background_tets=tets,
        background_edge_mm=np.full_like(edge, 3.0),
        coarse_mm=3.0,
    )


def enclosed(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", np.cross(a, b), c) / 6)


def test_the_block_s_surface_is_its_eight_corners():
    vertices, triangles = outer_surface(BLOCK, 0.5)
    assert vertices.shape == (8, 3)
    assert triangles.shape == (12, 3)
    assert enclosed(vertices, triangles) == pytest.approx(BLOCK.volume_mm3, rel=1e-12)


def test_the_finger_s_surface_converges_with_the_square_of_the_spacing():
    volumes = [enclosed(*outer_surface(FINGER, spacing)) for spacing in (1.6, 0.8)]
    coarse, fine = (1 - volume / FINGER.volume_mm3 for volume in volumes)
    assert 0 < fine < coarse < 0.02
    assert coarse / fine == pytest.approx(4, rel=0.35)


def test_a_body_that_is_not_convex_is_refused():
    class Hollow(Block):
        @property
        def volume_mm3(self):
            return 0.9 * super().volume_mm3

    with pytest.raises(MeshError, match="only convex bodies"):
        outer_surface(Hollow(**BLOCK.model_dump()), 1.0)


def test_projection_reaches_surface_edge_and_corner_of_the_finger():
    on = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    start = np.array([(3, 2, 1.5), (-7.6, 3, 1.0), (-7.8, 7.7, 9.6), (1, 2, 3)], dtype=float)
    found = FINGER.onto_sheets(start, on)
    distance = FINGER.piece_distances(found)
    assert np.max(np.abs(distance[on])) < 1e-13
    assert_allclose(found[2], (-8, 8, 10), atol=1e-12)
    assert_array_equal(found[3], start[3])
    away = start[0] - [0, 0, 8]
    on_sphere = np.array([0, 0, 8]) + 8 * away / np.linalg.norm(away)
    assert_allclose(found[0], on_sphere, atol=1e-12)


def test_wanted_edges_at_rim_and_window_and_their_growth():
    sizing = Sizing.of(FINGER, "standard")
    wanted = WantedEdge(FINGER, sizing)
    rim = wanted.rim_mm
    on_rim = np.abs(FINGER.piece_distances(rim))
    assert np.max(on_rim[:, -1]) < 1e-9
    assert np.max(np.min(on_rim[:, :-1], axis=1)) < 1e-9
    assert np.max(wanted(rim)) < sizing.rim_mm + 1e-9
    assert wanted(np.zeros((1, 3)))[0] == pytest.approx(sizing.fine_mm, abs=0.01)
    inside = np.random.default_rng(0).uniform((-8, -8, 0), (8, 8, 10), (4000, 3))
    edge = wanted(inside)
    assert np.max(edge) == pytest.approx(sizing.coarse_mm)
    step = np.linalg.norm(inside[1:] - inside[:-1], axis=1)
    assert np.max(np.abs(np.diff(edge)) / step) <= sizing.growth + 1e-9


@pytest.mark.parametrize("body", [BLOCK, FINGER])
def test_the_background_grid_pads_the_body_and_fills_its_box(body):
    points, tets, edge = WantedEdge(body, Sizing.of(body, "nominal")).background()
    low, high = np.array(body.bounds_mm)
    assert np.all(points.min(axis=0) < low)
    assert np.all(points.max(axis=0) > high)
    volume = signed_volumes(points, tets)
    assert np.min(np.abs(volume)) > 0
    assert np.abs(volume).sum() == pytest.approx(np.prod(np.ptp(points, axis=0)))
    assert np.all(edge > 0)


BAD = {
    "hole": lambda r: {"triangles": r.triangles[1:]},
    "turned": lambda r: {"triangles": np.concatenate([r.triangles[:1, ::-1], r.triangles[1:]])},
    "nan": lambda r: {"vertices": np.where(r.vertices > 4, np.nan, r.vertices)},
    "bad index": lambda r: {"triangles": r.triangles + 1},
    "quads": lambda _: {"triangles": np.zeros((6, 4), dtype=np.int64)},
    "nothing": lambda r: {"triangles": r.triangles[:0]},
    "zero edges": lambda r: {"background_edge_mm": 0 * r.background_edge_mm},
}


@pytest.mark.parametrize("name", BAD)
def test_what_the_mesher_can_t_survive_never_reaches_it(request_of_block, monkeypatch, name):
    def child(*_, **__):
        raise AssertionError("the child was started")

    monkeypatch.setattr(subprocess, "Popen", child)
    with pytest.raises(InputError):
        replace(request_of_block, **BAD[name](request_of_block)).solve()


@pytest.mark.skipif((sys.platform, platform.machine()) != ("linux", "x86_64"), reason="as `Request.solve` says")
def test_the_same_surface_and_seed_give_the_same_mesh(request_of_block):
    one, same, other = (request_of_block.solve(seed=seed) for seed in (0, 0, 1))
    for part, again in zip(one, same, strict=True):
        assert_array_equal(part, again)
    assert one[0].shape != other[0].shape or (one[0] != other[0]).any()


@pytest.fixture
def stand_in(tmp_path):
    """Return what makes an executable that runs some code in place of the mesher's Python."""

    def made(code):
        (tmp_path / "code.py").write_text(code)
        script = tmp_path / "python"
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "{tmp_path / "code.py"}" "$@"\n')
        script.chmod(0o700)
        return str(script)

    return made


def sleeper(pid):
    words = f"open({str(pid)!r}, 'w').write(str(os.getpid()))"
    return f"import os, time; {words}; time.sleep(60)"


def assert_gone(pid):
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


def test_a_child_over_its_time_limit_is_killed_and_leaves_no_folder(tmp_path, stand_in, request_of_block, monkeypatch):
    began, pid, own = time.monotonic(), tmp_path / "pid", tmp_path / "own"
    own.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(own))
    monkeypatch.setattr(sys, "executable", stand_in(sleeper(pid)))
    with pytest.raises(MeshError, match=r"time limit of 1 s"):
        request_of_block.solve(limit_s=1.0)
    assert time.monotonic() - began < 20
    assert_gone(pid)
    assert list(own.iterdir()) == []


def copier(result):
    return f"import shutil, sys; shutil.copy({str(result)!r}, sys.argv[-1])"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "SIGSEGV"),
        ("import sys; sys.exit('out of luck')", "exit code 1: out of luck"),
    ],
)
def test_a_child_that_dies_is_reported_in_words(stand_in, request_of_block, monkeypatch, code, message):
    monkeypatch.setattr(sys, "executable", stand_in(code))
    with pytest.raises(MeshError, match=message):
        request_of_block.solve(limit_s=30.0)


PARENT = """
import signal, sys
import numpy as np
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
from twin.world.mesh.tetrahedralise import Request
sys.executable, request = sys.argv[1:]
Request(**np.load(request)).solve(limit_s=60.0)
"""


def test_an_interrupt_of_the_parent_kills_the_child(tmp_path, stand_in, request_of_block):
    pid, file = tmp_path / "pid", tmp_path / "request.npz"
    np.savez(file, **vars(request_of_block))
    command = [sys.executable, "-c", PARENT, stand_in(sleeper(pid)), str(file)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as running:
        deadline = time.monotonic() + 30
        while not (pid.exists() and pid.read_text()) and time.monotonic() < deadline:
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        running.wait(timeout=20)
    assert running.returncode != 0
    assert_gone(pid)


@pytest.mark.parametrize(
    ("tets", "message"),
    [([[0, 1, 2, 3]], r"fill 0\.1666.* mm3 of the surface's 480"), (np.zeros((0, 4)), "0 tetrahedra")],
)
def test_a_result_that_lost_part_of_the_body_is_refused(
    tmp_path, stand_in, request_of_block, monkeypatch, tets, message
):
    result = tmp_path / "result.npz"
    np.savez(result, points=np.eye(4)[:, 1:], tets=np.array(tets, np.int64))
    monkeypatch.setattr(sys, "executable", stand_in(copier(result)))
    with pytest.raises(MeshError, match=message):
        request_of_block.solve()
