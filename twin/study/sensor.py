"""A made sensor: its body, its markers, its camera, each computed at first use and then kept.

`Sensor` connects `twin.world` and `twin.sense`. The truth is computed from the actual sensor, drawn
from the tolerances (`_make`). The sensor's software gets the nominal design only, on a mesh of its
own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from twin.arrays import Chart, Floats, Picture, Pixels, Points, Progress, Singles, frozen
from twin.blas_threads import one_blas_thread
from twin.errors import AccuracyWarning, ContactError, InputError, RecipeError, require
from twin.parts.load import Load, Rectangles
from twin.parts.markers import MarkerSet
from twin.parts.part import Purpose
from twin.parts.press import MOST_PATCHES, Press
from twin.parts.scene import Scene
from twin.parts.vary import CUT
from twin.theory.optics import project
from twin.theory.relaxation import Relaxation

if TYPE_CHECKING:
    from twin.world.contact.contact_state import PressError, Validity
    from twin.world.contact.pressing import ContactState, PathMemory
    from twin.world.elasticity.coated import CoveredCompliance, Ladder
    from twin.world.elasticity.compliance import Compliance
    from twin.world.elasticity.rigid_beads import StiffBeads
    from twin.world.picture.ccd import Pattern
    from twin.world.picture.cover import CoverMotion
    from twin.world.picture.ellipsoids import Ellipsoids
    from twin.world.picture.render import Renderer
    from twin.world.picture.splat import Outlines

SATURATED = 0.01
"""Share of saturated pixels above which a picture causes a warning."""

ABOVE = 1.1
"""Estimated error over the requested one above which a warning is given."""

PRESSED = 0.01
"""Relative error of a press's force or indentation up to which the scene's patches and increments
are taken as good enough, whatever it requests of displacements. Shipped scenes: at most 0.006 where
less than 0.01 is requested."""

TRACTION = 0.7
"""The same of tractions, over their root mean square: under sharp edges, where they grow without
bound, shipped scenes state up to 0.73, under spheres 0.04."""

FAINT = 0.1
"""Largest displacement of points, over that of the surface under the load, below which their errors
are large because they move little: far from the load, or next to a held face."""

AGAIN = 2.0
"""How much larger than in the last warning an error is that is warned of once more."""

_OF = {"displacements": " of the largest", "tractions": " of their root mean square"}
_SHARES = {"displacements": "markers", "tractions": "traction"}

_REST = 1 << 62
"""Number of an exposure above all those of presses."""

_AWAY = "move the load away from the edges of the sensing surface"


@dataclass(frozen=True, kw_only=True)
class _Actual:
    """One made sensor: scene with actual numbers, (n, 2) print errors, mm, markers, and their
    deviations."""

    scene: Scene
    jitter_mm: Chart
    markers: MarkerSet
    prints: MarkerSet.Prints | None = None


@dataclass(frozen=True, kw_only=True)
class Motion:
    """The motion of n markers under a load.

    Attributes
    ----------
    displacement_mm, gradient
        (n, 3) displacements of the centres, and (n, 3, 3) gradients du_i/dx_j there.
    error
        Estimated largest error of the displacements over the largest displacement: of the mesh.
    cover
        Motion of the cover, specks and probes that the camera sees; None where there are none.
    """

    displacement_mm: Points
    gradient: Floats
    error: float
    cover: CoverMotion | None = None

    def error_of(self, state: ContactState | None) -> float:
        """Return ``error``; after a press at finite strain that of all causes."""
        if state is None or state.load.strained is None or state.error is None:
            return self.error
        return state.error.markers


def _make(nominal: Scene) -> _Actual:
    """Draw the actual sensor of ``nominal`` from its tolerances and seed."""
    tolerance = nominal.tolerance
    count = sum(layer.columns * layer.rows for layer in nominal.markers.values())
    if tolerance.preset == "none":
        markers = MarkerSet.place(nominal.body, nominal.markers)
        return _Actual(scene=nominal, jitter_mm=frozen(np.zeros((count, 2))), markers=markers)
    # The order of the draws is fixed: another order would change every stored result.
    rng = Purpose.TOLERANCE.stream(nominal.seed)

    def deviation() -> float:
        return float(np.clip(rng.standard_normal(), -CUT, CUT))

    # The material; a cover with a modulus of its own keeps its ratio to the body.
    stiffer = 1 + tolerance.youngs_modulus_pct / 100 * deviation()
    shortfall = tolerance.poisson_ratio * abs(deviation())
    material = nominal.material.model_copy(
        update={
            "youngs_modulus_mpa": nominal.material.youngs_modulus_mpa * stiffer,
            "poisson_ratio": max(-0.5, nominal.material.poisson_ratio - shortfall),
        }
    )
    cover = nominal.cover
    if cover is not None and cover.youngs_modulus_mpa is not None:
        ratio = material.youngs_modulus_mpa / nominal.material.youngs_modulus_mpa
        cover = cover.model_copy(update={"youngs_modulus_mpa": cover.youngs_modulus_mpa * ratio})
    # The depths of the marker layers.
    layers = {
        name: layer.model_copy(
            update={"depth_mm": layer.depth_mm + tolerance.depth_mm * deviation()}
        )
        for name, layer in nominal.markers.items()
    }
    # Place, tilt, focal length and distortion of the camera.
    camera = nominal.camera
    if camera is not None:
        camera = camera.deviating(
            nominal.body.base_z_mm,
            [tolerance.pupil_mm * deviation() for _ in range(3)],
            [tolerance.tilt_deg * deviation() for _ in range(3)],
            tolerance.focal_pct / 100 * deviation(),
            tolerance.distortion * deviation() if tolerance.distortion else 0.0,
        )
    changes = {"material": material, "cover": cover, "markers": layers, "camera": camera}
    made = nominal.model_copy(update=changes)
    if tolerance.thickness_mm:
        made = made.thicker(tolerance.thickness_mm * deviation())
    # The print of single markers has a stream of its own.
    noise = Purpose.PRINT.stream(nominal.seed).standard_normal((count, 2))
    jitter = tolerance.print_mm * np.clip(noise, -CUT, CUT)
    try:
        markers = MarkerSet.place(made.body, layers, jitter)
    except RecipeError as problem:
        MarkerSet.place(nominal.body, nominal.markers)  # where the drawing itself is wrong
        text = f"{problem}; as drawn they fit: or reduce tolerance.depth_mm or print_mm"
        raise RecipeError(text) from None
    return _Actual(
        scene=made, jitter_mm=frozen(jitter), markers=markers, prints=_prints(nominal, count)
    )


def _prints(nominal: Scene, count: int) -> MarkerSet.Prints | None:
    """Draw sizes, shades, losses, shapes and colours of the markers, from a stream of their own."""
    room = nominal.tolerance
    sizes = room.print_diameter_pct or room.print_oval_pct
    colours = room.print_shade_pct or room.print_colour_pct
    if not (sizes or colours or room.missing):
        return None
    rng = Purpose.PRINT.stream(nominal.seed, 1)

    def factors(pct: float, *channels: int) -> Floats:
        return frozen(1 + pct / 100 * np.clip(rng.standard_normal((count, *channels)), -CUT, CUT))

    return MarkerSet.Prints(
        size=factors(room.print_diameter_pct),
        shade=factors(room.print_shade_pct),
        missing=frozen(rng.random(count) < room.missing),
        longer=factors(room.print_oval_pct),
        way_rad=frozen(np.pi * rng.random(count)),
        tint=factors(room.print_colour_pct, 3),
    )


class Sensor:
    """One sensor, made from a scene.

    Parameters
    ----------
    scene
        The nominal design, with tolerances, seed and accuracy.
    progress
        Called during longer work.

    Attributes
    ----------
    saturation
        Warning of the first picture with more than 1 % of saturated pixels; None without.

    Raises
    ------
    InputError
        It is no `Scene`.

    Examples
    --------
    >>> import twin
    >>> sensor = twin.Sensor(twin.load_scene("block_bare"))
    >>> load = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
    >>> u = sensor.displacement([[0, 0, 3.0]], load)  # mm
    >>> bool(u[0, 2] > 0)  # a push moves material inwards
    True
    >>> ball = twin.Sphere(diameter_mm=6)
    >>> state = sensor.press(twin.Press(probe=ball, force_n=(0, 0, 1)))
    >>> round(state.contact_radius_mm, 1)
    1.4
    """

    def __init__(self, scene: Scene, progress: Progress | None = None) -> None:
        require(scene, Scene, "the scene", "load one with twin.load_scene")
        self.nominal = scene
        self.progress = progress
        self.saturation: str | None = None
        self._warned: dict[str, float] = {}
        self._cut: tuple[Load, Rectangles] | None = None

    def __repr__(self) -> str:
        return f"Sensor({self.nominal!r})"

    def _repr_html_(self) -> str:
        return self.nominal._repr_html_()

    @cached_property
    def actual(self) -> _Actual:
        """The sensor as it was made."""
        return _make(self.nominal)

    @cached_property
    def ladder(self) -> Ladder:
        """The actual body on as many levels of mesh as the requested accuracy takes."""
        from twin.world.elasticity.coated import Ladder

        actual = self.actual.scene
        return Ladder(
            actual.body,
            actual.material,
            actual.displacement_error,
            covered=_covered(actual, "coarse", self.progress),
            surface_table=actual.accuracy.surface_table,
            progress=self.progress,
        )

    @property
    def relaxation(self) -> Relaxation | None:
        """The relaxation of the rubber; None of elastic rubber."""
        if not (terms := self.actual.scene.material.relaxation):
            return None
        share, time_s = np.array([(term.share, term.time_s) for term in terms]).T
        return Relaxation(share, time_s)

    @property
    def compliance(self) -> Compliance | CoveredCompliance:
        """Compliance of the actual body, on the level that the requested accuracy takes."""
        return self.ladder.base

    @cached_property
    def nominal_compliance(self) -> Compliance | CoveredCompliance:
        """Compliance of the nominal body, on its own mesh: the sensor's software may use it."""
        from twin.world.elasticity.compliance import Compliance

        nominal, progress = self.nominal, self.progress
        return _covered(nominal, "nominal", progress) or Compliance(
            nominal.body, nominal.material, level="nominal", progress=progress
        )

    @cached_property
    def nominal_markers(self) -> MarkerSet:
        """The markers as drawn."""
        return MarkerSet.place(self.nominal.body, self.nominal.markers)

    @cached_property
    def renderers(self) -> list[Renderer]:
        """The camera's view of the actual sensor in the light of each group of LEDs
        (`Light.lit`), of one exposure: that of the group which makes a marker brightest."""
        if self.nominal.camera is None:
            raise RecipeError("this scene has no [camera] table, so there is no picture of it")
        from twin.world.picture.backend import Variant
        from twin.world.picture.render import Renderer

        scene = self.actual.scene
        Variant.check_machine(scene)
        rest = self.ellipsoids(None)
        views = [
            Renderer(scene.model_copy(update={"light": light}), rest)
            for light in scene.imaging[1].groups
        ]
        exposure = min(view.exposure for view in views)
        return [view.of_exposure(exposure) for view in views]

    @property
    def renderer(self) -> Renderer:
        """The first of `renderers`."""
        return self.renderers[0]

    def renderer_of(self, frame: int) -> Renderer:
        """Return the one of `renderers` whose LEDs are lit in a frame of a sequence."""
        return self.renderers[frame % len(self.renderers)]

    def rectangles(self, load: Load | ContactState) -> Rectangles:
        """Cut a load into the rectangles that the solvers work on; the last load's are kept."""
        load = _load_of(load)
        if self._cut is None or self._cut[0] is not load:
            from twin.world.elasticity.discretise import tile

            self._cut = load, tile(load, self.actual.scene.body)
        return self._cut[1]

    @one_blas_thread()
    def displacement(self, points_mm: Points, load: Load | ContactState) -> Points:
        """Return the (n, 3) displacement, mm, of (n, 3) points ``points_mm`` inside the body.

        Parameters
        ----------
        load
            A load, or the state of a press, whose forces are applied. The state may be that of
            another sensor, if its forces lie on this one's sensing surface.

        Raises
        ------
        InputError
            A point lies outside the body, or the load misses the sensing surface.
        """
        points = _as_points(points_mm)
        load = _load_of(load)
        moved, _, _ = self._displaced(points, self.rectangles(load.moving))
        more = self._strained(load)
        return moved + (more.displacement(points) if more is not None else 0.0)

    def _strained(self, load: Load) -> Load.Strained | None:
        """Return what to add to the linear answer, None by linear theory; refuse loads but one
        press."""
        if self.nominal.material.law == "linear" or not load.terms:
            return None
        if load.strained is None:
            self.check_law(None)
        return load.strained

    def check_law(self, press: Press | None) -> None:
        """Raise RecipeError or InputError where `Material.law` can't solve a press, or, with None,
        other loads."""
        scene = self.actual.scene
        law = scene.material.law
        if law == "linear":
            return
        from twin.world.contact.body_strain import BodyStrain

        if press is None:
            problem = (
                "only one press at a time is solved at finite strain, no load of given tractions "
                "or of several presses; press a probe"
            )
        elif problem := self._linear_only():
            problem += " is linear theory only; leave it out"
        if problem:
            raise RecipeError(f"material.law = {law}: {problem}, or set material.law = linear")
        assert press is not None
        BodyStrain.check(press, scene.body, scene.material)

    @one_blas_thread()
    def motion(self, load: Load) -> Motion:
        """Return the motion of the actual markers under a load."""
        rectangles = self.rectangles(load.moving)
        points = self.actual.markers.points
        moved, error, compliance = self._displaced(points, rectangles)
        passive = Motion(
            displacement_mm=moved,
            gradient=compliance.gradient(points, rectangles),
            error=error,
            cover=self._scenery(load, compliance, rectangles),
        )
        return self._completed(passive, load, lambda p: compliance.displacement(p, rectangles))

    def _scenery(
        self, load: Load, compliance: Compliance | CoveredCompliance, rectangles: Rectangles
    ) -> CoverMotion | None:
        """Return the motion of what pictures show besides markers."""
        from twin.world.picture.cover import Background

        scene = self.nominal
        if scene.camera is None or not (Background.moves(scene) or load.probes):
            return None

        def moved(points: Points) -> tuple[Points, Floats]:
            displacement = compliance.displacement(points, rectangles)
            gradient = compliance.gradient(points, rectangles)
            if (more := self._strained(load)) is None:
                return displacement, gradient
            return displacement + more.displacement(points), gradient + more.gradient(points)

        return self.renderer.scenery(moved, load.probes)

    @one_blas_thread()
    def quick_motion(self, load: Load, *, pictured: bool = True, gather: bool = True) -> Motion:
        """Return the motion of the actual markers, on the first level of mesh only, for many loads.

        With ``gather``, patches far above all markers are gathered into a few point forces
        (`twin.world.elasticity.discretise`), those of every contact by themselves. Only where
        ``pictured`` are gradients computed, where markers strain, and the motion of a cover that
        deforms; without gradients beads are not turned, which no picture shows.
        """
        from twin.world.elasticity.discretise import gathered

        points = self.actual.markers.points
        moving = load.moving
        patches = [self.rectangles(Load((term,))) for term in moving.terms]
        patches = patches or [self.rectangles(moving)]
        whole = Rectangles.joined(patches)
        few = Rectangles.joined([gathered(points, group) for group in patches]) if gather else whole
        moved, error = self.compliance.answer(points, few)
        gradient = np.zeros((len(points), 3, 3))
        if (pictured and self.markers_strain) or self.stiff_beads is not None:
            gradient = self.compliance.gradient(points, whole)
        cover = self._scenery(load, self.compliance, whole) if pictured else None
        passive = Motion(displacement_mm=moved, gradient=gradient, error=error, cover=cover)
        return self._completed(
            passive, load, lambda p: self.compliance.displacement(p, gathered(p, whole))
        )

    def keep_markers(self) -> None:
        """Prepare for many loads that move the markers: products are made at once, not after so
        many loads."""
        from twin.world.elasticity.compliance import Compliance

        if isinstance(self.compliance, Compliance):
            self.compliance.keep(self.actual.markers.points)

    @cached_property
    def stiff_beads(self) -> StiffBeads | None:
        """The actual rigid beads and their interaction; None where no layer is ``stiff``."""
        if not any(layer.stiff for layer in self.actual.scene.markers.values()):
            return None
        from twin.world.elasticity.rigid_beads import StiffBeads

        return StiffBeads.of(self.actual.markers, self.actual.scene.markers)

    def _completed(self, passive: Motion, load: Load, field: Callable[[Points], Points]) -> Motion:
        """Add what linear theory leaves out, and the interaction of rigid beads in the rubber's
        ``field``."""
        if (more := self._strained(load)) is not None:
            points = self.actual.markers.points
            passive = replace(
                passive,
                displacement_mm=passive.displacement_mm + more.displacement(points),
                gradient=passive.gradient + more.gradient(points),
            )
        beads = self.stiff_beads
        if beads is None or not passive.displacement_mm.any():
            return passive
        change = beads.change(field, passive.gradient)
        return replace(
            passive,
            displacement_mm=passive.displacement_mm + change,
            error=passive.error + beads.error(change, passive.displacement_mm),
        )

    @cached_property
    def markers_strain(self) -> bool:
        """Whether a layer strains with the body, is stiff, or has a texture, so that pictures need
        gradients."""
        layers = self.actual.scene.markers.values()
        return any(each.kind == "print" or each.stiff or each.texture for each in layers)

    def _displaced(
        self, points: Points, rectangles: Rectangles
    ) -> tuple[Points, float, Compliance | CoveredCompliance]:
        """Return the displacement of ``points`` (n, 3), mm, its error and the compliance that it is
        from, and warn where it is less accurate than requested."""
        found = self.ladder.displacement(points, rectangles)
        if found.error > ABOVE * self.nominal.displacement_error:
            most = np.argmax(np.linalg.norm(rectangles.force_n, axis=1))
            under = found.compliance.displacement(rectangles.centre_mm[most][None], rectangles)
            share = np.linalg.norm(found.displacement_mm, axis=1).max() / np.linalg.norm(under)
            remedy = _AWAY
            if share < FAINT:
                remedy = (
                    f"these points move at most {share:.1g} of what the surface under the load "
                    "does: add points nearer to it"
                )
            self._warn({"displacements": found.error}, f"{remedy}, or allow more")
        return found.displacement_mm, found.error, found.compliance

    def _warn(self, errors: dict[str, float], remedy: str) -> None:
        """Warn of errors, once per sensor and quantity, and again where one is much larger."""
        new = {k: v for k, v in errors.items() if v > AGAIN * self._warned.get(k, 0.0)}
        if not new:
            return
        self._warned |= new
        each = ", ".join(f"{k} {v:.2g}{_OF.get(k, '')}" for k, v in new.items()).replace(
            " inf", " unknown"
        )
        AccuracyWarning.issue(
            f"accuracy.displacement = {self.nominal.displacement_error:g} is asked, but the "
            f"estimated errors are larger: {each}; {remedy}"
        )

    def _may_be_inaccurate(self, load: Load) -> bool:
        """Return whether the body's expected error, before a solve for it, is above the request."""
        expected = getattr(self.compliance, "expected_error", None)
        if expected is None or not load.terms or self._warned:
            return False
        return bool(expected(self.rectangles(load)) > ABOVE * self.nominal.displacement_error)

    def _warn_if_press_inaccurate(self, error: PressError) -> None:
        """Warn of each number that misses its bound, with the largest cause: markers, and the
        body's share of force and indentation, by the scene's request, the whole by `PRESSED` at
        least, tractions by `TRACTION`."""
        asked = self.nominal.displacement_error
        bounds = {"displacements": asked, "tractions": TRACTION}
        for what in ("force", "indentation"):
            body_fails = getattr(error.body, what) > ABOVE * asked
            bounds[what] = asked if body_fails else max(asked, PRESSED)
        remedies = self._remedies()
        by_cause: dict[str, dict[str, float]] = {}
        for what, bound in bounds.items():
            name = _SHARES.get(what, what)
            shares = {cause: getattr(getattr(error, cause), name) for cause in remedies}
            if (got := getattr(error, name)) > ABOVE * bound:
                by_cause.setdefault(max(shares, key=lambda one: shares[one]), {})[what] = got
        for cause, errors in by_cause.items():
            self._warn(errors, f"mostly by the {cause}: {remedies[cause]}, or allow more")

    def _remedies(self) -> dict[str, str]:
        """Return what lowers each share of a press's error."""
        patches = self.nominal.contact_patches
        increments = self.nominal.accuracy.contact_increments
        return {
            "body": _AWAY,
            "patches": f"raise accuracy.contact_patches ({patches})"
            if patches < MOST_PATCHES
            else "press deeper, or with a probe that has fewer small parts",
            "increments": f"raise accuracy.contact_increments ({increments})",
            "strain": "press with less force, as large strain is solved on a coarse mesh",
        }

    @one_blas_thread()
    def press(self, press: Press | None = None, memory: PathMemory | None = None) -> ContactState:
        """Solve a press; the scene's own if none is given.

        Parameters
        ----------
        press
            The press.
        memory
            Of the presses before, where this one may go on from the last of them.

        Returns
        -------
        The last state that converged; if that is not the end of the path, ``complete`` is false.
        Its ``error``, computed at first use, is the estimated error of its numbers; an
        `AccuracyWarning` is given where that is above the request.

        Raises
        ------
        ContactError
            There is no equilibrium, or the contact leaves the sensing surface.
        """
        from twin.world.contact.contact_state import ContactState
        from twin.world.contact.press_error import Estimates
        from twin.world.contact.pressing import press as solve

        # Check the request.
        wanted = press if press is not None else self.nominal.press
        if wanted is None:
            raise RecipeError("this scene has no [press] table: give Sensor.press a Press")
        require(
            wanted,
            Press,
            "the press",
            "make one with twin.Press; loads go to Sensor.displacement and .picture",
        )
        actual = self.actual
        points = actual.markers.points
        self.check_law(wanted)

        def linear(one: Press, memory: PathMemory | None = None) -> ContactState:
            return solve(
                one,
                actual.scene.body,
                self.compliance,
                patches_across=self.nominal.contact_patches,
                youngs_modulus_mpa=actual.scene.material.youngs_modulus_mpa,
                poisson_ratio=actual.scene.material.poisson_ratio,
                increments=self.nominal.accuracy.contact_increments,
                watched=Estimates.Watched(
                    points=points,
                    error=lambda load: (
                        self.ladder.displacement(points, self.rectangles(load.moving)).error
                    ),
                    judge=self._warn_if_press_inaccurate,
                ),
                relaxation=self.relaxation,
                memory=memory,
            )

        def corrected(state: ContactState) -> ContactState:
            if actual.scene.material.law == "linear":
                return state
            from twin.world.contact.finite_strain import at_finite_strain

            return at_finite_strain(
                wanted,
                actual.scene.body,
                actual.scene.material,
                state,
                points,
                self._warn_if_press_inaccurate,
                linear,
                memory,
            )

        # Solve the contact by linear theory, then correct it for finite strain.
        try:
            state = linear(wanted, memory)
        except ContactError as problem:
            if isinstance(problem.last_state, ContactState):
                problem.last_state = corrected(problem.last_state)
            raise
        state = corrected(state)
        if self._may_be_inaccurate(state.load):
            state.error  # noqa: B018  warns if it is
        return state

    @one_blas_thread()
    def validity(self, state: ContactState, press: Press | None = None) -> Validity:
        """Return how far a press strains linear theory, its cost measured where that can be done.

        ``state`` is that of ``press``, by default of the scene's own. By another law than the
        linear one the state's own validity is returned.
        """
        from twin.world.contact.contact_state import ESTIMATED
        from twin.world.contact.finite_strain import measured_linearity

        pressed = press if press is not None else self.nominal.press
        actual = self.actual
        if pressed is None or actual.scene.material.law != "linear":
            return state.validity
        if problem := self._linear_only():
            basis = f"{ESTIMATED}: {problem} is linear theory only"
            return replace(state.validity, linearisation_basis=basis)
        return measured_linearity(
            pressed, actual.scene.body, actual.scene.material, state, actual.markers.points
        )

    @one_blas_thread()
    def picture(
        self,
        load: Load | ContactState | Motion | None,
        exposure: int | None = None,
        frame: int = 0,
    ) -> Picture:
        """Return the CCD picture (height, width, 3) under a load, or at rest.

        Parameters
        ----------
        load
            A load, the state of a press, a motion computed before, or None for the rest state.
        exposure
            Number of the exposure: pictures of the same number have the same noise. Default: 0 at
            rest, 1 under load.
        frame
            Number of the frame in a sequence, from 0: where LEDs take turns (`Light.lit`), it says
            which shine.

        Raises
        ------
        RecipeError
            The scene has no camera.
        InputError
            ``load`` or ``exposure`` is of another kind.

        Warns
        -----
        AccuracyWarning
            More than 1 % of the pixels are saturated; once per sensor.
        """
        number = exposure if exposure is not None else int(load is not None)
        if not isinstance(number, int | np.integer) or number < 0:
            raise InputError(f"exposure = {number!r}: allowed are whole numbers from 0")
        motion = self._moved(load)
        cover = motion.cover if motion is not None else None
        light = self.renderer_of(frame).radiance(self.ellipsoids(motion), cover)
        return self.exposed(light, number)

    def rest_picture(self, group: int) -> Picture:
        """Return the rest picture in the light of a group of LEDs, with noise of its own; that of
        group 0 is ``picture(None)``."""
        return self.picture(None, _REST * (group > 0) + group, group)

    @property
    def rest_pictures(self) -> list[Picture]:
        """The rest picture of each group of LEDs."""
        return [self.rest_picture(group) for group in range(len(self.renderers))]

    def seen(
        self, motion: Motion | None, exposure: int, frame: int = 0
    ) -> tuple[Picture, Outlines]:
        """Return `picture` and the markers' visible outlines, for little more than the picture's
        time."""
        cover = motion.cover if motion is not None else None
        radiance, outlines = self.renderer_of(frame).seen(self.ellipsoids(motion), cover)
        return self.exposed(radiance, exposure), outlines

    def exposed(self, radiance: Singles, exposure: int, before: Singles | None = None) -> Picture:
        """Return the CCD picture of light on the sensor; ``before`` is that of the field before."""
        from twin.world.picture.ccd import expose

        noise = Purpose.EXPOSURE.stream(self.nominal.seed, exposure)
        picture = expose(radiance, self.nominal.ccd, noise, self.pattern, before)
        full = picture == np.iinfo(picture.dtype).max
        share = float((full[:, :, 0] | full[:, :, 1] | full[:, :, 2]).mean())
        if share > SATURATED and self.saturation is None:
            self.saturation = (
                f"{100 * share:.2g} % of the pixels are saturated, where markers are lost or "
                f"moved: lower ccd.exposure ({self.nominal.ccd.exposure:g}) or ccd.white_dn "
                f"({self.nominal.ccd.white_dn:g})"
            )
            AccuracyWarning.issue(self.saturation)
        return picture

    @cached_property
    def pattern(self) -> Pattern | None:
        """The fixed pattern of the CCD's pixels; None for an even CCD."""
        from twin.world.picture.ccd import Pattern

        camera = self.nominal.camera
        if camera is None:
            return None
        own = Purpose.SENSOR_PATTERN.stream(self.nominal.seed)
        return Pattern.drawn(self.nominal.ccd, (camera.height_px, camera.width_px), own)

    def _linear_only(self) -> str:
        """Return what needs a linear body: covers or beads; empty if nothing does."""
        cover = self.nominal.cover
        if self.nominal.material.relaxation:
            return "material.relaxation"
        if self.stiff_beads is not None:
            return "markers with stiff = true"
        if cover is not None and cover.has_own_material:
            return "a cover with a modulus of its own"
        return ""

    def _moved(self, load: Load | ContactState | Motion | None) -> Motion | None:
        return load if load is None or isinstance(load, Motion) else self.motion(_load_of(load))

    def ellipsoids(self, load: Load | ContactState | Motion | None) -> Ellipsoids:
        """Return the actual markers' shapes under a load."""
        from twin.world.picture.ellipsoids import Ellipsoids

        motion = self._moved(load)
        return Ellipsoids.of(
            self.actual.markers,
            self.actual.scene.markers,
            motion.displacement_mm if motion is not None else None,
            motion.gradient if motion is not None else None,
            self.actual.prints,
            self.nominal.seed,
        )

    def project(self, points_mm: Points, which: Literal["actual", "nominal"] = "actual") -> Pixels:
        """Return the (n, 2) pixels of (n, 3) points, mm, in the actual or the nominal camera.

        A scene without a camera has no pixels: the result is (0, 2).

        Raises
        ------
        InputError
            ``which`` is neither "actual" nor "nominal".
        """
        if which not in ("actual", "nominal"):
            raise InputError(f"which = {which!r:.60}: allowed are 'actual' and 'nominal'")
        scene = self.actual.scene if which == "actual" else self.nominal
        if scene.camera is None:
            return np.zeros((0, 2))
        points = _as_points(points_mm)
        return project(points, *scene.optics)

    @cached_property
    def layout_px(self) -> dict[str, Pixels]:
        """Nominal rest places of the markers by layer, px: input of the tracker."""
        pixels = self.project(self.nominal_markers.points, "nominal")
        return {name: pixels[self.nominal_markers.of(name)] for name in self.nominal.markers}

    @cached_property
    def sites(self) -> Rectangles:
        """The sites where forces are reconstructed, as squares of the sites' pitch."""
        if self.nominal.reconstruction is None:
            raise RecipeError("this scene has no [reconstruction] table, so there are no sites")
        grid = self.nominal.reconstruction.sites
        return Rectangles.on_surface(
            self.nominal.body, grid.chart(), grid.pitch_mm / 2, "reconstruction.sites"
        )


def _load_of(load: Load | ContactState) -> Load:
    """Return the load in the state of a press; a load stays itself, all else is an `InputError`."""
    found: Load = getattr(load, "load", load)  # type: ignore[arg-type]
    require(
        found,
        Load,
        "the load",
        "make one with twin.Traction, or give the state that sensor.press returns",
    )
    return found


def _covered(
    scene: Scene, level: Literal["coarse", "nominal"], progress: Progress | None
) -> CoveredCompliance | None:
    """Return the compliance of a body whose cover is of another material; None without one."""
    cover = scene.cover
    if cover is None or not cover.has_own_material:
        return None
    from twin.world.elasticity.coated import CoveredCompliance
    from twin.world.elasticity.fem import TaylorHood

    layer = TaylorHood.Layer.of_cover(scene.material, cover)
    if layer is None:
        return None
    return CoveredCompliance(
        scene.body, scene.material, cover.thickness_mm, layer, level=level, progress=progress
    )


def _as_points(points_mm: object) -> Points:
    try:
        points = np.asarray(points_mm, np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"points_mm: must be numbers of shape (n, 3), got {points_mm!r:.60}"
        ) from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points_mm: must have shape (n, 3), got {points.shape}")
    return points
