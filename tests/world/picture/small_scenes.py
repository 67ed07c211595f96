"""Small scenes for the tests of pictures, and what is seen of them."""

import tomllib

import numpy as np
import pytest
from standard_bodies import REFERENCE

from twin.parts.markers import MarkerSet
from twin.parts.press import Cylinder
from twin.parts.scene import Scene
from twin.theory.optics import project
from twin.world.contact.probe_gap import Approach, PlacedProbe
from twin.world.picture.backend import Variant
from twin.world.picture.ellipsoids import Ellipsoids

SPLAT = Variant(name="splat", library=None, reason="runs everywhere")
RED = (0.9, 0.1, 0.1)


def scene_of(name, **keys):
    recipe = tomllib.loads((REFERENCE / f"small_{name}.toml").read_text())
    return Scene.model_validate({**recipe, **keys})


def block(**keys):
    return scene_of("block", **keys)


def finger(**keys):
    return scene_of("finger", **keys)


def rest_of(scene):
    return Ellipsoids.of(MarkerSet.place(scene.body, scene.markers), scene.markers)


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
    variant = Variant.choose()
    if variant.name == "splat":
        pytest.skip(variant.reason)
    return variant


def changed(scene, **tables):
    """Return a scene with keys of its tables changed."""
    made = {name: getattr(scene, name).model_copy(update=keys) for name, keys in tables.items()}
    return scene.model_copy(update=made)


def measured(picture, places, channels=0, half=9):
    """Return (n, 2) centroids and (n,) sums about places, each in a channel of the picture."""
    steps = np.arange(-half, half + 1)
    centroids, light = [], []
    for (column, row), channel in zip(np.rint(places).astype(int), np.broadcast_to(channels, len(places)), strict=True):
        part = picture[row - half : row + half + 1, column - half : column + half + 1, channel].astype(float)
        centroids.append([part.sum(axis=0) @ steps, part.sum(axis=1) @ steps] / part.sum() + (column, row))
        light.append(part.sum())
    return np.array(centroids), np.array(light)


def faced(z_mm, diameter_mm=2.0, albedo=(0.4, 0.2, 0.1)):
    """Return a cylinder whose face is at a height in the body, or before it (z < 0)."""
    first = Approach(probe=Cylinder(diameter_mm=diameter_mm), axis_mm=np.zeros(3), touch_mm=np.zeros(3), axes=np.eye(3))
    return PlacedProbe(first=first, pose=np.array([0.1, 0.05, z_mm, 0, 0, 0]), albedo=albedo)
