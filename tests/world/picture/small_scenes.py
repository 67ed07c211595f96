"""Small scenes for the tests of pictures, and what is seen of them."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from twin.parts.markers import place
from twin.parts.scene import Scene
from twin.theory.optics import project
from twin.world.picture.backend import Variant, choose_variant
from twin.world.picture.ellipsoids import Ellipsoids

SPLAT = Variant(name="splat", library=None, reason="runs everywhere")
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.15, 0.9)


RECIPES = Path(__file__).parents[2] / "reference"


def scene_of(name, **keys):
    recipe = tomllib.loads((RECIPES / f"small_{name}.toml").read_text())
    return Scene.model_validate({**recipe, **keys})


def block(**keys):
    return scene_of("block", **keys)


def finger(**keys):
    return scene_of("finger", **keys)


def rest_of(scene):
    return Ellipsoids.of(place(scene.body, scene.markers), scene.markers)


def seen_at(points, scene):
    return project(points, scene.camera, scene.material.refractive_index, scene.body.base_z_mm)


def beads(centres, radius_mm=0.25, colour=RED):
    n = len(centres)
    return Ellipsoids(
        centres=np.array(centres, float),
        axes=np.broadcast_to(radius_mm, n)[:, None, None] * np.eye(3),
        colour=np.broadcast_to(np.array(colour, float), (n, 3)).copy(),
    )


def mitsuba():
    variant = choose_variant()
    if variant.name == "splat":
        pytest.skip(variant.reason)
    return variant


def changed(scene, **tables):
    """Return a scene with keys of its tables changed."""
    made = {name: getattr(scene, name).model_copy(update=keys) for name, keys in tables.items()}
    return scene.model_copy(update=made)
