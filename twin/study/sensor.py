"""A made sensor: its body, its markers, its camera, each computed when first asked for and then kept.

`Sensor` is where the two wings meet. The *world* side works on the actual sensor, drawn from the tolerances; the
*sense* side is told the nominal design only, on a mesh of its own.
"""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from twin.arrays import Picture, Pixels, Points, Singles, as_points
from twin.errors import AccuracyWarning, InputError, RecipeError, require
from twin.parts.load import Load, Rectangles
from twin.parts.markers import MarkerSet, place
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.streams import Purpose, stream
from twin.study.actual import Actual, make
from twin.study.elastic import actual_ladder, nominal_compliance
from twin.study.motion import Motion, cover_motion, with_stiff_beads
from twin.study.sites import on_grid
from twin.theory.optics import project

if TYPE_CHECKING:
    from twin.world.contact.contact import ContactState
    from twin.world.elasticity.compliance import Compliance
    from twin.world.elasticity.covered import Covered
    from twin.world.elasticity.ladder import CoveredLadder, Ladder
    from twin.world.elasticity.stiff import StiffBeads
    from twin.world.picture.cover import CoverMotion
    from twin.world.picture.exposure import Pattern
    from twin.world.picture.maps import PictureTruth
    from twin.world.picture.markers import Ellipsoids
    from twin.world.picture.render import Outlines, Renderer


class Sensor:
    """One sensor, made from a scene.

    Parameters
    ----------
    scene
        The nominal design, with tolerances, seed and accuracy.
    progress
        Told about work that takes longer.

    Raises
    ------
    InputError
        It is no `Scene`.
    """

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        require(scene, Scene, "the scene", "load one with twin.load_scene")
        self.nominal = scene
        self.progress = progress
        self._warned = False
        self._cut: tuple[Load, Rectangles] | None = None

    @cached_property
    def actual(self) -> Actual:
        """The sensor as it was made."""
        return make(self.nominal)

    @cached_property
    def ladder(self) -> Ladder | CoveredLadder:
        """The actual body on as many levels of mesh as the asked accuracy takes."""
        return actual_ladder(self.actual.scene, self.progress)

    @property
    def compliance(self) -> Compliance | Covered:
        """Compliance of the actual body, on the level that the asked accuracy takes."""
        return self.ladder.base

    @cached_property
    def nominal_compliance(self) -> Compliance | Covered:
        """Compliance of the nominal body, on a mesh of its own: what the sensor's software may be told."""
        return nominal_compliance(self.nominal, self.progress)

    @cached_property
    def nominal_markers(self) -> MarkerSet:
        """The markers as drawn."""
        return place(self.nominal.body, self.nominal.markers)

    @cached_property
    def renderer(self) -> Renderer:
        """The camera's view of the actual sensor."""
        if self.nominal.camera is None:
            raise RecipeError("this scene has no [camera] table, so there is no picture of it")
        from twin.world.picture.render import Renderer
        from twin.world.picture.room import require_room

        require_room(self.actual.scene)
        return Renderer(self.actual.scene, self.ellipsoids(None))

    def rectangles(self, load: Load) -> Rectangles:
        """Cut a load into the rectangles that the solvers work on; the last load's are kept."""
        if self._cut is None or self._cut[0] is not load:
            require(load, Load, "the load", "make one with twin.Traction, or of a press: sensor.press(press).load")
            from twin.world.elasticity.tile import tile

            self._cut = load, tile(load, self.actual.scene.body)
        return self._cut[1]

    def displacement(self, points_mm: Points, load: Load) -> Points:
        """Return the (n, 3) displacement in mm of points inside the body under ``load``.

        Raises
        ------
        OutOfBodyError
            A point lies outside the body.
        InputError
            The load misses the sensing surface.
        """
        points = as_points(points_mm, "points_mm")
        answer = self.ladder.displacement(points, self.rectangles(load), always=False)
        self._warn_if_inaccurate(answer.error)
        return answer.displacement_mm

    def motion(self, load: Load) -> Motion:
        """Return how the actual markers move and turn under ``load``."""
        rectangles, points = self.rectangles(load), self.actual.markers.points
        answer = self.ladder.displacement(points, rectangles)
        self._warn_if_inaccurate(answer.error)
        compliance = answer.compliance
        passive = Motion(
            displacement_mm=answer.displacement_mm, gradient=compliance.gradient(points, rectangles),
            error=answer.error, cover=self._cover_motion(compliance, rectangles),
        )  # fmt: skip
        return with_stiff_beads(passive, self.stiff_beads, lambda p: compliance.displacement(p, rectangles))

    def _cover_motion(self, compliance: Compliance | Covered, rectangles: Rectangles) -> CoverMotion | None:
        """Return how the cover moves where the camera sees it; None if the scene doesn't ask for that."""
        cover = self.nominal.cover
        if cover is None or not cover.deforms or self.nominal.camera is None:
            return None
        assert self.renderer.background is not None
        return cover_motion(compliance, self.renderer.background.points, rectangles)

    def motion_of_patches(self, *patches: Rectangles, strained: bool = True, gather: bool = True) -> Motion:
        """Return how the actual markers move, on the level of mesh that the asked accuracy takes and no other.

        What `motion` answers, for many loads: patches far above all markers are gathered into a few point forces
        (`twin.world.elasticity.gather`), and the answer, with its estimated error, is never taken from a finer mesh.

        Parameters
        ----------
        patches
            What pushes; what lies apart is given apart, and gathered each by itself.
        strained
            Whether gradients are wanted too: without them prints are not strained and beads not turned (of which no
            picture shows anything), and the gradients are zero.
        gather
            Whether patches may be gathered; else each pushes as it is, which the audit of datasets compares with.
        """
        from twin.world.elasticity.gather import gathered
        from twin.world.elasticity.tile import join

        points = self.actual.markers.points
        whole = join(patches)
        few = join([gathered(points, group) for group in patches]) if gather else whole
        moved, error = self.compliance.answer(points, few)
        strained = strained or self.stiff_beads is not None
        gradient = self.compliance.gradient(points, whole) if strained else np.zeros((len(points), 3, 3))
        passive = Motion(displacement_mm=moved, gradient=gradient, error=error)
        return with_stiff_beads(
            passive, self.stiff_beads, lambda p: self.compliance.displacement(p, gathered(p, whole))
        )

    @cached_property
    def stiff_beads(self) -> StiffBeads | None:
        """The actual rigid beads and how they push each other; None where no layer is ``stiff``."""
        if not any(layer.stiff for layer in self.actual.scene.markers.values()):
            return None
        from twin.world.elasticity.stiff import stiff_beads

        return stiff_beads(self.actual.markers, self.actual.scene.markers)

    @cached_property
    def markers_strain(self) -> bool:
        """Whether a layer strains with the body (or is stiff), so that pictures need the field's gradient."""
        return any(layer.kind == "print" or layer.stiff for layer in self.actual.scene.markers.values())

    def _warn_if_inaccurate(self, got: float) -> None:
        """Warn, once per sensor, of a load under which the asked accuracy is not reached."""
        asked = self.nominal.displacement_error
        if got > 1.1 * asked and not self._warned:
            self._warned = True
            warnings.warn(
                f"accuracy.displacement = {asked:g} is asked, but displacements may be {got:.2g} of the largest off: "
                "move the load away from the edges of the sensing surface, or allow more",
                AccuracyWarning,
                stacklevel=3,
            )

    def press(self, press: Press | None = None, *, with_error: bool = False) -> ContactState:
        """Solve a press; the scene's own if none is given.

        Parameters
        ----------
        press
            Probes, places, paths and friction.
        with_error
            Whether to tell how far the patches may be off (``error``): a tenth more work.

        Returns
        -------
        The last state that converged; if that is not the end of the path, ``complete`` is false.

        Raises
        ------
        ContactError
            There is no equilibrium, or the contact leaves the sensing surface.
        """
        from twin.world.contact.contact import press as solve

        wanted = press if press is not None else self.nominal.press
        if wanted is None:
            raise RecipeError("this scene has no [press] table: give Sensor.press a Press")
        require(wanted, Press, "the press", "make one with twin.Press; loads go to Sensor.displacement and .picture")
        material = self.actual.scene.material
        return solve(
            wanted,
            self.actual.scene.body,
            self.compliance,
            patches_across=self.nominal.contact_patches,
            youngs_modulus_mpa=material.youngs_modulus_mpa,
            poisson_ratio=material.poisson_ratio,
            increments=self.nominal.accuracy.contact_increments,
            with_error=with_error,
        )

    def picture(self, load: Load | Motion | None, exposure: int | None = None) -> Picture:
        """Return the CCD picture (height, width, 3) under ``load``, or at rest.

        Parameters
        ----------
        load
            A load, a motion of the markers computed before, or None for the rest state.
        exposure
            Number of the exposure: pictures of the same number have the same noise. The rest state is exposure 0, a
            loaded one 1 if not given.

        Raises
        ------
        RecipeError
            The scene has no camera.
        InputError
            ``load`` or ``exposure`` is of another kind.
        """
        number = exposure if exposure is not None else int(load is not None)
        if not isinstance(number, int | np.integer) or number < 0:
            raise InputError(f"exposure = {number!r}: allowed are whole numbers from 0")
        motion = self._moved(load)
        radiance = self.renderer.radiance(self.ellipsoids(motion), motion.cover if motion is not None else None)
        return self._exposed(radiance, number)

    def seen(self, motion: Motion | None, exposure: int) -> tuple[Picture, Outlines]:
        """Return `picture` and the markers' visible outlines, for little more than the price of the first."""
        cover = motion.cover if motion is not None else None
        radiance, outlines = self.renderer.seen(self.ellipsoids(motion), cover)
        return self._exposed(radiance, exposure), outlines

    def _exposed(self, radiance: Singles, exposure: int) -> Picture:
        from twin.world.picture.exposure import expose

        return expose(radiance, self.nominal.ccd, stream(self.nominal.seed, Purpose.EXPOSURE, exposure), self.pattern)

    def picture_truth(self, load: Load | Motion | None) -> PictureTruth:
        """Return the truth beside `picture`: which marker each pixel shows, how deep, how far each has moved.

        Raises
        ------
        RecipeError
            The scene has no camera.
        """
        names = list(self.nominal.markers)
        layer = np.array([names.index(name) for name in self.actual.markers.layer.tolist()], np.int64)
        return self.renderer.truth(self.ellipsoids(load), self.ellipsoids(None), layer)

    @cached_property
    def pattern(self) -> Pattern | None:
        """What the CCD's pixels do alike in every picture, None for an even CCD."""
        from twin.world.picture.exposure import fixed_pattern

        camera = self.nominal.camera
        if camera is None:
            return None
        own = stream(self.nominal.seed, Purpose.SENSOR_PATTERN)
        return fixed_pattern(self.nominal.ccd, (camera.height_px, camera.width_px), own)

    def _moved(self, load: Load | Motion | None) -> Motion | None:
        return load if load is None or isinstance(load, Motion) else self.motion(load)

    def ellipsoids(self, load: Load | Motion | None) -> Ellipsoids:
        """Return the actual markers as they stand under ``load``."""
        from twin.world.picture.markers import ellipsoids

        markers, layers = self.actual.markers, self.actual.scene.markers
        motion = self._moved(load)
        if motion is None:
            return ellipsoids(markers, layers, prints=self.actual.prints)
        return ellipsoids(markers, layers, motion.displacement_mm, motion.gradient, self.actual.prints)

    def project(self, points_mm: Points, which: Literal["actual", "nominal"] = "actual") -> Pixels:
        """Return the (n, 2) picture places of points, seen by the actual or the nominal camera."""
        scene = self.actual.scene if which == "actual" else self.nominal
        if scene.camera is None:
            return np.zeros((0, 2))
        points = as_points(points_mm, "points_mm")
        return project(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)

    @cached_property
    def layout_px(self) -> dict[str, Pixels]:
        """Nominal rest places of the markers by layer, px: what the tracker is told."""
        pixels = self.project(self.nominal_markers.points, "nominal")
        return {name: pixels[self.nominal_markers.of(name)] for name in self.nominal.markers}

    @cached_property
    def sites(self) -> Rectangles:
        """The sites where forces are reconstructed, as squares of the sites' pitch under no force yet."""
        if self.nominal.reconstruction is None:
            raise RecipeError("this scene has no [reconstruction] table, so there are no sites")
        grid = self.nominal.reconstruction.sites
        return on_grid(self.nominal.body, grid, grid.pitch_mm / 2, "reconstruction.sites")
