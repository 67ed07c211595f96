"""The block's truth: displacements far nearer to it than any mesh of twin's, made by NGSolve and by nothing of twin.

    python tests/block_truth.py          # makes reference/block_converged.npz anew: the loads of block.npz

The field is the half-space's under the load, plus a rest w that the finite block asks for.

* The half-space's is Boussinesq's and Cerruti's for a point force, summed over Gauss points of the load: at half a
  millimetre's depth and deeper that is good to 1e-7.
* w is smooth but at the clamped rim. The block is taken as four mirror images of a quarter, whose field is the sum of
  four symmetric ones, and the quarter as bricks that shrink geometrically towards the clamped edges and their corner.
  Displacement is of order p along every axis, pressure of order p - 2 in every brick by itself, which is stable at
  Poisson's ratio 1/2; a 1e-7th of compressibility is left, so that pressures can be eliminated brick by brick.

How good it is: every case is solved with two pairs of order and bricks, the difference of which is its `own_error`.
block.npz has the same loads from Netgen's tetrahedra, of order 4, graded to the rim, by hands that did not know twin.
"""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twin.arrays import Floats, Points

HALF_MM, THICKNESS_MM, MODULUS_MPA = (50.0, 45.0), 40.0, 0.5
SOFTNESS = 1e-7
NEAR, AFAR = 24, 6
"""Gauss points across a load: by its half width in mm under it; and for faces 40 mm away."""

FOLDER = Path(__file__).parent / "reference"
IMAGES = ((1, 1), (-1, 1), (1, -1), (-1, -1))

Words = dict[str, Any]
"""A load in words: kind, centre_mm, then size_mm or radius_mm, then force_n or torque_nmm."""


@dataclass(frozen=True, kw_only=True)
class Bricks:
    """Order, and where bricks meet along every axis as a share of its length."""

    order: int
    shares: tuple[float, ...]


COARSE = Bricks(order=5, shares=(0.0, 0.5, 0.8, 0.95, 1.0))
FINE = Bricks(order=6, shares=(0.0, 0.4, 0.7, 0.89, 0.975, 1.0))


def point_forces(load: Words, count: int) -> tuple[Floats, Floats]:
    """Return the places (k, 2) in mm and forces (k, 3) in N of Gauss points that stand for a load."""
    if load["kind"] == "rectangle":
        nodes, weights = np.polynomial.legendre.leggauss(count)
        a, b = np.array(load["size_mm"]) / 2.0
        places = np.stack(np.meshgrid(a * nodes, b * nodes), axis=-1).reshape(-1, 2)
        forces = np.outer(np.outer(weights, weights).ravel() / 4.0, load["force_n"])
        return places + load["centre_mm"][:2], forces
    radius, around, count = load["radius_mm"], 2 * count, count // 2
    nodes, weights = np.polynomial.legendre.leggauss(count)
    r, angle = radius * (nodes + 1.0) / 2.0, 2.0 * np.pi * np.arange(around) / around
    places = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], axis=-1).reshape(-1, 2)
    area = np.repeat(weights * radius / 2.0 * r, around) * 2.0 * np.pi / around
    if load["kind"] == "disk":
        forces = np.outer(area / (np.pi * radius**2), load["force_n"])
    else:
        turned = np.column_stack([-places[:, 1], places[:, 0], np.zeros(len(places))])
        forces = load["torque_nmm"] / (np.pi * radius**4 / 2.0) * area[:, None] * turned
    return places + load["centre_mm"][:2], forces


def of_point_force(x: Any, y: Any, z: Any, force: Any, nu: float, root: Any) -> tuple[Any, Any, Any]:
    """Return the displacement of Boussinesq's and Cerruti's half-space, z into it: of arrays or of NGSolve's terms."""
    fx, fy, fz = force
    r = root(x * x + y * y + z * z)
    scale, along = (1.0 + nu) / (2.0 * np.pi * MODULUS_MPA), x * fx + y * fy
    a = (2.0 * (1.0 - nu) * r + z) / (r * (r + z))
    b = (2.0 * r * (nu * r + z) + z * z) / (r * r * r * (r + z) * (r + z))
    steep, flat = z / (r * r * r), (1.0 - 2.0 * nu) / (r * (r + z))
    return (
        scale * (a * fx + b * x * along + (steep - flat) * x * fz),
        scale * (a * fy + b * y * along + (steep - flat) * y * fz),
        scale * ((steep + flat) * along + (2.0 * (1.0 - nu) / r + z * z / (r * r * r)) * fz),
    )


def half_space(points: Points, load: Words, nu: float) -> Points:
    """Return (n, 3) the half-space's displacement in mm."""
    half = load["radius_mm"] if "radius_mm" in load else max(load["size_mm"]) / 2.0
    places, forces = point_forces(load, int(NEAR * max(half, 1.0)))
    out = np.empty_like(points)
    for i, (x, y, z) in enumerate(points):
        moved = of_point_force(x - places[:, 0], y - places[:, 1], z, forces.T, nu, np.sqrt)
        out[i] = [each.sum() for each in moved]
    return out


class Quarter:
    """The rest w of the block: assembled once for a Poisson ratio, factored once for each of four symmetries."""

    def __init__(self, bricks: Bricks, nu: float) -> None:
        import ngsolve as ng

        self.ng, self.nu, self.shear = ng, nu, MODULUS_MPA / 2.0 / (1.0 + nu)
        self.mesh, self.faces = _bricks(ng, bricks.shares)
        self.moves = ng.VectorH1(self.mesh, order=bricks.order)
        self.space = self.moves * ng.L2(self.mesh, order=bricks.order - 2)
        (u, p), (v, q) = self.space.TnT()
        strain, virtual = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
        softness = 3.0 * (1.0 - 2.0 * nu) / MODULUS_MPA + SOFTNESS / self.shear
        energy = 2.0 * self.shear * (ng.InnerProduct(strain, virtual) - ng.div(u) * ng.div(v) / 3.0)
        self.form = ng.BilinearForm(self.space, symmetric=True, condense=True)
        self.form += (energy + p * ng.div(v) + q * ng.div(u) - softness * p * q) * ng.dx
        self.form.Assemble()
        self._inverses: dict[tuple[int, int], Any] = {}

    def rest(self, points: Points, load: Words) -> Points:
        """Return (n, 3) w in mm."""
        given = {image: self._given(load, image) for image in IMAGES}
        parts = {}
        for symmetry in IMAGES:  # whether the mirrored field is the field, or minus it
            signs = [symmetry[0] ** (a < 0) * symmetry[1] ** (b < 0) for a, b in IMAGES]
            held, right = (
                sum(sign * given[image][i] for sign, image in zip(signs, IMAGES, strict=True)) / 4.0 for i in (0, 1)
            )
            parts[symmetry] = held, right
        largest = max(np.abs(held).max() for held, _ in parts.values())
        out = np.zeros_like(points)
        for symmetry, (held, right) in parts.items():
            if np.abs(held).max() > 1e-9 * largest:
                out += self._read(points, symmetry, self._solved(symmetry, held, right))
        return out

    def _given(self, load: Words, image: tuple[int, int]) -> tuple[Floats, Floats]:
        """Return w on the held face, and nodal forces of the tractions that w carries on the free ones: of an image."""
        ng, form, moved = self.ng, *self._of_one
        right, held = form.vec.CreateVector(), self.moves.ndof * [0.0]
        right[:], total = 0.0, np.zeros(len(held))
        part, flip = ng.GridFunction(self.moves), np.array([*image, 1])
        for place, force in zip(*point_forces(load, AFAR), strict=True):
            for parameter, value in zip(self._place, (*place * flip[:2], *force * flip), strict=True):
                parameter.Set(float(value))
            form.Assemble()
            right.data += form.vec
            part.Set(moved, definedon=self.mesh.Boundaries(self.faces["z1"]))
            total -= part.vec.FV().NumPy()
        return total, right.FV().NumPy().copy()

    @cached_property
    def _place(self) -> list[Any]:
        """Where a point force is, and what it is: numbers that can be set."""
        return [self.ng.Parameter(0.0) for _ in range(5)]

    @cached_property
    def _of_one(self) -> tuple[Any, Any]:
        """The right side of a point force at `_place`, and its displacement, as terms."""
        ng, (x0, y0, *force) = self.ng, self._place
        place = ng.x - x0, ng.y - y0, ng.z
        moved = of_point_force(*place, force, self.nu, ng.sqrt)
        slopes = [[component.Diff(axis) for axis in (ng.x, ng.y, ng.z)] for component in moved]
        r = ng.sqrt(sum(c * c for c in place))
        mean = -self.nu / np.pi * sum(f * c for f, c in zip(force, place, strict=True)) / (r * r * r)
        test, form = self.space.TestFunction()[0], ng.LinearForm(self.space)
        for face, n in (("x1", 0), ("y1", 1)):
            traction = [self.shear * (slopes[i][n] + slopes[n][i]) + (mean if i == n else 0.0) for i in range(3)]
            form += -ng.CF(tuple(traction)).Compile() * test * ng.ds(self.faces[face])
        return form, ng.CF(moved).Compile()

    def _solved(self, symmetry: tuple[int, int], held: Floats, right: Floats) -> Any:
        form, answer = self.form, self.ng.GridFunction(self.space)
        answer.components[0].vec.FV().NumPy()[:] = held
        force = answer.vec.CreateVector()
        force.FV().NumPy()[:] = right
        force.data -= form.mat * answer.vec
        force.data += form.harmonic_extension_trans * force
        answer.vec.data += self._inverse(symmetry) * force
        answer.vec.data += form.harmonic_extension * answer.vec
        answer.vec.data += form.inner_solve * force
        return answer.components[0]

    def _inverse(self, symmetry: tuple[int, int]) -> Any:
        if symmetry not in self._inverses:
            fixed = {axis: [self.faces["z1"]] for axis in "xyz"}
            for plane, even in enumerate(symmetry):
                for axis in range(3):
                    if (axis == plane) == (even > 0):
                        fixed["xyz"[axis]].append(self.faces["xy"[plane] + "0"])
            held = {f"dirichlet{axis}": "|".join(faces) for axis, faces in fixed.items()}
            space = self.ng.VectorH1(self.mesh, order=self.moves.globalorder, **held) * self.space.components[1]
            free = space.FreeDofs(True)
            self._inverses[symmetry] = self.form.mat.Inverse(free, inverse="sparsecholesky")
        return self._inverses[symmetry]

    def _read(self, points: Points, symmetry: tuple[int, int], field: Any) -> Points:
        signs = np.ones_like(points)
        for plane, even in enumerate(symmetry):
            mirrored = np.where(np.arange(3) == plane, -even, even)
            signs[points[:, plane] < 0.0] *= mirrored
        x, y, z = np.abs(points).T
        return signs * np.asarray(field(self.mesh(x, y, z)))


def _bricks(ng: Any, shares: tuple[float, ...]) -> tuple[Any, dict[str, str]]:
    """Return the mesh of the quarter x, y >= 0, and the names of its faces by axis and end: x0, x1, y0 and so on."""
    from ngsolve.meshes import MakeStructured3DMesh

    n, size = len(shares) - 1, (*HALF_MM, THICKNESS_MM)

    def place(*at: float) -> tuple[float, ...]:
        return tuple(np.interp(at, np.linspace(0.0, 1.0, n + 1), shares) * size)

    mesh, faces = MakeStructured3DMesh(hexes=True, nx=n, ny=n, nz=n, mapping=place), {}
    for name in mesh.GetBoundaries():
        on = ng.ds(name)
        middle = np.array([ng.Integrate(c * on, mesh) for c in (ng.x, ng.y, ng.z)]) / ng.Integrate(
            ng.CF(1.0) * on, mesh
        )
        ends = {axis + "0": m for axis, m in zip("xyz", middle, strict=True)}
        ends |= {axis + "1": s - m for axis, m, s in zip("xyz", middle, size, strict=True)}
        faces[min(ends, key=lambda end: abs(ends[end]))] = name
    return mesh, faces


def main() -> None:
    """Solve all cases of block.npz twice, say how far they are from each other and from block.npz, and store them."""
    with np.load(FOLDER / "block.npz") as file:
        data = {key: file[key] for key in file.files}
    points, cases, fields = data["points"], json.loads(str(data["cases"])), {}
    for nu in sorted({case["nu"] for case in cases}):
        coarse, fine = Quarter(COARSE, nu), Quarter(FINE, nu)
        for case in cases:
            if case["nu"] != nu:
                continue
            key, load = case["key"], case["load"]
            rest = fine.rest(points, load)
            whole = half_space(points, load, nu) + rest
            size = np.linalg.norm(whole, axis=1).max()
            own, before = (
                float(np.linalg.norm(d, axis=1).max() / size)
                for d in (rest - coarse.rest(points, load), whole - data[key])
            )
            print(f"{key:12s} from coarser bricks {own:.1e}, from block.npz {before:.1e}", flush=True)
            case["error_estimate"], fields[key] = own, whole.astype(np.float32)
    slices = {key: data[key] for key in data if key.startswith("slice_")}
    told = np.array(json.dumps(cases))
    np.savez_compressed(FOLDER / "block_converged.npz", points=points, cases=told, **slices, **fields)


if __name__ == "__main__":
    main()
