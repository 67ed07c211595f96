"""Who answers for a scene's body: the actual one to the asked accuracy, the nominal one on a mesh of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from twin.parts.scene import Scene
from twin.progress import Progress

if TYPE_CHECKING:
    from twin.world.elasticity.compliance import Compliance
    from twin.world.elasticity.covered import Covered
    from twin.world.elasticity.ladder import CoveredLadder, Ladder


def actual_ladder(actual: Scene, progress: Progress | None = None) -> Ladder | CoveredLadder:
    """Return a body on as many levels of mesh as the asked accuracy takes."""
    from twin.world.elasticity.ladder import CoveredLadder, Ladder

    if covered := _covered(actual, "coarse", progress):
        return CoveredLadder(covered)
    return Ladder(
        actual.body, actual.material, actual.displacement_error,
        surface_table=actual.accuracy.surface_table, progress=progress,
    )  # fmt: skip


def nominal_compliance(nominal: Scene, progress: Progress | None = None) -> Compliance | Covered:
    """Return the compliance that the sensor's software may be told: of the drawing, on a mesh of its own."""
    from twin.world.elasticity.compliance import Compliance

    if covered := _covered(nominal, "nominal", progress):
        return covered
    return Compliance(nominal.body, nominal.material, level="nominal", progress=progress)


def _covered(scene: Scene, level: Literal["coarse", "nominal"], progress: Progress | None) -> Covered | None:
    """Return the compliance of a body whose cover is of another material, None if there is no such cover."""
    if scene.cover is None or (scene.cover.youngs_modulus_mpa is None and scene.cover.poisson_ratio is None):
        return None
    from twin.world.elasticity.covered import Covered, own_layer

    layer = own_layer(scene.material, scene.cover)
    if layer is None:
        return None
    return Covered(scene.body, scene.material, scene.cover.thickness_mm, layer, level=level, progress=progress)
