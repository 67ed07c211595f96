"""The number of threads of numeric libraries: one for BLAS, unless ``TWIN_THREADS`` gives another.

Why one: the products here are small, and OpenBLAS's idle threads spin while they wait for the next
one. On an idle machine a second thread gains nothing; with four busy processes on two cores ``twin
run kamiyama_pillar`` took 7.6 s of CPU time with OpenBLAS's own choice and 3.2 s with one thread,
calibration and reconstruction 24 s of the clock and 4 s. Sums are also the same whatever the
machine's cores.

``TWIN_THREADS``, or ``--threads`` of any command, limits all libraries: BLAS for small and large
products alike, and numba, which else takes every core for pictures. Workers always take one.

A command sets the environment before numpy is loaded, and its processes inherit it
(`set_environment`). A program that imports this package keeps its own threads outside of the
package's functions (`one_blas_thread`).
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from twin.errors import InputError

THREADS = "TWIN_THREADS"
_BLAS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that BLAS libraries read when they are loaded."""

_NUMBA = "NUMBA_NUM_THREADS"

_lock = threading.Lock()
_limits: list[Any] = []
"""Limits in force, the oldest first; they hold for the whole process."""

_inside = {"calls": 0}
"""Calls of `one_blas_thread` that have not ended, in all threads."""


def _chosen() -> int | None:
    """Return the number of threads in ``TWIN_THREADS``; None without."""
    text = os.environ.get(THREADS)
    if not text:
        return None
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise InputError(f"{THREADS} (--threads) = '{text}': allowed are whole numbers 1 to 1024")
    return int(text)


def set_environment() -> None:
    """Set the threads of libraries that are loaded later, here and in child processes.

    What the user has set for a library stays, unless ``TWIN_THREADS`` is set.

    Raises
    ------
    InputError
        ``TWIN_THREADS`` is no number of threads.
    """
    chosen = _chosen()
    for name in _BLAS:
        os.environ.setdefault(name, "1")
    if chosen is not None:
        os.environ.update(dict.fromkeys((*_BLAS, _NUMBA), str(chosen)))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread (or ``TWIN_THREADS``), also as a decorator.

    The caller's number is restored when the last of nested calls ends. The first takes about .01
    ms, the others nothing.
    """
    with _lock:
        if _inside["calls"] == 0:
            _limit()
        _inside["calls"] += 1
    try:
        yield
    finally:
        with _lock:
            _inside["calls"] -= 1
            while _limits and _inside["calls"] == 0:
                library, number = _limits.pop()
                library.set_num_threads(number)


def _limit() -> None:
    """Limit the libraries, and note how many threads they had."""
    number = _chosen() or 1
    for library in _libraries().lib_controllers:
        _limits.append((library, library.num_threads))
        library.set_num_threads(number)


def hold_new_library() -> None:
    """Limit a BLAS library that was loaded inside of `one_blas_thread`, too."""
    _libraries.cache_clear()
    with _lock:
        if _inside["calls"]:
            _limit()


@cache
def _libraries() -> Any:
    """Return the BLAS libraries of this process; finding them takes a millisecond."""
    import scipy.linalg  # noqa: F401  scipy has a library of its own next to numpy's
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit every numeric library to one thread, in child processes, too.

    For processes that run together, and where last digits must not depend on the number of cores.
    """
    names = (*_BLAS, _NUMBA, THREADS)
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        with one_blas_thread():
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
