"""Show a body's meshes, or make them anew."""

from __future__ import annotations

from pathlib import Path

from twin.parts.scene import Scene
from twin.progress import Progress


def describe_meshes(
    scene: Scene, *, rebuild: bool, export: Path | None = None, progress: Progress | None = None
) -> list[str]:
    """Return a line for each of the body's meshes: size and worst quality; make them anew, or export, if asked."""
    from twin.world.mesh.body_mesh import body_mesh
    from twin.world.mesh.quality import quality
    from twin.world.mesh.sizing import Level

    lines = []
    levels: tuple[Level, ...] = ("standard", "nominal")  # what most scenes need; the others are made when asked for
    for level in levels:
        mesh = body_mesh(scene.body, level, rebuild=rebuild, progress=progress)
        if export is not None and level == "standard":
            from twin.world.mesh.export import export_mesh

            export_mesh(mesh, scene.body, export)
        worst = quality(mesh, scene.body)
        failures = worst.failures()
        told = (
            "; ".join(failures) or f"smallest dihedral angle {worst.least_dihedral_deg:.1f} deg, volume and surface ok"
        )
        lines.append(
            f"{level:8s} {len(mesh.tets)} tetrahedra, {len(mesh.points)} nodes, {mesh.unknowns} unknowns; {told}"
        )
    if progress is not None:
        progress("done", 1.0)
    return lines
