"""Ways to make a file hostile: each takes what it needs and returns a `Spoil`, which does it to a reader's folder."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Spoil = Callable[[Path], object]


class Evil:
    """Unpickled, it would write a file beside the folder that it lies in."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.system, ("touch ../outside/executed",))


def npz_with(name: str, key: str, array: Any) -> Spoil:
    """Replace an array of an npz file."""

    def spoil(inside: Path) -> None:
        with np.load(inside / name) as old:
            arrays = {k: old[k] for k in old.files}
        np.savez(inside / name, **{**arrays, key: array})

    return spoil


def npz_pickle(name: str, key: str) -> Spoil:
    def spoil(inside: Path) -> None:
        with np.load(inside / name) as old:
            arrays = {k: old[k] for k in old.files}
        arrays[key] = np.array([Evil()], dtype=object)
        np.savez(inside / name, allow_pickle=True, **arrays)

    return spoil


def bare_pickle(name: str) -> Spoil:
    import pickle

    return lambda inside: (inside / name).write_bytes(pickle.dumps(Evil()))


def npz_bomb(name: str, key: str) -> Spoil:
    """Replace an array by 16 GB of zeros, which deflate to 16 MB."""

    def spoil(inside: Path) -> None:
        head = npy_header((2 * 10**9,))
        with (
            zipfile.ZipFile(inside / name, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
            archive.open(f"{key}.npy", "w", force_zip64=True) as member,
        ):
            member.write(head)
            for _ in range(1600):
                member.write(bytes(10**7))

    return spoil


def npz_lying(name: str, key: str, shape: tuple[int, ...]) -> Spoil:
    """Replace an array by one whose header claims a shape that isn't there."""

    def spoil(inside: Path) -> None:
        with zipfile.ZipFile(inside / name) as old:
            members = {n: old.read(n) for n in old.namelist()}
        members[f"{key}.npy"] = npy_header(shape) + bytes(80)
        with zipfile.ZipFile(inside / name, "w") as new:
            for n, data in members.items():
                new.writestr(n, data)

    return spoil


def npz_member(name: str, member: str) -> Spoil:
    """Add a member whose name leads out of the folder."""

    def spoil(inside: Path) -> None:
        with zipfile.ZipFile(inside / name, "a") as archive:
            archive.writestr(member, npy_header((1,)) + bytes(8))

    return spoil


def npy_header(shape: tuple[int, ...]) -> bytes:
    """Return the head of a .npy file of float64."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


def linked(name: str, to: str) -> Spoil:
    def spoil(inside: Path) -> None:
        path = inside / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.symlink_to(to)

    return spoil


def piped(name: str) -> Spoil:
    def spoil(inside: Path) -> None:
        (inside / name).unlink()
        os.mkfifo(inside / name)

    return spoil


def as_folder(name: str) -> Spoil:
    def spoil(inside: Path) -> None:
        (inside / name).unlink()
        (inside / name).mkdir()

    return spoil


def swept_rows(rows: bytes) -> Spoil:
    def spoil(inside: Path) -> None:
        (inside / "swept").mkdir()
        (inside / "swept" / "rows.jsonl").write_bytes(rows)

    return spoil


def written(name: str, text: str | bytes) -> Spoil:
    data = text.encode() if isinstance(text, str) else text
    return lambda inside: (inside / name).write_bytes(data)


def appended(name: str, text: str) -> Spoil:
    return lambda inside: (inside / name).write_text((inside / name).read_text() + text)


def replaced(name: str, old: str, new: str) -> Spoil:
    return lambda inside: (inside / name).write_text((inside / name).read_text().replace(old, new))


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


def shard(table: Callable[[Any], Any]) -> Spoil:
    """Rewrite a sample file of the dataset, and its checksums."""

    def spoil(inside: Path) -> None:
        import pyarrow.parquet as pq

        path = next((inside / "data" / "data").glob("*.parquet"))
        pq.write_table(table(pq.read_table(path)), path)
        _resum(inside)

    return spoil


def _resum(inside: Path) -> None:
    from twin.study.dataset.finish import write_sums
    from twin.study.dataset.plan import Places

    write_sums(Places(inside / "data"))


def info_changed(change: Callable[[dict[str, Any]], object]) -> Spoil:
    def spoil(inside: Path) -> None:
        path = inside / "data" / "meta" / "info.json"
        told = json.loads(path.read_text())
        change(told)
        path.write_text(json.dumps(told))
        _resum(inside)

    return spoil


def bad_shard(inside: Path) -> None:
    path = next((inside / "data" / "data").glob("*.parquet"))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3] + data[len(data) // 2 :])
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
