"""Before the first sample: scene, meshes and facts, on which every worker and every later run rests."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from twin.errors import InputError
from twin.parts.body import Block, Body
from twin.parts.scene import Scene
from twin.progress import Progress
from twin.results import write_json, write_whole
from twin.study.batch.job import Job
from twin.study.dataset.columns import ALWAYS, Kind
from twin.study.dataset.plan import FORMAT, Places, Plan, content_hash
from twin.study.dataset.portable import portable
from twin.study.recipe import dump_scene

WORK = "twin.study.dataset.work:make_shard"
PACKAGES = ("numpy", "scipy", "numba", "mitsuba", "drjit", "pyarrow", "deflate")
PACKAGE = Path(__file__).resolve().parents[2]
COUNTED = ("arrays.py", "png.py", "streams.py", "geometry", "parts", "theory", "world", "study")
"""Sources on which the numbers depend."""


def prepare(plan: Plan, places: Places, progress: Progress | None) -> None:
    """Write ``meta/``: the resolved scene, the meshes, and last of all info.json."""
    if any(places.folder.glob("data/*")):
        raise InputError(f"{places.folder}: has data but no meta/info.json, so it is no dataset; give another --out")
    scene, files = portable(plan.scene)
    _put_down(scene, files, places.meta)
    pin_meshes(scene, places.meta, progress)
    meshes = {p.name: sha256(p) for p in sorted(places.meta.glob("*.npz"))}
    write_json(places.info, info(Plan(scene, plan.samples), meshes))


def _put_down(scene: Scene, files: Mapping[str, Path], meta: Path) -> None:
    """Write the scene and the files that lie beside it, where they are not there as they should be."""
    contents = {name: path.read_bytes() for name, path in files.items()}
    for name, data in {**contents, "scene.toml": dump_scene(scene).encode()}.items():
        if not (meta / name).is_file() or (meta / name).read_bytes() != data:
            write_whole(meta / name, lambda file, data=data: file.write(data))  # type: ignore[misc]


def _copied(path: Path, to: Path) -> None:
    data = path.read_bytes()
    write_whole(to, lambda file: file.write(data))


def pin_meshes(scene: Scene, meta: Path, progress: Progress | None) -> None:
    """Write the meshes, and a block's tables, that the scene's accuracy takes and by which its error is estimated."""
    from twin.study.recipe import load_scene
    from twin.study.sensor import Sensor
    from twin.world.elasticity.compliance import Compliance
    from twin.world.elasticity.tabulate import cached_path, find_table, shipped_path
    from twin.world.mesh.body_mesh import body_mesh, mesh_file, mesh_key, shipped_mesh
    from twin.world.mesh.mesh import write_mesh
    from twin.world.mesh.sizing import WORLD, default_sizing

    there = load_scene(meta / "scene.toml")
    base = Sensor(there, progress).compliance
    assert isinstance(base, Compliance), "a cover of its own modulus was refused"
    level, body = base.level, there.body
    rank = WORLD.index(level)
    levels = {*WORLD[max(rank - 1, 0) : rank + 1]}
    if not isinstance(body, Block) and shipped_mesh(body, WORLD[-1]) is not None:
        levels |= {*WORLD[-2:]}  # for the audit: the finest, and the one that tells its error
    for each in sorted(levels, key=WORLD.index):
        mesh = body_mesh(body, each, progress=progress)
        key = mesh_key(body, default_sizing(body, each))
        write_mesh(mesh, meta / mesh_file(key), {"key": key, "level": each, "body": body.geometry()})
    if isinstance(body, Block):
        for role in ("truth", "check"):
            if find_table(body, role, make=True, progress=progress) is not None:
                shipped, cached = shipped_path(role), cached_path(body, role)
                path = cached if cached.is_file() else shipped
                _copied(path, meta / path.name)


def finest_mesh_file(body: Body) -> str:
    """Return the name of the file of the body's finest mesh, which is there for bodies that ship with one."""
    from twin.world.mesh.body_mesh import mesh_file, mesh_key
    from twin.world.mesh.sizing import WORLD, default_sizing

    return mesh_file(mesh_key(body, default_sizing(body, WORLD[-1])))


def info(plan: Plan, meshes: Mapping[str, str]) -> dict[str, Any]:
    """Return what info.json holds; ``meshes`` are the checksums of their files."""
    scene = plan.scene
    columns = (*ALWAYS, *plan.drawn_columns, *plan.columns)
    identity = {
        "scene": dump_scene(scene),
        "columns": [c.name for c in columns],
        "meshes": dict(meshes),
        "format": FORMAT,
    }
    told: dict[str, Any] = {
        "format": FORMAT,
        "title": scene.title,
        "samples": plan.samples,
        "content": content_hash(identity),
        "seed": scene.seed,
        "sampling": scene.dataset.sampling,
        "samples_per_shard": scene.dataset.samples_per_shard,
        "samples_per_sensor": scene.dataset.samples_per_sensor,
        "columns": [described(c) for c in columns],
        "sensor_columns": [described(c) for c in plan.sensor_columns],
        "units": "mm, N, N mm, MPa, degrees, px; x right and y up in the picture, z into the body; pixel (0, 0) is the "
        "centre of the top left one",
        "meshes": identity["meshes"],
        "versions": versions(),
        "renderer": renderer(scene, plan.needs),
    }
    if scene.camera is not None:
        told["camera"] = scene.camera.model_dump(mode="json", exclude={"source", "assumed"})
    return told


def described(column: Any) -> dict[str, str]:
    """Return a column in plain words."""
    from twin.parts.part import unit_of

    return {"name": column.name, "kind": column.kind, "unit": unit_of(column.name), "what": column.what}


def versions() -> dict[str, str]:
    """Return what the bytes depend on: packages, Python, and a hash of this program's own sources."""
    found = {name: importlib.metadata.version(name) for name in PACKAGES}
    sha = hashlib.sha256()
    for name in COUNTED:
        path = PACKAGE / name
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            sha.update(file.relative_to(PACKAGE).as_posix().encode())
            sha.update(file.read_bytes())
    python = ".".join(platform.python_version_tuple()[:2])
    return {**found, "python": python, "twin": sha.hexdigest()[:16], "machine": platform.machine()}


def renderer(scene: Scene, needs: frozenset[str]) -> str:
    """Return the variant that renders, with its library; nothing if no picture is wanted."""
    if scene.camera is None or not needs & {"picture", "outlines"}:
        return ""
    from twin.world.picture.render import method_for

    variant = method_for(scene.accuracy.centroid_px)
    return f"{variant.name} {Path(variant.library).name if variant.library else ''}".strip()


def resumed(plan: Plan, places: Places) -> Plan:
    """Return the plan of a dataset that was begun, checked to be the same.

    Raises
    ------
    InputError
        Another scene, other columns, other versions, another renderer, fewer samples, or a mesh that is not the one
        with which the dataset was begun.
    """
    from twin.study.recipe import load_scene

    told = read_info(places)
    if not (isinstance(told.get("meshes"), dict) and {"versions", "renderer"} <= told.keys()):
        raise InputError(f"{places.info}: meshes, versions or renderer are missing or damaged; copy it anew")
    scene, files = portable(plan.scene)
    fresh = info(Plan(scene, plan.samples), told["meshes"])
    where = f"{places.folder}: a dataset was begun here"
    if told["content"] != fresh["content"]:
        what = "other columns" if told["columns"] != fresh["columns"] else "another scene"
        raise InputError(f"{where} with {what}; give another --out, or the same command as before")
    for key, name in (("versions", "versions"), ("renderer", "renderer")):
        if told[key] != fresh[key]:
            raise InputError(
                f"{where} with other {name} ({_difference(told[key], fresh[key])}), so its bytes could not be "
                "continued; use those, or give another --out"
            )
    if plan.samples < told["samples"]:
        raise InputError(
            f"{where} with {told['samples']} samples; give --samples {told['samples']} or more, or another --out"
        )
    for name, digest in told["meshes"].items():
        path = places.meta / name
        if not path.is_file() or sha256(path) != digest:
            what = "changed since" if path.is_file() else "missing, with which"
            raise InputError(
                f"{path}: {what} the dataset was begun, and no other mesh makes the same bytes; copy it anew, or give "
                "another --out"
            )
    _put_down(scene, files, places.meta)
    if fresh != told:
        write_json(places.info, fresh)
    return Plan(load_scene(places.meta / "scene.toml"), plan.samples)


def _difference(old: Any, new: Any) -> str:
    if not isinstance(old, dict):
        return f"'{old}' then, '{new}' now"
    keys = [k for k in sorted({*old, *new}) if old.get(k) != new.get(k)]
    return ", ".join(f"{k} {old.get(k)} then, {new.get(k)} now" for k in keys)


def read_info(places: Places) -> dict[str, Any]:
    """Return info.json.

    Raises
    ------
    InputError
        There is none, or it can't be read.
    """
    try:
        told: dict[str, Any] = json.loads(places.info.read_text())
    except FileNotFoundError:
        raise InputError(f"{places.folder}: has no meta/info.json, so it is no dataset") from None
    except (OSError, ValueError, RecursionError) as problem:
        raise InputError(f"{places.info}: can't be read ({problem})") from None
    if not isinstance(told, dict) or told.get("format") != FORMAT:
        found = told.get("format") if isinstance(told, dict) else None
        raise InputError(f"{places.info}: format {found}; this program reads {FORMAT}")
    lists = [told.get(name) for name in ("columns", "sensor_columns")]
    whole = all(isinstance(each, list) and all(map(_is_column, each)) for each in lists)
    if not (whole and isinstance(told.get("samples"), int) and isinstance(told.get("content"), str)):
        raise InputError(f"{places.info}: columns, sensor_columns, samples or content are missing or damaged")
    return told


def _is_column(entry: Any) -> bool:
    return isinstance(entry, dict) and isinstance(entry.get("name"), str) and entry.get("kind") in get_args(Kind)


def job_of(places: Places) -> Job:
    """Return the job: everything a worker needs to know."""
    kept = [p for p in sorted(places.meta.iterdir()) if p.suffix in {".npz", ".toml", ".stl"} or p == places.info]
    return Job(files={p.name: p.read_bytes() for p in kept}, work=WORK)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's contents."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
