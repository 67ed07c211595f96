"""numba's compiled code, kept only as long as all that it was made of.

Why: numba freezes constants and helpers of other modules into a function's machine code, but looks only at the
function's own file to tell whether the code that it kept is still good. Whoever updated the package went on computing
with a helper as it was, without a word. Here kept code is good for the contents of a module and of every module of the
package that it imports: nothing is compiled again for changes elsewhere, in a copy, or for a new date.

Compiled code divides as NumPy does: by 0 it is inf or NaN, which every result is asked for. numba's own default raises
a ZeroDivisionError as Python does, from inside a loop that can't say which of a recipe's numbers was too small.

What may add up in any order (``fastmath``) becomes a part of whatever calls it. Left apart, the caller's own copy of it
and the one compiled by itself are optimised differently, and which of the two answers depends on whether this process
compiled them or found them kept: first runs and later ones differed in their last digits.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
from numba.core import event

TOLD_AFTER_S = 1.0
"""Seconds of compiling after which a terminal is told what takes so long."""

_PACKAGE = os.path.dirname(os.path.abspath(__file__))
_IMPORTS = re.compile(r"^\s*(?:from|import) +twin([\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


def njit(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return ``numba.njit(**options)`` whose kept code is made anew when any module that it may have used has changed.

    Parameters
    ----------
    **options
        numba's own; ``error_model`` is "numpy" where not said otherwise, ``forceinline`` on wherever ``fastmath`` is.
    """
    options = {"error_model": "numpy", "forceinline": bool(options.get("fastmath")), **options}

    def made(function: Callable[..., Any]) -> Any:
        compiled = numba.njit(**options)(function)
        try:
            kept = compiled._cache._cache_file
            kept._source_stamp = (kept._source_stamp, digest(function.__code__.co_filename))
        except (AttributeError, OSError):  # another numba, or no source: rather keep nothing than what may be stale
            compiled = numba.njit(**{**options, "cache": False})(function)
        return compiled

    return made


@cache
def digest(file: str) -> str:
    """Return a digest of a module and of all modules of the package that it imports, directly or not."""
    return hashlib.sha256(b"".join(_read(each)[0] for each in sorted(sources(file)))).hexdigest()


def sources(file: str) -> set[str]:
    """Return the files of a module and of all modules of the package that it imports, directly or not."""
    found, new = set[str](), {file}
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


class Told(event.Listener):  # type: ignore[misc]
    """Tells a terminal, once a process, that the package is being compiled."""

    def __init__(self) -> None:
        self._spent_s, self._since, self._depth = 0.0, 0.0, 0

    def on_start(self, event: event.Event) -> None:
        """Start the clock, unless it runs for the function that calls this one."""
        if self._depth == 0:
            self._since = time.perf_counter()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """Stop the clock, and tell when much has been spent."""
        self._depth -= 1
        if self._depth or not str(event.data["dispatcher"].py_func.__module__).startswith("twin."):
            return
        before, self._spent_s = self._spent_s, self._spent_s + time.perf_counter() - self._since
        if before < TOLD_AFTER_S <= self._spent_s and sys.stderr.isatty():
            print("twin: compiling, once after an install or an update: about a minute in all", file=sys.stderr)


event.register("numba:compile", Told())
