"""One writer at a time: an operating system's lock on a file, which dies with its owner however that ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from twin.errors import InputError


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold the lock on ``path`` (an empty file, there as long as it is held) while the block runs.

    Raises
    ------
    InputError
        Another process holds it, or the file can't be made.
    """
    handle = _opened(path)
    try:
        yield
    finally:
        with suppress(OSError):  # Windows removes no open file
            path.unlink()
        os.close(handle)


def _opened(path: Path) -> int:
    """Return the locked file; one that its holder has just removed is no lock, and is made anew."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except OSError as problem:
            raise InputError(f"{path}: can't be written ({problem.strerror}); give another --out") from None
        try:
            _lock(handle)
        except OSError:
            os.close(handle)
            raise InputError(
                f"{path.parent}: another process is writing here; wait for it, stop it, or give another --out"
            ) from None
        with suppress(OSError):
            if os.path.samestat(os.fstat(handle), os.lstat(path)):
                return handle
        os.close(handle)


def _lock(handle: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
