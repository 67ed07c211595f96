"""Hostile files by kind: lying headers, bombs, NaN, pickles, links, paths that lead out of the folder."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from benchmarks.fuzz_spoil import (
    Spoil,
    appended,
    as_folder,
    bad_picture,
    bad_shard,
    bare_pickle,
    info_changed,
    linked,
    nans,
    npz_bomb,
    npz_lying,
    npz_member,
    npz_pickle,
    npz_with,
    piped,
    png,
    png_bomb,
    replaced,
    shard,
    written,
    ztxt_bomb,
)
from benchmarks.fuzz_whole import CSV, box_stl, save_as

HOSTILE_TOML: dict[str, Spoil] = {
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
    "is a pipe": piped("small.toml"),
    "is a folder": as_folder("small.toml"),
    "is endless": linked("small.toml", "/dev/zero"),
    "utf-16": written("small.toml", 'seed = 1'.encode("utf-16")),
    "NaN": replaced("small.toml", "diameter_mm = 0.5", "diameter_mm = nan"),
    "huge": replaced("small.toml", "columns = 7", "columns = 99999999999999999999999"),
    "dates": replaced("small.toml", "seed = 1", "seed = 2026-01-01T00:00:00Z"),
    "title of markup": replaced("small.toml", "title = ", 'title = "<script>alert(1)</script>" #'),
}  # fmt: skip

ARCHIVE = {
    "pickle in it": npz_pickle("flat.npz", "transfer"),
    "is a pickle": bare_pickle("flat.npz"),
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
    "is a pipe": piped("flat.npz"),
    "is a folder": as_folder("flat.npz"),
    "is a link": linked("flat.npz", "../outside/precious"),
}
PICTURES = {
    "bomb": written("pressed.png", png_bomb(20_000)),
    "bomb below the limit": written("pressed.png", png_bomb(6_000)),
    "claims 4 billion by 4 billion": written("pressed.png", png(2**32 - 1, 2**32 - 1, data=zlib.compress(b"0" * 100))),
    "claims 2 billion by 1": written("pressed.png", png(2**31 - 1, 1, data=zlib.compress(b"0" * 100))),
    "no pixels": written("pressed.png", png(0, 0)),
    "text bomb": written("pressed.png", ztxt_bomb()),
    "16 bits": written("pressed.png", png(4, 4, data=zlib.compress(bytes(4 * 25)), depth=16)),
    "palette without colours": written("pressed.png", png(4, 4, data=zlib.compress(bytes(20)), kind=3)),
    "another size": lambda inside: save_as(np.zeros((7, 9, 3), np.uint8), inside / "pressed.png"),
    "one pixel": lambda inside: save_as(np.zeros((1, 1, 3), np.uint8), inside / "pressed.png"),
    "saturated": lambda inside: save_as(np.full((120, 160, 3), 255, np.uint8), inside / "pressed.png"),
    "noise": lambda inside: save_as(
        np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8), inside / "pressed.png"
    ),
    "noise at rest": lambda inside: save_as(
        np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8), inside / "rest.png"
    ),
    "PostScript": written("pressed.png", b"%!PS-Adobe-3.0\n%%BoundingBox: 0 0 9 9\n(../outside/executed) (w) file\n"),
    "is endless": linked("pressed.png", "/dev/zero"),
    "is a pipe": piped("pressed.png"),
    "is a folder": as_folder("pressed.png"),
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
    "is endless": linked("body.stl", "/dev/zero"),
    "is a pipe": piped("body.stl"),
    "is a folder": as_folder("body.stl"),
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
    "is a pipe": piped("lens.yaml"),
    "is endless": linked("lens.yaml", "/dev/zero"),
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
