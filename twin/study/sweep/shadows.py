"""What the shadows of markers do to tracked centres: how far they pull them as they move, how much they are doubted.

A marker between an LED and another one takes that LED's light from a part of it. A centre is read off a marker's rim,
so a shadow over one side of the rim pulls it to the other; at rest as under a push, and only what changes counts. For
small motions the change is linear: a 2 x 3 matrix for each marker and each neighbour that shadows it
(`twin.study.sweep.pull`). What the fit leaves at rest makes the tracker doubt the marker, which then counts less in the
forces, so that pushes are told wider.

Validity: shadows of markers on others, at rest as the nominal design has them; markers shadow as spheres; a shadow's
edge is as blurred as the picture; motions are small. Against the tracker: `tests/study/sweep/test_shadows.py`. Where
shadows take most of a marker's light, what the tracker's doubt comes to is told within a factor of two or three only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Floats, Ints
from twin.compiled import njit
from twin.parts.scene import Scene
from twin.sense.judge_fit import DOUBT, UNUSUAL
from twin.study.sweep.noise import can_tell, pixel_noise
from twin.study.sweep.pull import MISFIT, SPREAD, pulls
from twin.study.sweep.view import View
from twin.theory.centroid import PIXEL_VARIANCE
from twin.world.picture.lighting import lamps_at
from twin.world.picture.occluders import occluders


@dataclass(frozen=True, kw_only=True)
class Shadows:
    """What shadows do to the markers of a design.

    Attributes
    ----------
    spread
        (n,) standard deviation of a marker's tracked centre, over that of one in full light.
    doubt
        (n,) that which the tracker tells of it: more, where the fit at rest leaves more than noise explains.
    marker, neighbour, pull_px_per_mm
        (m,), (m,) and (m, 2, 3): a marker's seeming motion for a neighbour's motion relative to it.
    """

    spread: Floats
    doubt: Floats
    marker: Ints
    neighbour: Ints
    pull_px_per_mm: Floats

    def pulled(self, moved_mm: Floats) -> Floats:
        """Return (n, 2, q) px by which centres seem to move besides for (n, 3, q) motions."""
        out = np.zeros((len(moved_mm), 2, moved_mm.shape[2]))
        _pulled(self.marker, self.neighbour, self.pull_px_per_mm, np.ascontiguousarray(moved_mm), out)
        return out


def shadows_of(scene: Scene, view: View) -> Shadows | None:
    """Return what shadows do to a design's markers; None where no LED shines, or the camera can't be told.

    Parameters
    ----------
    scene, view
        The design, and how its camera sees it.
    """
    if scene.light is None or scene.light.ambient >= 1 or not can_tell(scene):
        return None
    seen = np.flatnonzero(view.inside & np.isfinite(view.markers.points).all(axis=1))
    if not len(seen):
        return None
    points, jacobian = view.markers.points[seen], view.jacobian[seen]
    kinds = list(scene.markers.values())
    layer = np.searchsorted([view.markers.of(name).stop for name in scene.markers], seen, side="right")
    radius = np.array([each.diameter_mm / 2 for each in kinds])[layer]
    towards = np.cross(jacobian[:, 0], jacobian[:, 1])
    towards *= (np.sign(towards[:, 2]) / np.linalg.norm(towards, axis=1))[:, None]
    lamps = lamps_at(points, scene)
    way = lamps.place - points[:, None]
    far = np.linalg.norm(way, axis=2)
    way /= far[:, :, None]
    shine = lamps.power / far**2
    direct = (shine * np.maximum(np.einsum("nlk,nk->nl", way, towards), 0.0)).sum(axis=1)
    largest = direct.max(initial=0.0)
    if largest <= 0:
        return None
    ambient = scene.light.ambient
    share = (1 - ambient) / largest
    found = occluders(points, radius, lamps.place, lamps.power > 0)
    noise = np.ones((len(scene.markers), 2))
    for number, name in enumerate(scene.markers):
        (contrast, ground), (_, inside) = (pixel_noise(scene, name, height) for height in (0.0, 1.0))
        noise[number] = np.array([ground, inside]) / max(contrast, 1e-9)
    blur = np.sqrt(7.0) * np.hypot(scene.ccd.spelt_out().psf_px or 0.0, np.sqrt(PIXEL_VARIANCE))
    told, marker, neighbour, pull = pulls(
        layer, points, radius, view.diameter_px[seen] / 2, np.array([each.kind == "bead" for each in kinds])[layer],
        _across(jacobian), towards, way, share * shine, ambient, found.first, found.members, noise**2, blur,
    )  # fmt: skip
    spread, doubt = np.ones((2, len(view.markers)))
    spread[seen] = np.sqrt(told[:, SPREAD])
    for number in np.unique(layer):
        part = layer == number
        bad = told[part, MISFIT] / max(np.quantile(told[part, MISFIT], 0.25), 1.0) - UNUSUAL
        doubt[seen[part]] = spread[seen[part]] * np.sqrt(1.0 + DOUBT * np.maximum(bad, 0.0))
    return Shadows(spread=spread, doubt=doubt, marker=seen[marker], neighbour=seen[neighbour], pull_px_per_mm=pull)


def _across(jacobian: Floats) -> Floats:
    """Return the (n, 3, 2) mm/px across the line of sight of (n, 2, 3) px/mm."""
    a, b = jacobian[:, 0], jacobian[:, 1]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    inverse = np.array([[bb, -ab], [-ab, aa]]) / (aa * bb - ab * ab)  # of J J^T
    return np.asarray(np.einsum("nik,ijn->nkj", jacobian, inverse))


@njit(cache=True)
def _pulled(marker: Ints, neighbour: Ints, pull: Floats, moved: Floats, out: Floats) -> None:
    for m in range(len(marker)):
        i, j = marker[m], neighbour[m]
        for axis in range(2):
            for k in range(3):
                for q in range(moved.shape[2]):
                    out[i, axis, q] += pull[m, axis, k] * (moved[j, k, q] - moved[i, k, q])
