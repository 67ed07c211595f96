"""The readers that are attacked: the command that reads a kind of file, and what is done to that file.

Parts: damage that suits any file; ways to make a file hostile, each a `Spoil`, which does it to a reader's folder;
a whole file of every kind; hostile files by kind (lying headers, bombs, NaN, pickles, links, paths that lead out).
"""

import io
import json
import os
import pickle
import shutil
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks import ROOT

Spoil = Callable[[Path], object]


class Evil:
    """Unpickled, it would write a file beside the folder that it lies in."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.system, ("touch ../outside/executed",))


def spoiling(act: Callable[..., object]) -> Callable[..., Spoil]:
    """Turn what is done to a folder, with its arguments, into a maker of spoils."""
    return lambda *given: lambda inside: act(inside, *given)


@spoiling
def npz_with(inside: Path, name: str, key: str, array: Any) -> None:
    """Replace an array of an npz file."""
    with np.load(inside / name) as old:
        arrays = {k: old[k] for k in old.files}
    np.savez(inside / name, allow_pickle=True, **{**arrays, key: array})


def npz_pickle(name: str, key: str) -> Spoil:
    return npz_with(name, key, np.array([Evil()], dtype=object))


@spoiling
def npz_bomb(inside: Path, name: str, key: str) -> None:
    """Replace an array by 16 GB of zeros, which deflate to 16 MB."""
    with (
        zipfile.ZipFile(inside / name, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{key}.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy_header((2 * 10**9,)))
        for _ in range(1600):
            member.write(bytes(10**7))


@spoiling
def npz_lying(inside: Path, name: str, key: str, shape: tuple[int, ...]) -> None:
    """Replace an array by one whose header claims a shape that isn't there."""
    with zipfile.ZipFile(inside / name) as old:
        members = {n: old.read(n) for n in old.namelist()}
    members[f"{key}.npy"] = npy_header(shape) + bytes(80)
    with zipfile.ZipFile(inside / name, "w") as new:
        for n, data in members.items():
            new.writestr(n, data)


@spoiling
def npz_member(inside: Path, name: str, member: str) -> None:
    """Add a member whose name leads out of the folder."""
    with zipfile.ZipFile(inside / name, "a") as archive:
        archive.writestr(member, npy_header((1,)) + bytes(8))


def npy_header(shape: tuple[int, ...]) -> bytes:
    """Return the head of a .npy file of float64."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


@spoiling
def linked(inside: Path, name: str, to: str) -> None:
    path = inside / name
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.symlink_to(to)


@spoiling
def piped(inside: Path, name: str) -> None:
    (inside / name).unlink()
    os.mkfifo(inside / name)


@spoiling
def as_folder(inside: Path, name: str) -> None:
    (inside / name).unlink()
    (inside / name).mkdir()


@spoiling
def written(inside: Path, name: str, text: str | bytes) -> None:
    (inside / name).parent.mkdir(exist_ok=True)
    (inside / name).write_bytes(text.encode() if isinstance(text, str) else text)


@spoiling
def pictured(inside: Path, name: str, pixels: np.ndarray) -> None:
    save_as(pixels, inside / name)


@spoiling
def appended(inside: Path, name: str, text: str) -> None:
    with open(inside / name, "a") as file:
        file.write(text)


@spoiling
def replaced(inside: Path, name: str, old: str, new: str) -> None:
    (inside / name).write_text((inside / name).read_text().replace(old, new))


def png(width: int, height: int, *, data: bytes = b"", kind: int = 2, depth: int = 8) -> bytes:
    """Return a PNG that claims a size, whatever its data."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)), (b"IDAT", data), (b"IEND", b"")]
    made = [struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(made)


def png_bomb(side: int) -> bytes:
    """Return a black picture of ``side`` by ``side`` px, deflated."""
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(bytes(3 * side + 1)) for _ in range(side)) + packer.flush()
    return png(side, side, data=data)


def ztxt_bomb() -> bytes:
    """Return a small PNG with a text that unpacks to 500 MB."""
    whole = png(2, 2, data=zlib.compress(bytes(14)))
    body = b"zTXt" + b"Comment\0\0" + zlib.compress(bytes(5 * 10**8), 9)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return whole[:33] + chunk + whole[33:]


def _shard(inside: Path) -> Path:
    return next((inside / "data" / "data").glob("*.parquet"))


@spoiling
def shard(inside: Path, table: Callable[[Any], Any]) -> None:
    """Rewrite a sample file of the dataset, and its checksums."""
    import pyarrow.parquet as pq

    pq.write_table(table(pq.read_table(_shard(inside))), _shard(inside))
    _resum(inside)


def _resum(inside: Path) -> None:
    from twin.study.dataset.plan import Places

    places = Places(inside / "data")
    places.sums.write_text("".join(f"{digest}  {name}\n" for name, digest in places.sums_of_files().items()))


@spoiling
def info_changed(inside: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = inside / "data" / "meta" / "info.json"
    told = json.loads(path.read_text())
    change(told)
    path.write_text(json.dumps(told))
    _resum(inside)


def bad_shard(inside: Path) -> None:
    data = _shard(inside).read_bytes()
    _shard(inside).write_bytes(data[: len(data) // 3] + data[len(data) // 2 :])
    _resum(inside)


def bad_picture(table: Any) -> Any:
    import pyarrow as pa

    at = table.schema.get_field_index("picture")
    kind = table.schema.field(at)
    return table.set_column(at, kind, pa.array([png_bomb(6000)] * table.num_rows, kind.type))


def nans(shards: Any) -> Any:
    import pyarrow as pa

    kind = shards.schema.field("force_n").type
    none = [np.nan] * 3
    return pa.array([[none] if pa.types.is_nested(kind.value_type) else none] * shards.num_rows, kind)


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
CSV = "frame,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n\npressed.png,0,0,,0,0,0.5\npressed.bmp,0,0,,0,0,0.5\n"


def make_whole_files(folder: Path, readers: Iterable[str]) -> None:
    """Make a folder of whole files for each reader, in a process of its own (it renders; forks don't like that)."""
    code = f"import pathlib, benchmarks.fuzz_files as f; f.make(pathlib.Path({str(folder)!r}), {list(readers)!r})"
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)


def make(folder: Path, readers: Iterable[str]) -> None:
    """Make the whole files, a folder for each reader."""
    import twin
    from twin.show.report import report
    from twin.study.calibrate import calibrate_to_file
    from twin.study.dataset.create import create_dataset
    from twin.study.run import run

    folder.mkdir(parents=True)
    scene = twin.load_scene("kamiyama_pillar", SMALL)
    base = folder / "base"
    result = run(scene)
    result.write(base)
    calibrate_to_file(scene, base / "flat.npz")
    matrix = {"rows": 3, "cols": 3, "data": [450.0, 0, 79.5, 0, 450.0, 59.5, 0, 0, 1]}
    lens = {"camera_matrix": matrix, "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.01, 0, 0, 0]}}
    texts = {
        "report.html": report(result), "small.toml": scene.to_toml(), "sweep.toml": SWEEP, "presses.csv": CSV,
        "solid.toml": SOLID, "probe.toml": PROBE, "body.stl": box_stl(12, 12, 8), "probe.stl": box_stl(2, 2, 2),
        "text.stl": box_stl(12, 12, 8, "stl_ascii"), "lens.json": json.dumps(lens), "json.toml": LENS % "json",
        "lens.yaml": json.dumps(lens, indent=1), "yaml.toml": LENS % "yaml",
        "frames.raw": result.rest.tobytes() + result.pressed.tobytes(),
    }  # fmt: skip
    for name, text in texts.items():
        written(name, text)(base)
    # dots of 3 pixels: with colours at half the resolution none of them could be trusted
    save_as(result.pressed, base / "pressed.jpg", quality=95, subsampling=0)
    save_as(result.pressed, base / "pressed.bmp")
    create_dataset(twin.load_scene("kamiyama_pillar", {**SMALL, **VARY}), base / "data", 2)
    (base / "dataset.toml").write_text((base / "data" / "meta" / "scene.toml").read_text())
    try:
        import imageio_ffmpeg

        film = imageio_ffmpeg.write_frames(
            str(base / "film.mp4"), (160, 120), macro_block_size=1, pix_fmt_out="yuv444p", quality=10
        )
        film.send(None)
        for picture in (result.rest, result.pressed, result.pressed):
            film.send(np.ascontiguousarray(picture))
        film.close()
    except ImportError:
        (base / "film.mp4").write_bytes(b"no encoder here")
    for name in readers:
        shutil.copytree(base, folder / name)
    shutil.rmtree(base)


def save_as(picture: np.ndarray, path: Path, **options: int) -> None:
    """Write a picture in the format that a name ends in, with Pillow's options for it."""
    from PIL import Image

    Image.fromarray(picture).save(path, **options)


def box_stl(width: float, length: float, height: float, kind: str = "stl") -> Any:
    """Return a box as binary STL, z from 0; of kind ``stl_ascii`` as text."""
    box = trimesh.creation.box(bounds=[[-width / 2, -length / 2, 0.0], [width / 2, length / 2, height]])
    return box.export(file_type=kind)


def no_file(name: str) -> dict[str, Spoil]:
    """Return ways to put something else in a file's place."""
    return {"is a pipe": piped(name), "is a folder": as_folder(name), "is endless": linked(name, "/dev/zero")}


HOSTILE_TOML: dict[str, Spoil] = {
    **no_file("small.toml"),
    "deep": appended("small.toml", "\nx = " + "[" * 400_000),
    "deep tables": appended("small.toml", "\n[" + "a." * 40_000 + "a]\n"),
    "deep inline": appended("small.toml", "\nx = " + "{a=" * 5_000 + "1" + "}" * 5_000),
    "long number": appended("small.toml", "\nx = " + "9" * 900_000),
    "many keys": appended("small.toml", "".join(f"\n[k{i}]" for i in range(60_000))),
    "a million bytes more": appended("small.toml", "#" * 1_100_000),
    "base leads out": written("small.toml", 'base = "../outside/precious"\n'),
    "base is itself": written("small.toml", 'base = "small.toml"\n'),
    "recipe leads out": written("small.toml", '[body]\nrecipe = "../../../../etc/passwd"\n'),
    "base is a device": written("small.toml", 'base = "/dev/zero"\n'),
    "calibration leads out": appended("small.toml", '\n[x]\n[calibration.y]\n'),
    "is a link": linked("small.toml", "../outside/precious"),
    "is a loop of links": linked("small.toml", "small.toml"),
    "utf-16": written("small.toml", 'seed = 1'.encode("utf-16")),
    "NaN": replaced("small.toml", "diameter_mm = 0.5", "diameter_mm = nan"),
    "huge": replaced("small.toml", "columns = 7", "columns = 99999999999999999999999"),
    "dates": replaced("small.toml", "seed = 1", "seed = 2026-01-01T00:00:00Z"),
    "title of markup": replaced("small.toml", "title = ", 'title = "<script>alert(1)</script>" #'),
}  # fmt: skip

ARCHIVE = {
    **no_file("flat.npz"),
    "pickle in it": npz_pickle("flat.npz", "transfer"),
    "is a pickle": written("flat.npz", pickle.dumps(Evil())),
    "bomb": npz_bomb("flat.npz", "transfer"),
    "bomb under another name": npz_bomb("flat.npz", "unheard_of"),
    "claims a trillion": npz_lying("flat.npz", "transfer", (10**6, 10**6)),
    "claims less than nothing": npz_lying("flat.npz", "transfer", (-1, 5)),
    "claims a thousand axes": npz_lying("flat.npz", "transfer", (1,) * 1000),
    "NaN": npz_with("flat.npz", "transfer", np.full((130, 36), np.nan)),
    "NaN places": npz_with("flat.npz", "site_mm", np.full((12, 3), np.nan)),
    "inf noise": npz_with("flat.npz", "noise_px", np.array(np.inf)),
    "leads out": npz_member("flat.npz", "../outside/executed.npy"),
    "camera is code": npz_with("flat.npz", "camera", np.array("__import__('os').system('touch ../outside/executed')")),
    "deep provenance": npz_with("flat.npz", "provenance", np.array("[" * 100_000)),
    "version is a text": npz_with("flat.npz", "version", np.array("2")),
    "is a link": linked("flat.npz", "../outside/precious"),
}
NOISE = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
PICTURES = {
    "bomb": written("pressed.png", png_bomb(20_000)),
    "bomb below the limit": written("pressed.png", png_bomb(6_000)),
    "claims 4 billion by 4 billion": written("pressed.png", png(2**32 - 1, 2**32 - 1, data=zlib.compress(b"0" * 100))),
    "claims 2 billion by 1": written("pressed.png", png(2**31 - 1, 1, data=zlib.compress(b"0" * 100))),
    "no pixels": written("pressed.png", png(0, 0)),
    "text bomb": written("pressed.png", ztxt_bomb()),
    "16 bits": written("pressed.png", png(4, 4, data=zlib.compress(bytes(4 * 25)), depth=16)),
    "palette without colours": written("pressed.png", png(4, 4, data=zlib.compress(bytes(20)), kind=3)),
    "another size": pictured("pressed.png", np.zeros((7, 9, 3), np.uint8)),
    "one pixel": pictured("pressed.png", np.zeros((1, 1, 3), np.uint8)),
    "saturated": pictured("pressed.png", np.full((120, 160, 3), 255, np.uint8)),
    "noise": pictured("pressed.png", NOISE),
    "noise at rest": pictured("rest.png", NOISE),
    "PostScript": written("pressed.png", b"%!PS-Adobe-3.0\n%%BoundingBox: 0 0 9 9\n(../outside/executed) (w) file\n"),
    **no_file("pressed.png"),
    "table is a link": linked("forces.parquet", "../outside/precious"),
}  # fmt: skip
STL = {
    "claims 4 billion": written("body.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50)),
    "NaN": written("body.stl", box_stl(12, 12, 8).replace(struct.pack("<f", 6.0), struct.pack("<f", np.nan))),
    "inf": written("body.stl", box_stl(12, 12, 8).replace(struct.pack("<f", 6.0), struct.pack("<f", np.inf))),
    "largest numbers": written("body.stl", box_stl(3e38, 3e38, 3e38)),
    "flat": written("body.stl", box_stl(12, 12, 0)),
    "tiny": written("body.stl", box_stl(1e-30, 1e-30, 1e-30)),
    "open": written("body.stl", bytes(80) + struct.pack("<I", 11) + box_stl(12, 12, 8)[84:-50]),
    "a million copies": written("body.stl", bytes(80) + struct.pack("<I", 600_000) + box_stl(12, 12, 8)[84:] * 50_000),
    "text bomb": written("body.stl", b"solid " + b"vertex 1 1 1\n" * 3_000_000),
    **no_file("body.stl"),
}
DATASET: dict[str, Spoil] = {
    "shard cut": bad_shard,
    "shard without a column": shard(lambda t: t.drop_columns(["status"])),
    "shard of NaN": shard(lambda t: t.set_column(t.schema.get_field_index("force_n"), "force_n", nans(t))),
    "shard of text": shard(lambda t: t.set_column(t.schema.get_field_index("index"), "index", [["x"] * t.num_rows])),
    "shard without rows": shard(lambda t: t.slice(0, 0)),
    "picture is a bomb": shard(bad_picture),
    "info lacks its columns": info_changed(lambda told: told.pop("columns")),
    "info claims a billion": info_changed(lambda told: told.update(samples=10**9)),
    "info of other kinds": info_changed(lambda told: told.update(columns="x", samples="many")),
    "info is a list": written("data/meta/info.json", "[]"),
    "info is deep": written("data/meta/info.json", "[" * 200_000),
    "sums lead out": appended("data/meta/SHA256SUMS", "0" * 64 + "  ../../outside/precious\n"),
    "sums of bytes": written("data/meta/SHA256SUMS", b"\xff\xfe  x\n"),
    "shard leads out": linked("data/data/part-00000.parquet", "../../../outside/precious"),
    "a link to a folder outside": linked("data/more", "../../outside"),
    "data folder leads out": linked("data/data", "../../outside"),
    "lock leads out": linked("data/meta/writer.lock", "../../../outside/lock"),
    "scene is another": written("data/meta/scene.toml", 'base = "block_bare"\n'),
}

LAUGHS = "\n".join(["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"] + [
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]) + "\ncamera_matrix: *a11\n"  # fmt: skip
YAML = {
    "billion laughs": written("lens.yaml", LAUGHS),
    "python object": written("lens.yaml", "camera_matrix: !!python/object/apply:os.system ['touch ../outside/made']\n"),
    "deep": written("lens.yaml", "[" * 100_000),
    "a table of itself": written("lens.yaml", "camera_matrix: &a\n  data: *a\n"),
    "NaN": replaced("lens.yaml", "450.0", ".nan"),
    **no_file("lens.yaml"),
}
JSON = {
    "deep": written("lens.json", "[" * 500_000),
    "long number": written("lens.json", '{"camera_matrix": ' + "9" * 400_000 + "}"),
    "NaN": replaced("lens.json", "450.0", "NaN"),
    "huge": replaced("lens.json", "450.0", "1e308"),
}
TABLE = {
    "NUL": written("presses.csv", b"frame,x_mm,y_mm,z_mm,fx_n,fy_n,fz_n\n\x00,1,1,1,1,1,1\n"),
    "one field of 10 MB": written("presses.csv", CSV + "x" * 10_000_000),
    "open quote": written("presses.csv", CSV + '"' + "x\n" * 200_000),
    "frame leads out": written("presses.csv", CSV.replace("pressed.png", "../outside/precious")),
    "frame is a device": written("presses.csv", CSV.replace("pressed.png", "/dev/zero")),
    "far away": written("presses.csv", CSV.replace("0,0,,", "1e300,0,,")),
    "force of 1e300": written("presses.csv", CSV.replace("0.5", "1e300")),
    "no force": written("presses.csv", CSV.replace("0.5", "0")),
}


@dataclass(frozen=True)
class Reader:
    """A command that reads a kind of file: arguments of ``twin``, run in a folder of whole files of the reader's name.

    ``targets`` are damaged, ``hostile`` is what else is done to the folder, by name; ``stdin`` comes through the pipe.
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
            "rows of another kind": written("swept/rows.jsonl", b'{"key": "a"}\n[]\n{}\n3\n'),
            "rows of bytes": written("swept/rows.jsonl", b"\xff\xfe\n" * 1000),
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


EXTREMES = (
    b"\x00" * 8, b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"nan", b"-1", b"1e999", b"../../", b"\x80",
)  # fmt: skip
"""What pieces are overwritten with: largest and least numbers, words that stand for none, paths."""


def damaged(data: bytes, rounds: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """Yield names and damaged copies of a file's bytes: a few that are always tried, and ``rounds`` random ones."""
    yield "empty", b""
    yield "one byte", data[:1]
    yield "cut in half", data[: len(data) // 2]
    yield "last byte cut", data[:-1]
    yield "twice", data + data
    yield "zeros", bytes(len(data))
    yield "another kind", b"%PDF-1.4 nothing of what you expect\n"
    for number in range(rounds):
        rng = np.random.default_rng([seed, number])
        yield f"random {number}", _random(data, rng)


def _random(data: bytes, rng: np.random.Generator) -> bytes:
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not found:
            break
        # headers matter more than what they head
        place = int(rng.integers(0, min(len(found), 256 if rng.random() < 0.5 else len(found))))
        size, how = int(rng.integers(1, 64)), int(rng.integers(5))
        if how == 0:
            found[place] ^= 1 << int(rng.integers(8))
        elif how == 1:
            word = EXTREMES[int(rng.integers(len(EXTREMES)))]
            found[place : place + len(word)] = word
        elif how == 2:
            del found[place : place + size]
        elif how == 3:
            found[place:place] = found[place : place + size]
        else:
            found[place : place + size] = rng.integers(0, 256, size, np.uint8).tobytes()
    return bytes(found)
