"""`twin check`: what is wrong with a file or a folder."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter


def check(
    file: Annotated[str, Parameter(help="Scene or sweep file, calibration (.npz), result folder or dataset.")],
) -> None:
    """Check a file or a folder and say everything that is wrong with it.

    Examples:
    twin check my_scene.toml
    twin check out/kamiyama_pillar
    """
    from twin.study.check import check_path

    for line in check_path(file):
        print(line)
