"""A whole file of every kind that a command reads: what is then damaged."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks import ROOT

SMALL = {
    "camera.width_px": 160, "camera.height_px": 120, "camera.focal_px": 450,
    "markers.red.columns": 7, "markers.red.rows": 5, "markers.blue.columns": 6, "markers.blue.rows": 4,
    "reconstruction.sites.columns": 4, "reconstruction.sites.rows": 3, "accuracy.contact_patches": 6,
    "press.probe": {"kind": "sphere", "diameter_mm": 5}, "press.force_n": {"z": 0.5},
}  # fmt: skip
VARY = {
    "dataset.samples_per_shard": 1,
    "dataset.columns": ["force_n", "marker_pressed_px", "marker_displacement_mm", "picture"],
    "vary": {"press.at_mm": {"low": [-3.0, -2.0], "high": [3.0, 2.0]}},
}

SOLID = """
base = "block_bare"
[material]
youngs_modulus_mpa = 1.0
[body]
shape = "solid"
file = "body.stl"
[body.held]
plane = {point_mm = [0, 0, 8], normal = [0, 0, 1]}
[body.sensing]
normal = [0, 0, -1]
[press]
force_n = {z = 0.1}
[press.probe]
kind = "sphere"
diameter_mm = 3
"""
PROBE = 'base = "block_bare"\n[press]\nforce_n = {z = 0.1}\n[press.probe]\nkind = "stl"\nfile = "probe.stl"\n'
LENS = 'base = "kamiyama_pillar"\n[camera]\nintrinsics = "lens.%s"\n'
SWEEP = """
scene = "small.toml"
fidelity = ["closed"]
[axes]
"markers.*.pitch_mm" = {low = 1.2, high = 1.8, steps = 3}
[loads]
size_mm = 2.0
pair_mm = 4.0
presses = 2
"""
CSV = "frame,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n\npressed.png,0,0,,0,0,0.5\npressed.png,0,0,,0,0,0.5\n"


def make_whole_files(folder: Path, readers: Iterable[str]) -> None:
    """Make a folder of whole files for each reader, in a process of its own (it renders; forks don't like that)."""
    code = f"import pathlib, benchmarks.fuzz_whole as f; f.make(pathlib.Path({str(folder)!r}), {list(readers)!r})"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)


def make(folder: Path, readers: Iterable[str]) -> None:
    """Make the whole files, a folder for each reader."""
    import twin
    from twin.show.report import report
    from twin.study.calibrate import calibrate_to_file
    from twin.study.dataset.create import create_dataset
    from twin.study.frames import VideoWriter, ffmpeg
    from twin.study.recipe import dump_scene
    from twin.study.run import run

    folder.mkdir(parents=True)
    scene = twin.load_scene("kamiyama_pillar", SMALL)
    base = folder / "base"
    result = run(scene)
    result.write(base)
    (base / "report.html").write_text(report(result))
    (base / "small.toml").write_text(dump_scene(scene))
    calibrate_to_file(scene, base / "flat.npz")
    (base / "sweep.toml").write_text(SWEEP)
    (base / "presses.csv").write_text(CSV)
    (base / "solid.toml").write_text(SOLID)
    (base / "probe.toml").write_text(PROBE)
    (base / "body.stl").write_bytes(box_stl(12, 12, 8))
    (base / "probe.stl").write_bytes(box_stl(2, 2, 2))
    (base / "text.stl").write_bytes(text_stl(box_stl(12, 12, 8)))
    matrix = {"rows": 3, "cols": 3, "data": [450.0, 0, 79.5, 0, 450.0, 59.5, 0, 0, 1]}
    lens = {"camera_matrix": matrix, "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.01, 0, 0, 0]}}
    (base / "lens.json").write_text(json.dumps(lens))
    (base / "lens.yaml").write_text(json.dumps(lens, indent=1))
    (base / "json.toml").write_text(LENS % "json")
    (base / "yaml.toml").write_text(LENS % "yaml")
    assert result.rest is not None
    assert result.pressed is not None
    (base / "frames.raw").write_bytes(result.rest.tobytes() + result.pressed.tobytes())
    save_as(result.pressed, base / "pressed.jpg")
    save_as(result.pressed, base / "pressed.bmp")
    create_dataset(twin.load_scene("kamiyama_pillar", {**SMALL, **VARY}), base / "data", 2)
    (base / "dataset.toml").write_text((base / "data" / "meta" / "scene.toml").read_text())
    try:
        ffmpeg()
        film = VideoWriter(base / "film.mp4", (160, 120))
        for picture in (result.rest, result.pressed, result.pressed):
            film.add(picture)
        film.close()
    except twin.errors.MissingCapability:
        (base / "film.mp4").write_bytes(b"no encoder here")
    for name in readers:
        shutil.copytree(base, folder / name)
    shutil.rmtree(base)


def save_as(picture: np.ndarray, path: Path) -> None:
    """Write a picture in the format that a name ends in."""
    from PIL import Image

    Image.fromarray(picture).save(path)


def box_stl(width: float, length: float, height: float) -> bytes:
    """Return a box as binary STL, z from 0."""
    ends = (-width / 2, width / 2), (-length / 2, length / 2), (0.0, height)
    corners = np.array([[x, y, z] for x in ends[0] for y in ends[1] for z in ends[2]])
    sides = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    record = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
    record["corners"] = corners[faces]
    return bytes(80) + struct.pack("<I", len(faces)) + record.tobytes()


def text_stl(binary: bytes) -> bytes:
    """Return a binary STL's triangles as text."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    lines = ["solid box"]
    for triangle in np.frombuffer(binary, record, offset=84)["corners"]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid box\n"]).encode()
