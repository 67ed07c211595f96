"""`twin scenes`: what is shipped."""

from __future__ import annotations


def scenes() -> None:
    """List the shipped scenes."""
    from twin.study.recipe import load_scene, shipped_scenes

    for name in shipped_scenes():
        print(f"{name:20s} {load_scene(name).title}")
