"""Where files are (shipped ones, cache), and how files are written and read.

Every file is written under a temporary name and then renamed (`write_whole`), so that after a kill
or on a full disk it is either complete or absent. `read_arrays` reads an npz file without executing
anything in it, and limits the memory before it reads.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import os
import re
import shutil
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from twin.errors import InputError, TwinError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from twin.arrays import Picture

ROOT = Path(__file__).resolve().parent.parent
_INSIDE = Path(__file__).resolve().parent
_SHIPPED = _INSIDE if (_INSIDE / "meshes").is_dir() else ROOT
MESHES = _SHIPPED / "meshes"
SCENES = _SHIPPED / "scenes"
"""Inside an installed package, or next to the package in a checkout."""

LARGEST_BYTES = 2_000_000_000
"""Largest unpacked size of an npz file; this program's own files are a hundredth of it."""

LARGEST_PX = 50_000_000
"""Largest number of pixels of a picture that is read."""

_unkept: list[str] = []
"""Why the cache can't be written, once it is known."""


@cache
def cache_folder() -> Path:
    """Return a writable cache folder: ``$TWIN_CACHE``, else the platform's, else a temporary one
    with a warning."""
    import platformdirs

    named = os.environ.get("TWIN_CACHE")
    candidate = Path(named) if named else Path(platformdirs.user_cache_dir("twin"))
    try:
        candidate.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=candidate):
            return candidate
    except OSError as problem:
        print(
            f"twin: the cache {candidate} can't be written ({problem.strerror}); using a temporary "
            "one. Set TWIN_CACHE to a writable folder to keep results between runs.",
            file=sys.stderr,
        )
    temporary = Path(tempfile.mkdtemp(prefix="twin-cache-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


@contextmanager
def kept_if_possible() -> Iterator[None]:
    """Write to the cache within this: a failure costs time only, and is printed once."""
    try:
        yield
    except (OSError, TwinError) as problem:
        if not _unkept:
            reason = str(problem).partition("; files")[0]
            print(
                f"twin: {reason}, so results are computed again in the next run. Make room, or "
                "set TWIN_CACHE to another folder.",
                file=sys.stderr,
            )
            _unkept.append(reason)


class _Pinned:
    """The ``folder`` that meshes and tables are taken from alone; None for none."""

    folder: Path | None = None

    @contextmanager
    def to(self, folder: Path) -> Iterator[None]:
        """Take meshes and tables from ``folder`` alone within this, and make none.

        Why: making a mesh is not deterministic, so a job with reproducible results carries its
        mesh.
        """
        before, self.folder = self.folder, folder
        try:
            yield
        finally:
            self.folder = before


PINNED = _Pinned()


_FILE_ENDINGS = (
    ".csv",
    ".h5",
    ".hdf5",
    ".html",
    ".json",
    ".mp4",
    ".npz",
    ".parquet",
    ".png",
    ".toml",
)
"""Endings that no new folder of results gets."""


def make_folder(folder: Path, results: Sequence[str] = ()) -> None:
    """Make ``folder``, check that it is writable, and remove partial files of killed writers.

    Where it can't be made or written, or is named like a file, an `InputError` is raised; so it is
    where it holds a dataset, or any of the ``results`` that will be written, but not the first, by
    which a folder of such results is known.
    """
    if folder.suffix.lower() in _FILE_ENDINGS and not folder.exists():
        raise InputError(
            f"{folder}: the output is a folder, and {folder.suffix} a file's ending: leave it out "
            "(twin export writes a dataset as files)"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(
            f"{folder}: the output folder can't be made, as there is a file of that name; give "
            "another"
        ) from None
    except OSError as problem:
        raise TwinError.unwritable(folder, problem) from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: the output folder can't be written; give another")
    if results and (folder / "meta" / "info.json").exists():
        raise InputError(
            f"{folder}: holds a dataset, and other results would mix with it; give another --out"
        )
    there = [name for name in results if (folder / name).exists()]
    if there and results[0] not in there:
        raise InputError(
            f"{folder}: holds {', '.join(there)}, which would be replaced, but no {results[0]}, so "
            "they are of something else; give another --out"
        )
    for part in folder.glob(".*.part*"):  # a video's ends in its format
        named = re.fullmatch(r".*\.(\d+)\.part(\.\w+)?", part.name)
        if named and not _is_alive(int(named[1])):
            part.unlink(missing_ok=True)


@contextmanager
def temporary_folder(name: str) -> Iterator[Path]:
    """Make a temporary folder for the block, and remove those of killed processes of this name."""
    place = Path(tempfile.gettempdir())
    for old in place.glob(f"{name}-*-*"):
        process = old.name.removeprefix(f"{name}-").partition("-")[0]
        if process.isdecimal() and not _is_alive(int(process)):
            shutil.rmtree(old, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=f"{name}-{os.getpid()}-") as made:
        yield Path(made)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's process, or no process number
        pass
    return True


def write_whole(
    path: Path, content: bytes | Callable[[IO[bytes]], object], *, first: bool = False
) -> None:
    """Write a file so that it is either whole or absent.

    Parameters
    ----------
    path
        Name of the file.
    content
        Its bytes, or a function that writes them into an open file.
    first
        Keep a file of this name that another process has written meanwhile.

    Raises
    ------
    TwinError
        See `TwinError.unwritable`.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if not (first and _linked(part, path)):
            os.replace(part, path)
    except OSError as problem:
        raise TwinError.unwritable(path, problem) from None
    finally:
        with contextlib.suppress(OSError):  # without a folder there is no partial file
            part.unlink(missing_ok=True)


def _linked(part: Path, path: Path) -> bool:
    """Name a file unless the name is taken; False where the file system has no links."""
    try:
        os.link(part, path)
    except FileExistsError:
        return True
    except OSError:
        return False
    return True


def write_json(path: Path, table: Mapping[str, Any]) -> None:
    """Write a JSON file; a number that is not finite becomes null."""
    write_whole(path, json.dumps(plain(table), indent=2).encode())


Fact = tuple[str, dict[str, Any]]
"""A line that a command prints, and the record that it shows."""


def fact(name: str, text: str, values: Mapping[str, Any] | None = None, mark: str = "") -> Fact:
    """Return what a command found, as a line and a record with ``values``: numbers by keys that end
    with the unit; ``{key}`` stands for one in the text, which begins at a column, or behind
    ``mark``."""
    found = text.format_map(values) if values else text
    line = f"{name}{mark}{found}" if mark else f"{name:11s} {found}"
    return line, {"name": name.strip(), "found": found, **(values or {})}


def plain(value: Any) -> Any:
    """Return tables, lists, arrays and numbers as JSON holds them; None for one not finite."""
    import numpy as np

    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def read_arrays(
    path: str | os.PathLike[str], names: Iterable[str] | None = None
) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of an npz file by name: all, or those of ``names`` that it holds.

    Raises
    ------
    OSError
        There is no such file, or it can't be opened.
    ValueError
        It is damaged, holds objects, or unpacks to more than `LARGEST_BYTES`.

    Notes
    -----
    A zip file lists the unpacked size of its members, and its reader unpacks no more than that; so
    the sum is checked before anything is read.
    """
    import numpy as np

    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe would wait
        raise ValueError("it is no file")
    # opened here, because numpy leaves a broken zip file's handle to the garbage collector
    with open(path, "rb") as stream:
        try:
            with zipfile.ZipFile(stream) as listed:
                size = sum(member.file_size for member in listed.infolist())
            if size > LARGEST_BYTES:
                raise ValueError(f"it unpacks to {size:,} bytes; allowed are {LARGEST_BYTES:,}")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                wanted = archive.files if names is None else set(names) & set(archive.files)
                return {name: archive[name] for name in wanted}
        except Exception as problem:  # damaged archives raise a dozen different ones
            raise ValueError(str(problem) or type(problem).__name__) from None


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's contents, hexadecimal; a file may be larger than memory."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def png_bytes(picture: Picture) -> bytes:
    """Return a picture, (height, width, 3) or grey (height, width) uint8 or uint16, as a PNG file
    (W3C, PNG 3rd edition).

    Notes
    -----
    Noise does not compress: a better filter or a higher level gains a few per cent for many times
    the time. So lines are stored unfiltered and packed by libdeflate at its level 1 (4.4 ms for
    640 x 480 against 10 by zlib and 21 by Pillow), always to the same bytes. ISA-L takes 2.2 ms,
    but its bytes differed once in some hundred pictures.
    """
    import deflate
    import numpy as np

    is_grey = picture.ndim == 2
    if (not is_grey and picture.shape[2:] != (3,)) or picture.dtype not in (np.uint8, np.uint16):
        raise InputError(
            "a picture must be (height, width, 3) or (height, width) uint8 or uint16, got "
            f"{picture.shape} {picture.dtype}"
        )
    height, width = picture.shape[:2]
    bits = 8 * picture.dtype.itemsize
    row = picture.reshape(height, -1)
    if bits == 16:
        row = row.astype(">u2").view(np.uint8)
    lines = np.zeros((height, 1 + row.shape[1]), np.uint8)
    lines[:, 1:] = row
    head = struct.pack(">IIBBBBB", width, height, bits, 0 if is_grey else 2, 0, 0, 0)
    packed = deflate.zlib_compress(lines.tobytes(), 1)
    return _png(head, packed)


def picture_of_png(data: bytes) -> Picture | None:
    """Return the (height, width, channels) uint16 picture in the bytes of a PNG file whose header
    is whole, None of one of fewer bits: Pillow reads colours as 8 bits. Pixels that are
    damaged, of which VTK would crash, raise a `ValueError`.

    Notes
    -----
    Lines without a filter, as `png_bytes` stores them, are the pixels as they are.
    """
    if data[24:25] != b"\x10":
        return None
    import numpy as np

    width, height, _, kind, _, _, woven = struct.unpack(">IIBBBBB", data[16:29])
    packed = []
    start = 8
    while start + 8 <= len(data):
        (length,) = struct.unpack(">I", data[start : start + 4])
        if data[start + 4 : start + 8] == b"IDAT":
            packed.append(data[start + 8 : start + 8 + length])
        start += 12 + length
    # Each pass of an interlaced picture is stored as a picture of its own.
    picture = np.empty((height, width, _PNG_CHANNELS.get(kind, 0)), np.uint16)
    passes = _WOVEN if woven else ((0, 0, 1, 1),)
    parts = [picture[row::down, column::along] for row, column, down, along in passes]
    parts = [part for part in parts if part.size]
    size = sum(len(part) * (1 + 2 * part[0].size) for part in parts)
    try:
        whole = b"".join(packed)
        pixels = zlib.decompressobj().decompress(whole, size + 1)
    except zlib.error as problem:
        raise ValueError(problem) from None
    if len(pixels) != size:
        raise ValueError(f"{len(pixels)} bytes of pixels instead of {size}")
    at = 0
    for part in parts:
        lines = np.frombuffer(pixels, np.uint8, len(part) * (1 + 2 * part[0].size), at)
        at += len(lines)
        if woven:
            whole = zlib.compress(lines.tobytes(), 0)
        part[:] = _without_filters(lines.reshape(len(part), -1), kind, whole).reshape(part.shape)
    return picture


def _without_filters(lines: NDArray[np.uint8], kind: int, packed: bytes) -> NDArray[np.uint16]:
    """Return the numbers in (height, bytes) lines of a PNG of 16 bits; ``packed`` are the lines."""
    import numpy as np

    types = lines[:, 0]
    if types.max() > 4:
        raise ValueError(f"a line has filter type {types.max()}; there are 0 to 4")
    if not types.any():
        return lines[:, 1:].copy().view(">u2")
    from vtkmodules.vtkIOCore import vtkMemoryResourceStream
    from vtkmodules.vtkIOImage import vtkPNGReader

    # A file of these lines alone: of the one that is read anything might end libpng.
    width = lines.shape[1] // (2 * _PNG_CHANNELS[kind])
    head = struct.pack(">IIBBBBB", width, len(lines), 16, kind, 0, 0, 0)
    clean = _png(head, packed)
    stream, reader = vtkMemoryResourceStream(), vtkPNGReader()
    stream.SetBuffer(clean, len(clean))
    reader.SetStream(stream)
    reader.Update()
    values = np.asarray(reader.GetOutput().GetPointData().GetScalars(), np.uint16)
    return values.reshape(len(lines), -1)[::-1]


_PNG_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
"""Channels by a PNG's kind of colour."""

_WOVEN = (
    (0, 0, 8, 8),
    (0, 4, 8, 8),
    (4, 0, 8, 4),
    (0, 2, 4, 4),
    (2, 0, 4, 2),
    (0, 1, 2, 2),
    (1, 0, 2, 1),
)
"""First row and column of each pass of an interlaced PNG, and the steps from row to row and from
column to column."""


def _png(head: bytes, packed: bytes) -> bytes:
    """Return a PNG file of its header's content and its compressed lines."""
    file = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in ((b"IHDR", head), (b"IDAT", packed), (b"IEND", b"")):
        checksum = zlib.crc32(data, zlib.crc32(kind))
        file += [struct.pack(">I", len(data)), kind, data, struct.pack(">I", checksum)]
    return b"".join(file)
