"""Tetrahedra inside a closed surface, by pytetwild in a guarded child process.

The mesher holds the interpreter's lock and ignores signals until it is done, writes into the
current folder, and ends the process on bad input. So it runs as a child with a folder of its own,
one thread and a time limit: ``python -m twin.world.mesh.tetrahedralise IN.npz OUT.npz``.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import platform
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Floats, Ints, Points, frozen
from twin.errors import InputError, MeshError
from twin.files import ROOT
from twin.world.mesh.quadratic_mesh import signed_volumes
from twin.world.mesh.quality import open_edges

_PR_SET_PDEATHSIG = 1

_STOP_ENERGY = 10.0
"""Element quality (conformal AMIPS energy) at which the mesher stops improving."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """The input of the mesher.

    Attributes
    ----------
    vertices, triangles
        Closed surface: (n, 3) mm and (m, 3) indices, normals out.
    background_points, background_tets, background_edge_mm
        Sizing field: (k, 3) mm, (l, 4) indices and (k,) wanted edges, mm.
    coarse_mm
        Longest edge, mm.
    envelope
        How far the result's surface may be from the input's, as a part of the bounding box's
        diagonal.
    """

    vertices: Points
    triangles: Ints
    background_points: Points
    background_tets: Ints
    background_edge_mm: Floats
    coarse_mm: float
    envelope: float = 1e-3

    def solve(
        self, *, limit_s: float = 600.0, processor_s: float | None = None, seed: int = 0
    ) -> tuple[Points, Ints]:
        """Fill a closed surface: return points (n, 3), mm, every one used, and (m, 4) positive
        tetrahedra. The same surface and seed give the same mesh on Linux with x86-64.

        ``limit_s`` limits the child's time, s, and ``processor_s`` its processor time, which
        another program's work does not use up (Unix only).

        Raises
        ------
        InputError
            If the surface is not closed, or has numbers or indices the mesher can't survive.
        MeshError
            If the child fails, takes too long, or returns no body.
        """
        _check_request(self)
        with tempfile.TemporaryDirectory(prefix="twin-mesh-") as folder:
            given, made = Path(folder, "in.npz"), Path(folder, "out.npz")
            with given.open("wb") as file:
                given_here = {
                    "limit_s": limit_s,
                    "processor_s": processor_s or limit_s,
                    "seed": seed,
                }
                values: dict[str, Any] = {**given_here, **vars(self)}
                np.savez(file, **values)
            _run_child(
                [sys.executable, "-m", "twin.world.mesh.tetrahedralise", str(given), str(made)],
                folder,
                limit_s,
            )
            if not made.exists():
                raise MeshError("the mesher ended without a result; build the mesh again")
            with np.load(made, allow_pickle=False) as result:
                points, tets = result["points"], result["tets"]
        return _checked_result(self, points, tets)


GROWTH = 2.0
"""Most that neighbouring edges may differ by, as a factor."""


def remeshed(
    points: Points, tets: Ints, edge_mm: Floats, surface_mm: float, ridge_deg: float
) -> tuple[Points, Ints]:
    """Return tetrahedra, ``points`` (k, 3) and ``tets`` (l, 4), of the same body with other edges.

    By Mmg (C. Dapogny, C. Dobrzynski, P. Frey 2014, J. Comput. Phys. 262, 358), which splits,
    contracts and swaps edges and moves points, on the surface too. The same input gives the same
    result. Where `tetrahedralise` left elements of 12 degrees on fillets, those of 15 to 23 remain.

    Parameters
    ----------
    points, tets, edge_mm
        The given mesh, (n, 3) mm and (m, 4), and the (n,) wanted edges at its points, mm.
    surface_mm
        Distance between the given curved surface and the new one, mm: edges become shorter there.
    ridge_deg
        Angle between faces from which on an edge of the surface is kept.

    Raises
    ------
    MeshError
        Mmg can't read or finish the mesh.
    """
    from mmgpy import MmgMesh3D

    try:
        mesh = MmgMesh3D(np.array(points), np.array(tets, np.int32))
        mesh["metric"] = edge_mm[:, None]
        mesh.remesh(ar=ridge_deg, hgrad=GROWTH, hausd=surface_mm, nofem=1, verbose=-1)
    except (RuntimeError, ValueError) as problem:
        raise MeshError(f"the mesh can't be improved ({problem}); build it again") from problem
    return (
        np.ascontiguousarray(mesh.get_vertices(), np.float64),
        np.asarray(mesh.get_tetrahedra(), np.int64),
    )


def _check_request(request: Request) -> None:
    """Refuse what would end the child's process or be 'repaired' in silence."""
    vertices, triangles = request.vertices, request.triangles
    if (
        vertices.ndim != 2
        or vertices.shape[1] != 3
        or len(vertices) < 4
        or not np.all(np.isfinite(vertices))
    ):
        raise InputError(
            f"surface vertices must be (n >= 4, 3) finite numbers in mm, not {vertices.shape}; "
            "check them"
        )
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) < 4:
        raise InputError(
            f"surface triangles must be (m >= 4, 3) indices, not {triangles.shape}; split other "
            "polygons"
        )
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(
            f"surface triangles name vertices {triangles.min()} to {triangles.max()}; allowed: 0 "
            f"to {len(vertices) - 1}"
        )
    if open_edges(triangles):
        raise InputError(
            f"the surface of {len(triangles)} triangles is not closed and wound one way (every "
            "edge must belong to two triangles that run along it in opposite directions); mend it "
            "first"
        )
    edge = request.background_edge_mm
    if not (np.all(np.isfinite(edge)) and np.all(edge > 0) and request.coarse_mm > 0):
        raise InputError("wanted edge lengths must be finite and above 0 mm; check the sizing")


def _run_child(command: list[str], folder: str, limit_s: float) -> None:
    """Run the child in its own folder with one thread; kill it after ``limit_s`` or when the caller
    is interrupted."""
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])),
    }
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as child:
        try:
            said, _ = child.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            child.kill()
            raise MeshError(
                f"the mesher was stopped after its time limit of {limit_s:g} s; ask for longer "
                "edges or more time"
            ) from None
        except BaseException:
            child.kill()
            raise
    if hasattr(signal, "SIGXCPU") and child.returncode == -signal.SIGXCPU:
        raise MeshError(
            "the mesher was stopped after its processor time; ask for longer edges or more time"
        )
    if child.returncode:
        raise MeshError(
            f"the mesher {_ending(child.returncode)}: {_last_line(said)}; check the surface, or "
            "try again"
        )


def _ending(code: int) -> str:
    if code >= 0:
        return f"failed with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"


def _last_line(said: bytes) -> str:
    lines = said.decode(errors="replace").strip().splitlines()
    return lines[-1][:300] if lines else "it said nothing"


def _checked_result(request: Request, points: Points, tets: Ints) -> tuple[Points, Ints]:
    """Drop unused points, turn tetrahedra positive, and compare the volume with the surface's."""
    if (
        len(tets) == 0
        or not np.all(np.isfinite(points))
        or tets.min() < 0
        or tets.max() >= len(points)
    ):
        raise MeshError(
            f"the mesher returned {len(tets)} tetrahedra that make no body; ask for shorter edges"
        )
    used, new = np.unique(tets, return_inverse=True)
    points, tets = (
        np.ascontiguousarray(points[used], np.float64),
        new.reshape(-1, 4).astype(np.int64),
    )
    flipped = signed_volumes(points, tets) < 0
    tets[flipped] = tets[flipped][:, [0, 2, 1, 3]]
    a, b, c = (request.vertices[request.triangles[:, k]] for k in range(3))
    wanted = float(np.einsum("ij,ij->", np.cross(a, b), c)) / 6
    volume = float(np.sum(signed_volumes(points, tets)))
    if abs(volume / wanted - 1) > 0.02:
        raise MeshError(
            f"the tetrahedra fill {volume:.6g} mm3 of the surface's {wanted:.6g} mm3 (allowed: 2 % "
            "apart); ask for shorter edges near thin parts"
        )
    return frozen(points), frozen(tets)


def _child(given: str, made: str) -> None:
    """Mesh what IN.npz asks for and write OUT.npz. The alarm's default action ends the process even
    inside native code: no orphan runs on for ever."""
    with np.load(given, allow_pickle=False) as request:
        _end_with_parent()
        if hasattr(signal, "alarm"):
            signal.alarm(int(float(request["limit_s"])) + 60)
        _limit_processor(math.ceil(float(request["processor_s"])))
        _seed(int(request["seed"]))
        import pytetwild

        points, tets = pytetwild.tetrahedralize(
            request["vertices"],
            request["triangles"].astype(np.int32),
            edge_length_abs=float(request["coarse_mm"]),
            epsilon=float(request["envelope"]),
            stop_energy=_STOP_ENERGY,
            coarsen=False,
            num_threads=1,
            bg_vertices=request["background_points"],
            bg_tets=request["background_tets"].astype(np.int32),
            bg_values=request["background_edge_mm"],
        )
    with Path(made).open("wb") as file:
        np.savez(file, points=points, tets=np.asarray(tets, np.int64))


def _seed(seed: int) -> None:
    """Start the mesher's random numbers from ``seed``.

    Why: it takes no seed, but seeds its shuffles from ``std::random_device``. In this process,
    which meshes and ends, that function is overwritten by one that returns ours. Where it can't
    be, meshes of one surface differ by some percent in their numbers of points.
    """
    if sys.platform == "linux" and platform.machine() == "x86_64":
        code = b"\xf3\x0f\x1e\xfa\xb8" + seed.to_bytes(4, "little") + b"\xc3"  # mov eax, seed; ret
        with suppress(OSError, AttributeError):
            draw = ctypes.CDLL("libstdc++.so.6")._ZNSt13random_device9_M_getvalEv
            address = ctypes.cast(draw, ctypes.c_void_p).value or 0
            page = address - address % mmap.PAGESIZE
            access = mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC
            size = address - page + len(code)
            if not ctypes.CDLL(None).mprotect(ctypes.c_void_p(page), ctypes.c_size_t(size), access):
                ctypes.memmove(address, code, len(code))


def _end_with_parent() -> None:
    """Ask Linux to kill this process when its parent dies."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _limit_processor(seconds: int) -> None:
    """Ask the system to end this process when it has used so much processor time."""
    with suppress(ImportError):
        import resource

        hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
        own = seconds if hard == resource.RLIM_INFINITY else min(seconds, hard)
        resource.setrlimit(resource.RLIMIT_CPU, (own, hard))


if __name__ == "__main__":
    _child(*sys.argv[1:])
