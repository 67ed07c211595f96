"""Before the first sample: scene, meshes and facts, on which every worker and every later run
rests.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from twin.arrays import Progress
from twin.errors import InputError
from twin.files import file_digest, write_json, write_whole
from twin.parts.body import Block, Solid
from twin.parts.press import Stl
from twin.parts.scene import Scene
from twin.parts.shape import StlFile
from twin.parts.vary import Choice, flat
from twin.study.batch.pool import versions
from twin.study.dataset.plan import FORMAT, Places, Plan


def prepare(plan: Plan, places: Places, progress: Progress | None) -> Plan:
    """Write ``meta/``: the resolved scene, the meshes, and last of all info.json. Return the plan;
    of a dataset that was begun, the one that it has.

    Raises
    ------
    InputError
        The folder holds another dataset, or something else.
    """
    if places.info.is_file():
        return _resumed(plan, places)
    inside = sorted(each.name for each in places.folder.iterdir() if each != places.meta)
    if others := [name for name in inside if not name.startswith(".")]:
        raise InputError(
            f"{places.folder}: has {others[0]} but no meta/info.json, so it is no dataset, and a "
            "dataset has a folder of its own; give another --out"
        )
    scene, files = portable(plan.scene)
    _put_down(scene, files, places.meta)
    _pin_meshes(places.meta, progress)
    meshes = {p.name: file_digest(p) for p in sorted(places.meta.glob("*.npz"))}
    write_json(places.info, _info(Plan(scene, plan.samples), meshes))
    return plan


def _put_down(scene: Scene, files: Mapping[str, Path], meta: Path) -> None:
    """Write the scene and its files where they are missing or changed."""
    contents = {name: path.read_bytes() for name, path in files.items()}
    for name, data in {**contents, "scene.toml": scene.to_toml().encode()}.items():
        if not (meta / name).is_file() or (meta / name).read_bytes() != data:
            write_whole(meta / name, data)


def _pin_meshes(meta: Path, progress: Progress | None) -> None:
    """Write the meshes, and a block's tables, of the scene's accuracy and of its error estimate."""
    from twin.study.recipe import load_scene
    from twin.study.sensor import Sensor
    from twin.world.elasticity.block_table import Table
    from twin.world.elasticity.compliance import Compliance
    from twin.world.mesh.body_mesh import body_mesh, shipped_mesh
    from twin.world.mesh.sizing import WORLD, Sizing

    there = load_scene(meta / "scene.toml")
    base = Sensor(there, progress).compliance
    assert isinstance(base, Compliance), "a cover of its own modulus was refused"
    level, body = base.level, there.body
    rank = WORLD.index(level)
    levels = {*WORLD[max(rank - 1, 0) : rank + 1]}
    if not isinstance(body, Block) and shipped_mesh(body, WORLD[-1]) is not None:
        levels |= {*WORLD[-2:]}  # for the audit: the finest, and the one for its error
    for each in sorted(levels, key=WORLD.index):
        mesh = body_mesh(body, each, progress=progress)
        sizing = Sizing.of(body, each)
        facts = {"key": sizing.mesh_key(body), "level": each, "body": body.geometry()}
        mesh.write(meta / sizing.mesh_file(body), facts)
    if isinstance(body, Block):
        for role in ("truth", "check"):
            if Table.find(body, role, make=True, progress=progress) is not None:
                path = Table.path(body, role)
                write_whole(meta / path.name, path.read_bytes())


def _info(plan: Plan, meshes: Mapping[str, str]) -> dict[str, Any]:
    """Return what info.json holds; ``meshes`` are the checksums of their files."""
    scene = plan.scene
    identity = {
        "scene": scene.to_toml(),
        "columns": [c.name for c in plan.row_columns],
        "meshes": dict(meshes),
        "format": FORMAT,
    }
    facts: dict[str, Any] = {
        "format": FORMAT,
        "title": scene.title,
        "samples": plan.samples,
        "content": hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest(),
        "seed": scene.seed,
        "sampling": scene.dataset.sampling,
        "samples_per_shard": scene.dataset.samples_per_shard,
        "samples_per_sensor": scene.dataset.samples_per_sensor,
        "columns": [c.described() for c in plan.row_columns],
        "sensor_columns": [c.described() for c in plan.sensor_columns],
        "units": "mm, N, N mm, MPa, degrees, px; x right and y up in the picture, z into the "
        "body; pixel (0, 0) is the centre of the top left one",
        "meshes": identity["meshes"],
        "versions": versions(),
        "renderer": _renderer(scene, plan.needs),
    }
    if scene.camera is not None:
        facts["camera"] = scene.camera.model_dump(mode="json", exclude={"source", "assumed"})
    return facts


def _renderer(scene: Scene, needs: frozenset[str]) -> str:
    """Return the variant that renders, with its library; nothing if no picture is wanted."""
    if scene.camera is None or not needs & {"picture", "outlines"}:
        return ""
    from twin.world.picture.render import Renderer

    variant = Renderer.method(scene)
    tracer = "path " if scene.renderer == "path" else ""
    return f"{tracer}{variant.name} {Path(variant.library or '').name}".strip()


def _resumed(plan: Plan, places: Places) -> Plan:
    """Return the plan of a dataset that was begun; `InputError` if it is not the same one."""
    from twin.study.recipe import load_scene

    facts = places.read_info()
    if not (isinstance(facts.get("meshes"), dict) and {"versions", "renderer"} <= facts.keys()):
        raise InputError(
            f"{places.info}: meshes, versions or renderer are missing or damaged; copy it again"
        )
    scene, files = portable(plan.scene)
    fresh = _info(Plan(scene, plan.samples), facts["meshes"])
    where = f"{places.folder}: a dataset was begun here"
    if facts["content"] != fresh["content"]:
        what = "other columns" if facts["columns"] != fresh["columns"] else "another scene"
        begun = places.meta / "scene.toml"
        if what == "another scene" and begun.is_file():
            old, new = (
                flat(each.model_dump(mode="json"), lambda _: False)
                for each in (load_scene(begun), scene)
            )
            what += f" ({_difference(old, new) or 'other files'})"
        raise InputError(f"{where} with {what}; give another --out, or the same command as before")
    for name in ("versions", "renderer"):
        if facts[name] != fresh[name]:
            raise InputError(
                f"{where} with other {name} ({_difference(facts[name], fresh[name])}), so its "
                "bytes could not be continued; use those, or give another --out"
            )
    if plan.samples < facts["samples"]:
        raise InputError(
            f"{where} with {facts['samples']} samples; give --samples {facts['samples']} or more, "
            f"or another --out"
        )
    for name, digest in facts["meshes"].items():
        path = places.meta / name
        if not path.is_file() or file_digest(path) != digest:
            what = "changed since" if path.is_file() else "missing, with which"
            raise InputError(
                f"{path}: {what} the dataset was begun, and no other mesh makes the same bytes; "
                "copy it again, or give another --out"
            )
    _put_down(scene, files, places.meta)
    if fresh != facts:
        write_json(places.info, fresh)
    return Plan(load_scene(places.meta / "scene.toml"), plan.samples)


def _difference(old: Any, new: Any) -> str:
    if not isinstance(old, dict):
        return f"'{old}' then, '{new}' now"
    keys = [k for k in sorted({*old, *new}) if old.get(k) != new.get(k)]
    shown = [f"{k} {old.get(k)} then, {new.get(k)} now" for k in keys[:3]]
    return ", ".join([*shown, f"and {len(keys) - 3} more"] if len(keys) > 3 else shown)


def portable(scene: Scene) -> tuple[Scene, dict[str, Path]]:
    """Return the scene with bare names in place of paths, and the files by these names.

    Names are hashes of the contents: a probe's file may be one of several that vary, and a changed
    one must get another name.
    """
    files: dict[str, Path] = {}

    def named(path: str) -> str:
        name = f"probe-{hashlib.sha256(Path(path).read_bytes()).hexdigest()[:12]}.stl"
        files[name] = Path(path)
        return name

    changes: dict[str, Any] = {"calibration": scene.calibration.model_copy(update={"file": None})}
    if isinstance(scene.body, Solid):
        files["body.stl"] = Path(scene.body.file)
        changes["body"] = scene.body.model_copy(update={"file": "body.stl"})
    if scene.press is not None:
        also = tuple(_renamed(each, named) for each in scene.press.also)
        changes["press"] = _renamed(scene.press, named).model_copy(update={"also": also})
    changes["vary"] = {
        key: Choice(**{**axis.model_dump(), "choice": StlFile.renamed(axis.choice, named)})
        if isinstance(axis, Choice)
        else axis
        for key, axis in scene.vary.items()
    }
    return scene.model_copy(update=changes), files


def _renamed(press: Any, named: Callable[[str], str]) -> Any:
    if not isinstance(press.probe, Stl):
        return press
    probe = press.probe.model_copy(update={"file": named(press.probe.file)})
    return press.model_copy(update={"probe": probe})
