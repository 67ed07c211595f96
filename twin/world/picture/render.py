"""The picture as light: markers by a renderer over the cover, seen through folded optics.

`Renderer` sets exposure and view, and lays markers over the cover; a shader of `RENDERERS` draws
them. `_PathRenderer` has the whole picture made by Mitsuba's path integrator. Outlines come from
the splat in closed form, whatever draws the picture, and are its truth.

Validity: markers at least a sub-pixel in radius. Defocus is the mean of pictures through points of
the pupil (`twin.world.picture.camera_rays`); outlines are those through its middle, and of light of
588 nm where an index depends on the wavelength.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.arrays import Floats, Points, Singles
from twin.errors import AccuracyWarning, MissingCapability, RecipeError
from twin.parts.camera import DISC_WEIGHTS
from twin.parts.load import Load
from twin.parts.scene import Scene
from twin.world.picture.backend import FORCE, Variant
from twin.world.picture.camera_rays import View
from twin.world.picture.cover import Background, CoverMotion
from twin.world.picture.ellipsoids import Ellipsoids
from twin.world.picture.lamps import Lamps
from twin.world.picture.mitsuba_tracer import MitsubaTracer
from twin.world.picture.picture_job import PictureJob, Shader
from twin.world.picture.splat import Outlines, Splat

if TYPE_CHECKING:
    from twin.world.picture.path_tracer import PathTracer

RENDERERS: dict[str, Callable[[View, float, float], Shader]] = {
    "splat": Splat,
    "llvm_ad_rgb": partial(MitsubaTracer, "llvm_ad_rgb"),
    "cuda_ad_rgb": partial(MitsubaTracer, "cuda_ad_rgb"),
}
"""What makes each renderer, by its name: of the camera's rays, the length of the renderer's unit in
mm, and the share of light that comes from all around."""

_ERROR_PX = {"splat": (0.0215, 0.0095, 0.0052, 0.0038), "traced": (0.033, 0.0148, 0.0107, 0.0096)}
"""The largest error of an intensity centroid for k = 1 to 4; beyond, the splat's falls as 1/k."""

_FINEST = 16
"""The largest k."""

_WAVELENGTHS_NM = (600.0, 530.0, 460.0)
"""Middles of the camera's red, green and blue (assumed)."""

_C_NM, _D_NM, _F_NM = 656.3, 587.6, 486.1
"""Wavelengths that an Abbe number is defined by."""

_SHADOW_PX = 0.2
"""The most that a shadow moves a centroid."""


class Renderer:
    """Renders one sensor's markers again and again; a `_PathRenderer` where the scene asks for one.

    Parameters
    ----------
    scene
        The actual scene; camera, light and markers are needed.
    rest
        The markers at rest, by which the exposure is set.
    variant
        How to render; None: the best for ``accuracy.centroid_px`` that works here.
    subpixels
        k of the k x k rays per pixel; None: from ``accuracy.centroid_px``.
    shadows
        Whether markers shadow each other: without, pictures cost less and centroids are up to 0.2
        px off; None: unless ``accuracy.centroid_px`` allows for that.
    gain
        Light on the sensor (1 fills its wells) of what is as bright as white paper in the brightest
        marker's place; None: what exposes the brightest marker at rest, or the ground if that is
        brighter, to ``ccd.white_dn``.

    Raises
    ------
    RecipeError
        The scene has no camera, or no light reaches the markers.
    """

    def __new__(cls, scene: Scene, *_: Any, **__: Any) -> Renderer:
        """Return an object of the class that the scene's ``renderer`` names."""
        return super().__new__(_PathRenderer if scene.renderer == "path" else Renderer)

    def __init__(
        self,
        scene: Scene,
        rest: Ellipsoids,
        variant: Variant | None = None,
        subpixels: int | None = None,
        shadows: bool | None = None,
        gain: float | None = None,
    ) -> None:
        if scene.camera is None or scene.light is None or not scene.markers:
            raise RecipeError(
                "camera: a scene without camera, light and markers has no picture: add these tables"
            )
        self.scene = scene
        self._rest = rest
        wanted = scene.accuracy.centroid_px
        self.variant = variant or self.method(scene)
        needed = isinstance(wanted, str) or wanted < _centroid_error(1, False, self.variant.name)
        self.shadows = needed if shadows is None else shadows
        self.subpixels = subpixels or _subpixels_for(wanted, self.variant.name)
        self._top, white = Lamps.brightest(rest, scene)
        self._unit = float(np.median([layer.diameter_mm / 2 for layer in scene.markers.values()]))
        view = View.of(scene, self._top)
        ground = view.ground_light(scene.ccd)
        self._gain = gain or scene.ccd.white_level / max(white, ground)
        if view.veil is not None:
            darker = ground / max(white, replace(view, veil=None).ground_light(scene.ccd))
            if darker > 2:
                warnings.warn(
                    "the window mirrors the LEDs into more than 1 % of the picture, which sets its "
                    f"exposure: all else is {darker:.2g} times darker. Move light.positions_mm to "
                    f"the side, make light.radius_mm ({scene.light.radius_mm:g}) smaller, or raise "
                    f"ccd.exposure ({scene.ccd.exposure:g})",
                    AccuracyWarning,
                    stacklevel=2,
                )
        self._view = view.times(self._gain)
        self._splat = Splat(self._view, self._unit, scene.light.ambient)
        self._parts: list[tuple[Singles, Renderer]] = []
        for share, tables in _colours(scene):
            coloured = scene.model_copy(update=tables)
            cameras = View.pupil_cameras(coloured)
            weights = DISC_WEIGHTS if cameras else np.ones(1)
            if tables and not cameras:
                cameras = [coloured.imaging[0]]
            for weight, camera in zip(weights, cameras, strict=False):
                part = self._like(self.variant, **{**tables, "camera": camera})
                part.background = self.background  # whose places `radiance` gets the motion of
                self._parts.append((np.float32(weight) * share, part))

    @staticmethod
    def method(scene: Scene) -> Variant:
        """Return how to render a scene: as its ``renderer`` names it.

        With ``auto``, and no variant named in the environment, a number in ``accuracy.centroid_px``
        takes the cheapest way, and ``auto`` there Mitsuba where it works.

        Raises
        ------
        MissingCapability
            The scene asks for Mitsuba, which doesn't work here.
        RecipeError
            A glossy skin of a smaller index than the rubber's, or dispersion by paths.
        """
        asked = scene.renderer
        index = scene.material.refractive_index
        if asked == "path" and len(_colours(scene)) > 1:
            raise RecipeError(
                "abbe_number: renderer = 'path' takes one index for all light; leave it out of "
                "material and camera.layers, or take another renderer"
            )
        for name, layer in scene.markers.items():
            if layer.gloss and layer.gloss[0] <= index:
                raise RecipeError(
                    f"markers.{name}.gloss = {layer.gloss}: the skin's index must be above that of "
                    f"the rubber, material.refractive_index = {index:g}"
                )
        if asked == "splat":
            return Variant.choose("splat")
        wanted = scene.accuracy.centroid_px
        if asked == "auto" and not isinstance(wanted, str) and not os.environ.get(FORCE):
            why = f"cheapest for accuracy.centroid_px = {wanted:g}"
            return Variant(name="splat", library=None, reason=why)
        chosen = Variant.choose()
        if asked != "auto" and not chosen.name.endswith("_ad_rgb"):
            raise MissingCapability(
                f"renderer = {asked!r} needs Mitsuba, but {chosen.reason}; or take renderer = "
                "'splat'"
            )
        return chosen

    def _like(self, variant: Variant, exposure: float | None = None, **tables: Any) -> Renderer:
        """Return a renderer, of this exposure by default, of a scene with other tables."""
        gain = self._gain if exposure is None else exposure * self._top
        scene = self.scene.model_copy(update=tables)
        return Renderer(scene, self._rest, variant, self.subpixels, self.shadows, gain)

    def of_exposure(self, exposure: float) -> Renderer:
        """Return this renderer with another `exposure`."""
        return self if exposure == self.exposure else self._like(self.variant, exposure)

    @property
    def centroid_error_px(self) -> float:
        """Bound on the error of intensity centroids in the noise-free picture, px."""
        return _centroid_error(self.subpixels, self.shadows, self.variant.name)

    @property
    def drawn_by(self) -> str:
        """What draws the pictures, in one line; of the splat also why that, and what is faster."""
        if self.variant.name != "splat":
            return self.variant.name
        return f"{self.variant.name}: {self.variant.reason}"

    @property
    def exposure(self) -> float:
        """Light on the sensor that white makes under irradiance 1: LEDs of intensity 1, lengths in
        mm."""
        return self._gain / self._top

    @cached_property
    def _shader(self) -> Shader:
        """What draws the markers; the splat of the outlines, if the splat draws them."""
        if self.variant.name == "splat":
            return self._splat
        return RENDERERS[self.variant.name](self._view, self._unit, self.scene.imaging[1].ambient)

    @cached_property
    def background(self) -> Background | None:
        """The places of the cover, and of specks in the rubber, whose motion `radiance` takes; None
        where none moves."""
        return Background(self.scene, self._top) if Background.moves(self.scene) else None

    def scenery(
        self, moved: Callable[[Points], tuple[Points, Floats]], probes: tuple[Load.Placed, ...]
    ) -> CoverMotion | None:
        """Return what `radiance` takes of a load: ``moved`` gives displacements and gradients of
        places; None where pictures don't show any of it."""
        if self.background is None and (self._view.see_through is None or not probes):
            return None
        places = np.zeros((0, 3)) if self.background is None else self.background.moving
        displacement, gradient = moved(places) if len(places) else (places, np.zeros((0, 3, 3)))
        return CoverMotion(displacement_mm=displacement, gradient=gradient, probes=probes)

    def radiance(self, markers: Ellipsoids, cover: CoverMotion | None = None) -> Singles:
        """Return the (height, width, 3) light on the sensor, 1 filling its wells.

        ``cover`` has how the places of `background` have moved; None: they are at rest.
        """
        if not self._parts:
            job = self._job(markers, self.subpixels)
            return self._over_cover(markers, job, *self._shader.shade(job), cover)
        light: Singles = np.zeros_like(self._view.cover)
        for weight, part in self._parts:
            light += weight * part.radiance(markers, cover)
        return light

    def seen(
        self, markers: Ellipsoids, cover: CoverMotion | None = None
    ) -> tuple[Singles, Outlines]:
        """Return `radiance` and `outlines`, in one pass where the splat draws the picture."""
        if self._parts or self.variant.name != "splat":
            return self.radiance(markers, cover), self.outlines(markers)
        job = self._job(markers, self.subpixels)
        marks, free, outlines = self._splat.look(job)
        return self._over_cover(markers, job, marks, free, cover), outlines

    def _over_cover(
        self,
        markers: Ellipsoids,
        job: PictureJob,
        marks: Singles,
        free: Singles,
        cover: CoverMotion | None,
    ) -> Singles:
        """Return the picture: (m, 3) light of markers and their highlights over what they leave
        free of the cover, then specks and veil."""
        light = self._view.cover.copy()
        if self.background is not None and self.background.deforms:
            shadows = self.background.shadows(markers, cover)
            hidden = [self._drawn(shapes, self._unit)[1] for shapes in shadows]
            if cover is not None or hidden:
                light *= self.background.change(cover, hidden)
        if (behind := self._view.behind(() if cover is None else cover.probes)) is not None:
            light += behind
        if markers.texture is not None:
            marks = marks * job.texture(markers, light.shape[1])[:, None]
        there = light.reshape(-1, 3)
        seen = there.take(job.pixels, axis=0)
        seen *= free[:, None]
        seen += marks * self._view.vignette.ravel().take(job.pixels)[:, None]
        there[job.pixels] = seen
        if markers.gloss is not None and self.scene.imaging[1].ambient < 1:
            from twin.world.picture.highlights import add_highlights

            add_highlights(light, markers, job, self.scene, self._view)
        self._add_specks(light, markers, cover)
        return light

    def _add_specks(self, light: Singles, markers: Ellipsoids, cover: CoverMotion | None) -> None:
        """Lay marks in the rubber over what lies behind them, and the veil over all, in place."""
        for marks, shapes in () if self.background is None else self.background.specks(cover):
            assert marks.depth_mm is not None
            bright, covered = self._drawn(shapes, marks.size_mm / 2)
            if marks.hollow > 0:
                inner = replace(shapes, axes=marks.hollow * shapes.axes)
                rim = np.maximum(covered - self._drawn(inner, marks.size_mm / 2)[1], 0)
                bright *= (rim / np.maximum(covered, 1e-6))[:, :, None]
                covered = rim
            # Markers nearer to the camera hide them.
            nearer = markers.rows(self.scene.body.depth(markers.centres) > marks.depth_mm)
            if len(nearer):
                free = 1 - self._drawn(nearer, self._unit)[1]
                bright *= free[:, :, None]
                covered = covered * free
            light *= 1 - covered[:, :, None]
            light += bright * self._view.vignette[:, :, None]
        if self._view.veil is not None:
            light += self._view.veil

    def _drawn(self, shapes: Ellipsoids, unit_mm: float) -> tuple[Singles, Singles]:
        """Return the (height, width, 3) light of ellipsoids without shadows, before vignetting and
        gain, and the (height, width) share of each pixel that they cover."""
        job = self._job(shapes, self.subpixels, shadows=False, unit_mm=unit_mm)
        splat = self._splat
        if unit_mm != self._unit:
            splat = Splat(self._view, unit_mm, self.scene.imaging[1].ambient)
        light, free = splat.shade(job)
        bright = np.zeros_like(self._view.cover)
        covered = np.zeros(bright.shape[:2], np.float32)
        bright.reshape(-1, 3)[job.pixels] = light
        covered.reshape(-1)[job.pixels] = 1 - free
        return bright, covered

    def outlines(self, markers: Ellipsoids, subpixels: int | None = None) -> Outlines:
        """Return centroid, share and area of what the picture shows of each marker, in closed form;
        ``subpixels`` is another k than the picture's."""
        job = self._job(markers, subpixels or self.subpixels, shadows=False)
        return self._splat.look(job, bright=False)[2]

    def _job(
        self,
        markers: Ellipsoids,
        subpixels: int,
        *,
        shadows: bool = True,
        unit_mm: float | None = None,
    ) -> PictureJob:
        return PictureJob.of(
            markers,
            self.scene,
            self._view,
            unit_mm=unit_mm or self._unit,
            full_power=self._top,
            subpixels=subpixels,
            shadows=self.shadows and shadows,
        )


class _PathRenderer(Renderer):
    """Has Mitsuba's path integrator make the whole picture."""

    @property
    def drawn_by(self) -> str:
        """See `Renderer`."""
        return f"path, {self.scene.accuracy.paths} paths a pixel, {super().drawn_by}"

    @cached_property
    def _path_tracer(self) -> PathTracer:
        Variant.mitsuba(self.variant.name)
        from twin.world.picture.path_tracer import PathTracer

        views = [part._view for _, part in self._parts] or [self._view]
        return PathTracer(self.scene, views, self._top, self.scene.accuracy.paths)

    def radiance(self, markers: Ellipsoids, cover: CoverMotion | None = None) -> Singles:
        """Return `Renderer.radiance` by paths from the LEDs; the even share of light, which has
        none, in closed form."""
        share = np.float32(self.scene.imaging[1].ambient)
        light = (1 - share) * self._path_tracer.radiance(markers, cover)
        if share > 0:
            light += share * self._evenly_lit.radiance(markers)
        # What has no path, through each point of the pupil.
        seen = np.zeros_like(light)
        for weight, part in self._parts or [(np.ones(3, np.float32), self)]:
            one = light.copy()
            if (behind := part._view.behind(() if cover is None else cover.probes)) is not None:
                one += (1 - part._drawn(markers, self._unit)[1])[:, :, None] * behind
            part._add_specks(one, markers, cover)
            seen += weight * one
        return seen

    @cached_property
    def _evenly_lit(self) -> Renderer:
        """The same camera and exposure where all light comes from all around, without what
        `radiance` lays over both shares of light."""
        camera, light = self.scene.imaging
        light = light.model_copy(update={"ambient": 1.0, "outside": (0.0, 0.0, 0.0)})
        camera = camera.without_marks_in_rubber()
        return self._like(Variant.choose("splat"), camera=camera, light=light, renderer="splat")


def _colours(scene: Scene) -> list[tuple[Singles, dict[str, Any]]]:
    """Return (3,) shares of red, green and blue, and the tables of the scene in their light: one
    for each colour where an index depends on it, else one of all colours.

    Notes
    -----
    Cauchy's law n = a + b / wavelength^2, by the index at 588 nm and the Abbe number.
    """
    camera = scene.camera
    layered = () if camera is None else camera.layers
    numbers = [scene.material.abbe_number, *(layer.abbe_number for layer in layered)]
    if camera is None or not any(numbers):
        return [(np.ones(3, np.float32), {})]
    colours = []
    for share, wavelength in zip(np.eye(3, dtype=np.float32), _WAVELENGTHS_NM, strict=True):
        steps = (wavelength**-2 - _D_NM**-2) / (_F_NM**-2 - _C_NM**-2)

        def bent(part: Any, key: str, steps: float = steps) -> Any:
            n, abbe = getattr(part, key), part.abbe_number
            index = n if abbe is None else max(n + (n - 1) / abbe * steps, 1.0)
            return part.model_copy(update={key: index, "abbe_number": None})

        layers = tuple(bent(layer, "index") for layer in camera.layers)
        tables = {
            "material": bent(scene.material, "refractive_index"),
            "camera": camera.model_copy(update={"layers": layers}),
        }
        colours.append((share, tables))
    return colours


def _subpixels_for(centroid_px: float | str, method: str) -> int:
    """Return the least k whose error is at most ``centroid_px``; ``auto`` is 3, below the noise of
    one exposure."""
    if isinstance(centroid_px, str):
        return 3
    enough = (k for k in range(1, _FINEST) if _centroid_error(k, True, method) <= centroid_px)
    return next(enough, _FINEST)


def _centroid_error(subpixels: int, shadows: bool, method: str) -> float:
    """Return a bound on the error of intensity centroids, px, measured for both sensors (picture
    benchmark): most of it comes from the edges of shadows, which are hard in Mitsuba's rays."""
    bounds = _ERROR_PX["splat" if method == "splat" else "traced"]
    beyond = min(len(bounds) / subpixels, 1.0) if method == "splat" else 1.0
    return bounds[min(subpixels, len(bounds)) - 1] * beyond + (0.0 if shadows else _SHADOW_PX)
