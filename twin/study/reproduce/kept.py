"""A sensor that keeps its presses, and shares them with sensors that differ in camera or software alone.

Why: a cause is switched off by making the same sensor again with another CCD, lens or tracker. Its body is the same
one, and a press on it, which is most of the work on the finger, is the same press.
"""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from twin.parts.load import Load
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.study.motion import Motion
from twin.study.sensor import Sensor

if TYPE_CHECKING:
    from twin.world.contact.contact import ContactState

MECHANICAL = ("body", "material", "cover", "accuracy")
"""What of an actual scene decides how its body moves."""


@dataclass
class Mechanics:
    """A body and the presses solved on it."""

    ladder: Any = None
    presses: dict[str, ContactState] = field(default_factory=dict)
    motions: dict[tuple[str, int], tuple[Load, Motion]] = field(default_factory=dict)


class KeptSensor(Sensor):
    """A sensor whose presses and motions are kept in a store that equal bodies share."""

    def __init__(self, scene: Scene, store: dict[str, Mechanics], progress: Progress | None = None) -> None:
        super().__init__(scene, progress)
        self._store = store

    @cached_property
    def mechanics(self) -> Mechanics:
        """The store of this actual body."""
        actual = self.actual.scene
        key = "".join(repr(getattr(actual, name)) for name in MECHANICAL)
        return self._store.setdefault(hashlib.sha256(key.encode()).hexdigest(), Mechanics())

    @cached_property
    def ladder(self) -> Any:
        """The actual body's levels of mesh, one for all that share it."""
        if self.mechanics.ladder is None:
            self.mechanics.ladder = super().ladder
        return self.mechanics.ladder

    def press(self, press: Press | None = None, *, with_error: bool = False) -> ContactState:
        """Solve a press once."""
        assert press is not None
        kept, key = self.mechanics.presses, f"{with_error}{press.model_dump_json()}"
        if key not in kept:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                kept[key] = super().press(press, with_error=with_error)
        return kept[key]

    def motion(self, load: Load) -> Motion:
        """Return how the actual markers move under a load, computed once as long as the load is kept."""
        key = (hashlib.sha256(self.actual.markers.points.tobytes()).hexdigest(), id(load))
        kept = self.mechanics.motions
        if key not in kept:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                kept[key] = (load, super().motion(load))
        return kept[key][1]
