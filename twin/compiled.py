"""Compiled functions whose stored machine code is valid only for the source that it was made from.

numba compiles constants and helpers of other modules into a function, but checks only the
function's own file before it reuses stored code. Here stored code is valid for the contents of a
module and of every module of the package that it imports. This replaces the source stamp of numba's
cache file, a private attribute: a cache folder for each state of the package would compile all
functions again after every changed line. If a later numba has no such attribute, nothing is stored.

numba numbers the files of a function's code in the order of its signatures, so that two processes
that store different ones at once would take the same number. So a file is named by its signature,
too. A file that is cut short is made again.

A division by 0 gives inf or NaN as in NumPy, and every result is checked for these. numba's default
raises ZeroDivisionError inside a loop, which can't report the recipe's number that was too small.

Functions with ``fastmath`` are inlined into their callers: optimised alone and in the caller they
differ in their last digits, and so did first and later runs.
"""

from __future__ import annotations

import gc
import hashlib
import multiprocessing
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any

import numba
import numpy as np
from numba import config
from numba.core import event

SHOWN_AFTER_S = 1.0
"""Seconds of compiling after which a line on stderr names what takes so long."""

_PACKAGE = os.path.dirname(os.path.abspath(__file__))
_IMPORTS = re.compile(
    r"^\s*(?:from|import) +twin([\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE
)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return ``numba.njit(**options)`` that compiles again when a module it may use has changed.

    Parameters
    ----------
    **options
        numba's own; ``error_model`` is "numpy" where not said otherwise, ``forceinline`` on
        wherever ``fastmath`` is, and ``nogil`` on: other threads of Python go on.
    """
    options = {
        "error_model": "numpy",
        "nogil": True,
        "forceinline": bool(options.get("fastmath")),
        "no_cfunc_wrapper": True,  # only C code that is handed a function needs it
        **options,
    }

    def made(function: Callable[..., Any]) -> Any:
        compiled = numba.njit(**options)(function)
        try:
            kept = compiled._cache._cache_file
            kept._source_stamp = (kept._source_stamp, digest(function.__code__.co_filename))
            kept._load_index = partial(_unless_damaged, kept._load_index, dict)
            kept.load = partial(_unless_damaged, kept.load, lambda: None)
            kept.save = partial(_save, kept, kept.save, kept._data_name_pattern)
        except (AttributeError, OSError):  # another numba, or no source: store nothing
            compiled = numba.njit(**{**options, "cache": False})(function)
        return compiled

    return made


def _save(
    kept: Any, save: Callable[[Any, Any], None], pattern: str, key: tuple[Any, ...], data: Any
) -> None:
    """Store code under a name that holds a hash of its signature, ``key[0]``, unless the disk is
    full."""
    signature = hashlib.sha256(str(key[0]).encode()).hexdigest()[:8]
    kept._data_name_pattern = pattern.replace("{number", f"{signature}.{{number")
    with suppress(OSError):
        save(key, data)


def _unless_damaged(read: Callable[..., Any], absent: Callable[[], Any], *key: Any) -> Any:
    """Return what is stored, or a new ``absent`` where its file is cut short."""
    try:
        return read(*key)
    except Exception:  # a pickle that is cut short raises any of them
        return absent()


@cache
def digest(file: str) -> str:
    """Return a digest of a module and of all modules of the package that it imports, directly or
    not."""
    return hashlib.sha256(b"".join(_read(each)[0] for each in sorted(sources(file)))).hexdigest()


def sources(file: str) -> set[str]:
    """Return the files of a module and of all modules of the package that it imports, directly or
    not."""
    found = set[str]()
    new = {file}
    while new:
        found |= new
        new = {each for path in new for each in _read(path)[1]} - found
    return found


@cache
def _read(file: str) -> tuple[bytes, set[str]]:
    """Return the digest of a file, and the files of the package's modules that its imports name."""
    with open(file, "rb") as opened:
        source = opened.read()
    named = set[str]()
    for module, names in _IMPORTS.findall(source.decode()):
        place = _PACKAGE + module.replace(".", os.sep)
        inside = [os.path.join(place, name) for name in ["__init__", *re.findall(r"\w+", names)]]
        named |= {f"{each}.py" for each in (inside if os.path.isdir(place) else [place])}
    return hashlib.sha256(source).digest(), {each for each in named if os.path.isfile(each)}


class _Compiling(event.Listener):  # type: ignore[misc]
    """Watches numba compile: holds the garbage collector, and prints a line on stderr.

    A compilation makes millions of objects that live until its end; walking them takes a sixth of
    its time. The line is printed once; workers print nothing.

    Attributes
    ----------
    spent_s
        Seconds that this process has compiled the program's own functions.
    """

    def __init__(self) -> None:
        self._ahead = ""
        self._second: subprocess.Popen[bytes] | None = None
        self._collects = False
        self.spent_s = 0.0
        self._since = 0.0
        self._depth = 0
        self._printed = False

    def on_start(self, event: event.Event) -> None:
        """Start the clock, unless it runs for the function that calls this one."""
        if self._depth == 0:
            self._since = time.perf_counter()
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """Stop the clock, and print the line when much has been spent, also on a function that is
        not done yet."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()
        if not str(event.data["dispatcher"].py_func.__module__).startswith("twin."):
            return
        spent = self.spent_s + time.perf_counter() - self._since
        if self._depth == 0:
            self.spent_s = spent
        if self._printed or spent < SHOWN_AFTER_S:
            return
        self._printed = True
        if sys.stderr is not None and multiprocessing.parent_process() is None:
            line = "twin: compiling, once after an install or an update: about half a minute in all"
            print(line, file=sys.stderr, flush=True)
        if self._ahead and config.NUMBA_NUM_THREADS > 1:
            silent = subprocess.DEVNULL
            command = [sys.executable, "-m", self._ahead]
            self._second = subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent)

    def wait_for_second(self) -> None:
        """Wait until the second process has stored what it compiles, if there is one."""
        if self._second is not None:
            self._second.wait()
        self._ahead = ""

    @contextmanager
    def compiled_ahead(self, module: str) -> Iterator[None]:
        """Within the block, have a second process run a module ("" for none) once compiling takes
        long, so that its compiled code is stored when this process needs it."""
        self._ahead = module
        try:
            yield
        finally:
            if self._second is not None:
                self._second.kill()
            self.wait_for_second()
            self._second = None


COMPILING = _Compiling()
event.register("numba:compile", COMPILING)


_PARTS = 8
"""Number of ranges into which work is cut, whatever the number of threads."""


def in_parts(count: int, work: Callable[[int, int, int], Any]) -> list[Any]:
    """Call ``work(part, begin, end)`` on `_PARTS` ranges of 0 to ``count``; return the results in
    order."""
    edges = np.linspace(0, count, _PARTS + 1).astype(int).tolist()
    threads = max(int(config.NUMBA_NUM_THREADS), 1)
    if threads == 1:
        return [work(part, edges[part], edges[part + 1]) for part in range(_PARTS)]
    return list(_pool(threads, os.getpid()).map(work, range(_PARTS), edges[:-1], edges[1:]))


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Return the thread pool of this process: a forked process needs its own."""
    return ThreadPoolExecutor(threads, thread_name_prefix=f"twin-{process}")
