"""npz files, read so that no file can do harm: nothing is executed, and memory is bounded before it is taken."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

LARGEST_BYTES = 2_000_000_000
"""Largest size of all arrays together, unpacked; the largest of this program's own are a hundredth of it."""

UNREADABLE = (
    OSError, ValueError, EOFError, KeyError, TypeError, AttributeError, NotImplementedError, RuntimeError, MemoryError,
    RecursionError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What numpy and zipfile raise on damaged archives."""


def read_arrays(path: str | os.PathLike[str], names: Iterable[str] | None = None) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of an npz file by name: all, or those that are named and there.

    Raises
    ------
    OSError
        There is no such file, or it can't be opened.
    ValueError
        It is damaged, holds objects, or unpacks to more than `LARGEST_BYTES`.

    Notes
    -----
    A zip file tells the unpacked size of its members, and its reader unpacks no more than that; so the sum can be
    judged before anything is read.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe would be waited for
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
                wanted = archive.files if names is None else [name for name in names if name in archive.files]
                return {name: archive[name] for name in wanted}
        except UNREADABLE as problem:
            raise ValueError(str(problem) or type(problem).__name__) from None
