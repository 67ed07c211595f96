"""The bodies of both papers, rectangles of load, and how far two fields are apart: for all tests."""

import struct
from pathlib import Path

import numpy as np

from twin.parts.body import Block, Dome, Finger
from twin.parts.load import Rectangles, Traction

REFERENCE = Path(__file__).parent / "reference"
"""What other programs computed, and how it was made."""

BLOCK = Block(width_mm=100, length_mm=90, thickness_mm=40)
FINGER = Finger(radius_mm=8, barrel_mm=8, skirt_mm=2)
DOME = Dome(radius_mm=10, height_mm=7)
BODIES = {"block": BLOCK, "finger": FINGER}


class LooseBlock(Block):
    """A block held nowhere, so that the half-space's tractions are integrated all round."""

    @property
    def held_pieces(self):
        return ()


class LooseFinger(Finger):
    """A finger held nowhere."""

    @property
    def held_pieces(self):
        return ()


LOOSE = {"block": LooseBlock(**BLOCK.model_dump()), "finger": LooseFinger(**FINGER.model_dump())}


def rectangles(centre_mm, half_mm, force_n, frames=None):
    """Return rectangles, all alike where one half side, force or frame is given; flat without one."""
    centre = np.atleast_2d(np.asarray(centre_mm, float))
    count = len(centre)
    return Rectangles(
        centre_mm=centre,
        frames=np.array(np.broadcast_to(np.eye(3) if frames is None else frames, (count, 3, 3))),
        half_mm=np.array(np.broadcast_to(half_mm, (count, 2)), float),
        force_n=np.array(np.broadcast_to(force_n, (count, 3)), float),
    )


def traction_of(case):
    """Return the load of a case of a reference file."""
    words = dict(case["load"])
    return getattr(Traction, words.pop("kind"))(**words)


def relative_error(got, expected):
    """Return the largest difference of fields (n, 3) over the largest displacement."""
    wrong = np.linalg.norm(np.subtract(got, expected), axis=1).max()
    return wrong / np.linalg.norm(expected, axis=1).max()


def assert_near(got, expected, share):
    """Compare arrays, to a share of the largest number that is expected."""
    np.testing.assert_allclose(got, expected, atol=share * np.abs(expected).max())


def asymmetry(stiff, patches):
    """Return how far patches' compliance is from symmetric, over its largest entry (Betti's theorem)."""
    matrix = stiff.to_points(patches.centre_mm, patches, reused=True)
    return np.abs(matrix - matrix.T).max() / np.abs(matrix).max()


def assert_holder_balances(system, atol):
    """Check that the holder's force is minus any load: by reciprocity, as its motion moves all alike."""
    all_alike = np.tile(np.eye(3), (len(system.mesh.points), 1, 1))
    np.testing.assert_allclose(system.solve(0.0 * all_alike, all_alike), all_alike, atol=atol)


def nearest_node(mesh, point=(0.0, 0.0, 0.0)):
    """Return which node of a mesh is nearest to a point."""
    return int(np.argmin(np.linalg.norm(mesh.points - np.asarray(point), axis=1)))


def forces_on(mesh, nodes, forces):
    """Return nodal forces (n, 3, cases) with ``forces`` (..., 3, cases) on the nodes."""
    whole = np.zeros((len(mesh.points), 3, np.shape(forces)[-1]))
    whole[nodes] = forces
    return whole


def on_boundary(mesh):
    """Return (n,) which nodes lie on the boundary."""
    on = np.zeros(len(mesh.points), bool)
    on[mesh.faces] = True
    return on


def write_stl(path, corners, count=None):
    """Write triangles (m, 3, 3) as a binary STL file that may declare another ``count``."""
    record = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    record["corners"] = corners
    path.write_bytes(b" " * 80 + struct.pack("<I", len(corners) if count is None else count) + record.tobytes())
    return path
