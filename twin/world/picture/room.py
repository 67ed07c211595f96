"""Room for a picture: its memory is estimated before any is taken.

A scene may ask for 8192 x 8192 pixels, which take 9 GB, and four times as much through a wide pupil. A process that
asks for more than there is isn't told so: the system ends it without a word.

Validity: measured on pictures of 9 and 17 million pixels with tracking, 127 to 144 bytes a pixel through a point, 577
through a pupil. A calibration by pictures takes as much again, and asks again.
"""

from __future__ import annotations

import os
from pathlib import Path

from twin.errors import MissingCapability
from twin.parts.scene import Scene
from twin.world.picture.defocus import PUPIL_WEIGHTS

RAYS_BYTES = 63
"""Of a pixel's rays, light and shares, which are kept for every point of the pupil and for its middle."""

LIGHT_BYTES = 75
"""Of a pixel while it is traced, exposed and tracked."""

LEFT = Path("/proc/meminfo"), Path("/sys/fs/cgroup/memory.max")
"""Where Linux tells what is left, and the most that a container may take."""


def needed_bytes(scene: Scene) -> int:
    """Return about how much memory a picture of the scene takes; 0 without a camera."""
    camera = scene.camera
    if camera is None:
        return 0
    views = 1 if camera.aperture_mm == 0 else 1 + len(PUPIL_WEIGHTS)
    return camera.width_px * camera.height_px * (LIGHT_BYTES + views * RAYS_BYTES)


def free_bytes() -> int | None:
    """Return how much memory this process may still take; None where the system doesn't tell."""
    told = []
    for file in LEFT:
        try:
            words = file.read_text().split()
        except OSError:
            continue
        if "MemAvailable:" in words:
            told.append(1024 * int(words[words.index("MemAvailable:") + 1]))
        elif words and words[0].isdigit():
            told.append(int(words[0]))
    if not told and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        told.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(told, default=None)


def require_room(scene: Scene, at_once: int = 1) -> None:
    """Refuse pictures that this machine has no room for, ``at_once`` being made beside each other.

    Raises
    ------
    MissingCapability
        With the size and what makes it smaller.
    """
    needed, free = at_once * needed_bytes(scene), free_bytes()
    if free is None or needed <= free:
        return
    camera = scene.camera
    assert camera is not None
    others = ", camera.aperture_mm = 0 (a quarter of it)" * (camera.aperture_mm > 0) + ", fewer --workers" * (
        at_once > 1
    )
    raise MissingCapability(
        f"camera.width_px = {camera.width_px}, camera.height_px = {camera.height_px}: "
        f"{f'{at_once} pictures at once take' if at_once > 1 else 'a picture takes'} about {needed / 1e9:,.1f} GB of "
        f"memory, of which {free / 1e9:,.1f} GB are free here: take fewer pixels{others}, or a machine with more memory"
    )
