"""`twin mesh`: the meshes of a scene's body."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Overrides, SceneName, load, progress


def mesh(
    scene: SceneName,
    *,
    rebuild: Annotated[bool, Parameter(help="Make the meshes anew, even if shipped or cached.", negative="")] = False,
    export: Annotated[Path | None, Parameter(help="Write the truth's mesh as .vtu for other programs.")] = None,
    set_: Overrides = (),
) -> None:
    """Show the meshes of a scene's body, or make them anew.

    Examples:
    twin mesh sato_press
    twin mesh sato_press --export finger.vtu
    """
    from twin.study.meshes import describe_meshes

    for line in describe_meshes(load(scene, set_), rebuild=rebuild, export=export, progress=progress()):
        print(line)
