"""Reading STL files, binary or text, without trusting them.

Why not a library: an STL file is a claim. A file of 200 bytes may declare four thousand million triangles, hold numbers
that are none, or end in the middle, and readers are known to return an empty scene for it without a word. So the size
is compared with the declared count before anything is read, and everything that is read is checked.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError

MOST_TRIANGLES = 400_000
"""Triangles in a file at most: a body's smooth field sees no more detail than a few thousand."""

_HEADER, _RECORD = 84, 50
_MOST_TEXT_BYTES = 400 * MOST_TRIANGLES
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")


def read_triangles(path: Path) -> Floats:
    """Return the (m, 3, 3) corners of every triangle of an STL file, in the file's unit (mm for this program).

    Raises
    ------
    InputError
        The file is missing, truncated, longer than it says, too large, no STL, or its numbers are not finite.
    """
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            head = file.read(_HEADER)
            count = int.from_bytes(head[80:84], "little") if len(head) == _HEADER else 0
            text = _is_text(head, size, count)
            if not text:
                _refuse_wrong_size(path, head, size, count)
            elif size > _MOST_TEXT_BYTES:
                raise InputError(
                    f"{path.name}: {size} bytes of text (allowed: {_MOST_TEXT_BYTES}); export it as binary, or coarser"
                )
            data = head + file.read(_MOST_TEXT_BYTES)
    except OSError as problem:
        raise InputError(f"{path.name}: can't be read ({problem.strerror}); check the path") from None
    corners = _from_text(path, data) if text else _from_binary(data, count)
    _refuse_count(path, len(corners))
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{path.name}: {int(bad.sum())} of {len(corners)} triangles have corners that are not finite, the first is "
            f"number {first}; export the file anew"
        )
    return corners


def _is_text(head: bytes, size: int, count: int) -> bool:
    """Tell a text file; binary ones may start with the word solid too, so a size that fits a binary file decides."""
    return size != _HEADER + _RECORD * count and head.lstrip()[:5].lower() == b"solid" and b"\0" not in head


def _refuse_wrong_size(path: Path, head: bytes, size: int, count: int) -> None:
    if len(head) < _HEADER:
        raise InputError(f"{path.name}: {size} bytes are no STL file (allowed: at least {_HEADER}); export it anew")
    wanted = _HEADER + _RECORD * count
    if size != wanted:
        raise InputError(
            f"{path.name}: declares {count} triangles, which take {wanted} bytes, but has {size}; the file is "
            "truncated or no STL: export it anew"
        )
    _refuse_count(path, count)


def _refuse_count(path: Path, count: int) -> None:
    if not 4 <= count <= MOST_TRIANGLES:
        raise InputError(
            f"{path.name}: {count} triangles (allowed: 4 to {MOST_TRIANGLES}); export the whole body"
            + (", coarser" if count > 4 else "")
        )


def _from_binary(data: bytes, count: int) -> Floats:
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, record, count, _HEADER)["corners"].astype(np.float64)


def _from_text(path: Path, data: bytes) -> Floats:
    found = _VERTEX.findall(data)
    facets = len(re.findall(rb"\bendfacet\b", data))
    if len(found) != 3 * facets or not re.search(rb"\bendsolid\b", data):
        raise InputError(
            f"{path.name}: {len(found)} corners for {facets} whole triangles"
            f"{'' if re.search(rb'endsolid', data) else ' and no endsolid'}; the text is truncated or no STL: "
            "export it anew"
        )
    try:
        return np.array([[float(number) for number in corner] for corner in found], np.float64).reshape(-1, 3, 3)
    except ValueError as problem:
        raise InputError(f"{path.name}: a corner is no number ({problem}); export it anew") from None
