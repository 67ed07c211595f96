"""What several commands share: a scene with overrides, and progress on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, Token

from twin.progress import Progress

if TYPE_CHECKING:
    from twin.parts.scene import Scene


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number; the command line's library would round others without a word."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"'{tokens[0].value}' is no whole number") from None


Whole = Annotated[int, Parameter(converter=_whole)]
SceneName = Annotated[str, Parameter(help="Path of a scene file, or the name of a shipped scene (see: twin scenes).")]
Overrides = Annotated[
    tuple[str, ...],
    Parameter(
        name=["-s", "--set"],
        help="Override any scene key: -s material.poisson_ratio=0.49",
        show_default=False,
        negative_iterable="",
    ),
]


def load(scene: str, overrides: Sequence[str]) -> Scene:
    """Return a scene with ``key.path=value`` overrides."""
    from twin.study.recipe import load_scene
    from twin.study.recipe_tables import parse_override

    return load_scene(scene, dict(parse_override(text) for text in overrides))


def progress() -> Progress | None:
    """Return a progress bar on stderr; None where that is not a terminal."""
    from twin.show.progress import progress_on_terminal

    return progress_on_terminal()
