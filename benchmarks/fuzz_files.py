"""The readers that are attacked: the command that reads a kind of file, and what is done to that file."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import numpy as np

from benchmarks.fuzz_hostile import ARCHIVE, DATASET, HOSTILE_TOML, JSON, PICTURES, STL, TABLE, YAML
from benchmarks.fuzz_spoil import (
    Spoil,
    appended,
    as_folder,
    npz_bomb,
    npz_lying,
    npz_pickle,
    npz_with,
    piped,
    replaced,
    swept_rows,
    written,
)
from benchmarks.fuzz_whole import box_stl


@dataclass(frozen=True)
class Reader:
    """A command that reads a kind of file.

    Attributes
    ----------
    name
        Also that of the folder with its whole files.
    command
        Arguments of ``twin``, run in that folder.
    targets
        Files in it that are damaged.
    hostile
        What else is done to the folder, by name.
    stdin
        File of the folder that comes through the pipe.
    """

    name: str
    command: tuple[str, ...]
    targets: tuple[str, ...]
    hostile: dict[str, Spoil] = field(default_factory=dict)
    stdin: str = ""


RAW = ("reconstruct", "rest.png", "-", "--size", "160x120", "--format", "rgb24", "--calibration", "flat.npz")

READERS = {
    reader.name: reader
    for reader in (
        Reader("scene", ("check", "small.toml"), ("small.toml",), HOSTILE_TOML),
        Reader("scene, run", ("run", "small.toml", "--want", "displacement", "--out", "here"), (), HOSTILE_TOML),
        Reader("sweep", ("check", "sweep.toml"), ("sweep.toml",), {
            "a design for every atom": replaced("sweep.toml", "steps = 3", "steps = 10000"),
            "many steps": replaced("sweep.toml", "steps = 3", "steps = 999999999"),
            "scene leads out": replaced("sweep.toml", "small.toml", "../outside/precious"),
            "deep": appended("sweep.toml", "\nx = " + "[" * 100_000),
        }),
        Reader("sweep, kept rows", ("sweep", "sweep.toml", "--out", "swept", "--workers", "1"), (), {
            "rows of another kind": swept_rows(b'{"key": "a"}\n[]\n{}\n3\n'),
            "rows of bytes": swept_rows(b"\xff\xfe\n" * 1000),
            "a link to a folder outside": lambda inside: (
                (inside / "swept").mkdir(), (inside / "swept" / "more").symlink_to("../../outside")),
        }),
        Reader("STL body", ("check", "solid.toml"), ("body.stl",), STL),
        Reader("STL text", ("check", "solid.toml", ), ("text.stl",), {
            "text": lambda inside: os.replace(inside / "text.stl", inside / "body.stl"),
        }),
        Reader("STL probe", ("check", "probe.toml"), ("probe.stl",), {
            "is a folder": as_folder("probe.stl"), "flat": written("probe.stl", box_stl(2, 2, 0)),
        }),
        Reader("calibration", ("check", "flat.npz"), ("flat.npz",), ARCHIVE),
        Reader("calibration, used", ("reconstruct", "rest.png", "pressed.png", "--calibration", "flat.npz", "--out",
                                     "forces.csv"), (), ARCHIVE),
        Reader("results", ("check", "."), ("truth.npz",), {
            "pickle in it": npz_pickle("truth.npz", "total_force_n"),
            "bomb": npz_bomb("truth.npz", "surface_force_n"),
            "claims a trillion": npz_lying("truth.npz", "surface_force_n", (10**6, 10**6)),
            "other shapes": npz_with("truth.npz", "surface_force_n", np.zeros(7)),
            "text": npz_with("truth.npz", "surface_force_n", np.array(["a", "b"])),
            "no pieces": npz_with("truth.npz", "surface_force_n", np.zeros(())),
            "NaN": npz_with("truth.npz", "surface_force_n", np.full((4, 3), np.nan)),
        }),
        Reader("pictures", ("reconstruct", "rest.png", "pressed.png", "--calibration", "flat.npz", "--out",
                            "forces.parquet", "--overlay", "drawn"), ("pressed.png", "rest.png"), PICTURES),
        Reader("JPEG and BMP", ("reconstruct", "rest.png", "pressed.jpg", "pressed.bmp", "--calibration", "flat.npz"),
               ("pressed.jpg", "pressed.bmp")),
        Reader("raw pipe", RAW, ("frames.raw",), {
            "cut": lambda inside: os.truncate(inside / "frames.raw", 60_000),
        }, stdin="frames.raw"),
        Reader("video", ("reconstruct", "rest.png", "film.mp4", "--calibration", "flat.npz", "--out", "forces.npz"),
               ("film.mp4",), {"is a folder": as_folder("film.mp4"), "is a pipe": piped("film.mp4")}),
        Reader("dataset", ("check", "data"), ("data/meta/info.json", "data/meta/SHA256SUMS", "data/meta/scene.toml",
                                              "data/data/part-00000.parquet"), DATASET),
        Reader("dataset, viewed", ("view", "data"), ("data/data/part-00000.parquet",), DATASET),
        Reader("dataset, exported", ("export", "data", "--format", "coco", "--out", "coco"),
               ("data/data/part-00000.parquet",), DATASET),
        Reader("dataset, resumed", ("dataset", "dataset.toml", "--samples", "2", "--out", "data", "--workers", "1"),
               (), {k: v for k, v in DATASET.items() if k != "data folder leads out"}),
        Reader("intrinsics, YAML", ("check", "yaml.toml"), ("lens.yaml",), YAML),
        Reader("intrinsics, JSON", ("check", "json.toml"), ("lens.json",), JSON),
        Reader("presses.csv", ("calibrate", ".", "--scene", "small.toml", "--method", "fitted", "--out", "made.npz"),
               ("presses.csv",), TABLE),
    )
}  # fmt: skip
"""Every reader, by name."""
