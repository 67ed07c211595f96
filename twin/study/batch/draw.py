"""Values drawn for a sample from (root seed, number) alone, and scenes with drawn values in place.

Random sampling takes the numbers u from a stream of the sample's own. Stratified sampling takes
them from one scrambled Sobol' sequence (`scipy.stats.qmc`), whose point number i depends on nothing
but the seed and i: so a dataset is the beginning of every larger one, and any worker can draw any
sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, Literal

from twin.errors import RecipeError, did_you_mean
from twin.parts.scene import Scene
from twin.parts.vary import Distribution, Follows
from twin.study.recipe import ALTERNATIVES, PROVENANCE, validate_scene

Sampling = Literal["stratified", "random"]
Table = dict[str, Any]

_HOLDERS = (*PROVENANCE, "vary", "dataset")


def with_values(
    scene: Scene, values: Mapping[str, Any], follows: Mapping[str, Distribution] | None = None
) -> Scene:
    """Return the scene with other values at dotted keys, in which numbers are places in a list
    (``press.steps.1.force_n``); of ``follows`` only axes that follow others count. `RecipeError`
    where a key is not there or a value not allowed."""
    table = SceneTable.of(scene)
    table.put(values, follows)
    made = validate_scene(table, "drawn scene")
    return made.model_copy(update={"vary": scene.vary, "dataset": scene.dataset})


class SceneTable(dict[str, Any]):
    """A table of plain values with dotted keys, such as ``press.steps.1.force_n``."""

    @staticmethod
    def of(scene: Scene) -> SceneTable:
        """Return a scene's values, without provenance and without what varies."""
        values = scene.model_dump(mode="python", exclude=set(_HOLDERS), exclude_none=True)
        return SceneTable(_bare(values))

    def put(
        self, values: Mapping[str, Any], follows: Mapping[str, Distribution] | None = None
    ) -> None:
        """Put values at dotted keys, then those that follow others.

        A path given to a press replaces the one it had.
        """
        for key, value in values.items():
            self._put(key, value)
        for key, axis in (follows or {}).items():
            if isinstance(axis, Follows):
                value_of = self.look_up(axis.follows)
                if isinstance(value_of, bool) or not isinstance(value_of, int | float):
                    raise RecipeError(
                        f"vary.{key}: follows '{axis.follows}', which is not a number but "
                        f"{value_of!r}"
                    )
                self._put(key, axis.times * value_of + axis.plus)

    def _put(self, dotted: str, value: Any) -> None:
        *parents, last = dotted.split(".")
        here: Any = self
        for name in parents:
            here = _step(here, name, dotted)
        if isinstance(here, dict):
            if parents == ["press"] and last in ALTERNATIVES:
                for other in ALTERNATIVES:
                    here.pop(other, None)
            here[last] = deepcopy(value)
        else:
            here[_place(here, last, dotted)] = deepcopy(value)

    def look_up(self, dotted: str) -> Any:
        """Return the value at a dotted key, or raise `RecipeError`."""
        here: Any = self
        for name in dotted.split("."):
            here = _step(here, name, dotted)
        return here


def _step(here: Any, name: str, dotted: str) -> Any:
    if isinstance(here, dict) and name in here:
        return here[name]
    if isinstance(here, list):
        return here[_place(here, name, dotted)]
    hint = "that is a single value"
    if isinstance(here, dict):
        hint = did_you_mean(name, here, f"known there are {', '.join(here)}")
    raise RecipeError(f"vary.{dotted}: the scene has no '{name}'; {hint}")


def _place(here: Any, name: str, dotted: str) -> int:
    if not isinstance(here, list) or not name.isdigit() or int(name) >= len(here):
        count = len(here) if isinstance(here, list) else 0
        raise RecipeError(
            f"vary.{dotted}: '{name}' is no place in a list of {count} (the first is 0)"
        )
    return int(name)


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if k not in PROVENANCE}
    if isinstance(value, tuple | list):
        return [_bare(v) for v in value]
    return value
