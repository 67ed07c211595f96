"""Which way of rendering this machine can go, found out without ever risking the process.

``cuda_ad_rgb`` is taken where NVIDIA's driver is and Mitsuba on it meets a marker where it stands; it runs the same
code as ``llvm_ad_rgb``, and no machine with a GPU was at hand to measure it. ``llvm_ad_rgb`` is the fast one of every
other machine. It needs a system libLLVM of version 19 or later that Dr.Jit loads by name: without one
it fails politely, but with LLVM 15 or 16 it aborts the process, which no ``except`` can catch. So every candidate is
tried in a process of its own, once, and the verdict is remembered with the library's path, size and time. Where none
works, ``splat`` gives the same pictures without Mitsuba (`twin.world.picture.splat`). ``scalar_rgb`` is Mitsuba on any
machine, a ray at a time, for comparison.
"""

from __future__ import annotations

import glob
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from twin.errors import InputError, MissingCapability
from twin.places import cache_folder

FORCE = "TWIN_VARIANT"
LIBRARY = "DRJIT_LIBLLVM_PATH"
DRIVER = "DRJIT_LIBCUDA_PATH"
VARIANTS = ("llvm_ad_rgb", "scalar_rgb", "cuda_ad_rgb", "splat")
OLDEST = 19
REMEDY = "install LLVM 19 or later (Debian, Ubuntu: apt install libllvm19), or set DRJIT_LIBLLVM_PATH to its library"

_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/llvm*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
)

_DRIVERS = (
    "/usr/lib/*/libcuda.so.1",
    "/usr/lib64/libcuda.so.1",
    "/usr/lib/libcuda.so.1",
    "/usr/lib/wsl/lib/libcuda.so.1",
    "/usr/local/nvidia/lib64/libcuda.so.1",
    "C:/Windows/System32/nvcuda.dll",
)

_UNTRIED = "could not be tried"

_TRIAL = """
mitsuba.set_variant(sys.argv[3])
marker = mitsuba.TensorXf([0, 0, 0, 1, 1, 1, 0, 0, 0, 1], (1, 10))
scene = mitsuba.load_dict({"type": "scene", "one": {"type": "ellipsoids", "data": marker, "extent": 1.0}})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, 5), mitsuba.Vector3f(0, 0, -1))
total = mitsuba.Float([1, 2, 3]) * 2
good = sum(total) == 12 and abs(scene.ray_intersect_preliminary(ray, True).t[0] - 4) < 1e-3
print("good" if good else "wrong", *version)
"""

_PROBE_CUDA = (
    """
import sys
import mitsuba
version = []
"""
    + _TRIAL
)

_PROBE = (
    """
import ctypes, os, sys
try:
    library = ctypes.CDLL(sys.argv[1])
    report = library.LLVMGetVersion
except (OSError, AttributeError) as problem:
    print("bad", type(problem).__name__); sys.exit()
numbers = [ctypes.c_uint() for _ in range(3)]
report(*map(ctypes.byref, numbers))
if numbers[0].value < int(sys.argv[2]):
    print("old", numbers[0].value); sys.exit()
os.environ["DRJIT_LIBLLVM_PATH"] = sys.argv[1]
import mitsuba
version = [numbers[0].value]
"""
    + _TRIAL
)


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A usable way of rendering.

    Attributes
    ----------
    name
        Mitsuba's ``llvm_ad_rgb``, ``scalar_rgb`` or ``cuda_ad_rgb``, or our ``splat``.
    library
        The libLLVM it uses, if any.
    reason
        One line: why this one, and how to get a faster one if there is.
    """

    name: str
    library: str | None
    reason: str


def forced_variant() -> str:
    """Return the variant that ``$TWIN_VARIANT`` names, "" where it is unset.

    Raises
    ------
    InputError
        It names none.
    """
    name = os.environ.get(FORCE) or ""
    if name and name not in VARIANTS:
        raise InputError(f"{FORCE} is {name!r}; it must be one of {', '.join(VARIANTS)}, or unset")
    return name


def choose_variant(force: str | None = None, candidates: Iterable[str] | None = None) -> Variant:
    """Choose how to render: Mitsuba on a GPU, else with LLVM, else ``splat``; prepare the environment for it.

    Parameters
    ----------
    force
        A variant's name; None: ``$TWIN_VARIANT``, or the best.
    candidates
        libLLVM files to consider; None: ``$DRJIT_LIBLLVM_PATH``, then the usual places, newest first.

    Raises
    ------
    InputError
        An unknown variant is forced.
    MissingCapability
        ``llvm_ad_rgb`` is forced and no library for it works, or ``cuda_ad_rgb`` and there is no GPU that does.
    """
    name = force or forced_variant()
    if name and name not in VARIANTS:
        raise InputError(f"{name!r} is no way of rendering: it must be one of {', '.join(VARIANTS)}")
    if name in ("scalar_rgb", "splat"):
        return Variant(name=name, library=None, reason=f"{name} was asked for")
    if name != "llvm_ad_rgb" and (driver := _working_driver()):
        return Variant(name="cuda_ad_rgb", library=None, reason=f"{driver} and Mitsuba on it work")
    if name == "cuda_ad_rgb":
        if (verdict := _try("", name)) != "good":  # Dr.Jit may know of another driver than we do
            raise MissingCapability(
                f"cuda_ad_rgb was asked for, but no GPU can be used here ({verdict}): install NVIDIA's driver, set "
                f"{DRIVER} to its libcuda, or unset {FORCE} for the best way that works"
            )
        return Variant(name=name, library=None, reason=f"{name} was asked for")
    refused = []
    for library in _libraries() if candidates is None else candidates:
        verdict = _verdict(library)
        if verdict == "good":
            os.environ[LIBRARY] = library
            return Variant(name="llvm_ad_rgb", library=library, reason=f"{library} works")
        refused.append(f"{library}: {verdict}")
    why = f"no libLLVM works ({'; '.join(refused)})" if refused else "there is no libLLVM here"
    if name:
        raise MissingCapability(f"llvm_ad_rgb was asked for, but {why}: {REMEDY}")
    return Variant(name="splat", library=None, reason=f"pictures are made without Mitsuba, as {why}: {REMEDY}")


def _working_driver() -> str | None:
    """Return NVIDIA's driver where there is one on which Mitsuba works."""
    found = [*filter(None, [os.environ.get(DRIVER)]), *(path for place in _DRIVERS for path in glob.glob(place))]
    return next((path for path in found if _verdict(path, "cuda_ad_rgb") == "good"), None)


def _libraries() -> Sequence[str]:
    """Return distinct libLLVM files, the one the user named first, then newest first."""
    places = (*_PLACES, str(Path(sys.prefix) / "lib" / "libLLVM*"))
    found = {os.path.realpath(path): path for place in places for path in glob.glob(place)}
    newest = sorted(found.values(), key=_named_version, reverse=True)
    named = os.environ.get(LIBRARY)
    return [*([named] if named else []), *(path for path in newest if path != named)]


def _named_version(path: str) -> int:
    """Return the version that a library's name tells, 0 if none."""
    told = re.search(r"libLLVM[-.a-z]*(\d+)", Path(os.path.realpath(path)).name)
    return int(told.group(1)) if told else 0


def _verdict(library: str, variant: str = "llvm_ad_rgb") -> str:
    """Return ``good`` or why a library can't be used; tried in a child process once and remembered."""
    if variant == "llvm_ad_rgb" and 0 < _named_version(library) < OLDEST:
        return f"older than {OLDEST}"
    try:
        facts = os.stat(library)
    except OSError as problem:
        return problem.strerror or "unreadable"
    key = "|".join(
        [library, str(facts.st_size), str(facts.st_mtime_ns), version("mitsuba"), version("drjit"), sys.version[:6]]
    )
    memory = cache_folder() / "llvm.json"
    known = _remembered(memory)
    if key not in known:
        verdict = _try(library, variant)
        if verdict.startswith(_UNTRIED):
            return verdict
        _remember(memory, {**_remembered(memory), key: verdict})
        return verdict
    return known[key]


def _try(library: str, variant: str = "llvm_ad_rgb") -> str:
    """Load a library, and Mitsuba on it, in a child process."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", _PROBE if variant == "llvm_ad_rgb" else _PROBE_CUDA, library, str(OLDEST), variant],
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"{_UNTRIED} ({type(problem).__name__})"
    told = child.stdout.split()
    if child.returncode != 0 or not told:
        return f"Mitsuba on it ends with code {child.returncode}"
    if told[0] == "good":
        return "good"
    if told[0] == "wrong":
        return "Mitsuba on it computes wrongly"
    return f"version {told[1]} is older than {OLDEST}" if told[0] == "old" else "not a library of LLVM 16 or later"


def _remembered(memory: Path) -> dict[str, str]:
    try:
        known = json.loads(memory.read_text())
    except (OSError, ValueError):
        return {}
    return {str(k): str(v) for k, v in known.items()} if isinstance(known, dict) else {}


def _remember(memory: Path, known: dict[str, str]) -> None:
    """Write the verdicts by renaming, so that another process never reads half a file; a full disk is no error."""
    try:
        with tempfile.NamedTemporaryFile("w", dir=memory.parent, suffix=".tmp", delete=False) as file:
            json.dump(known, file, indent=1)
        os.replace(file.name, memory)
    except OSError:
        return
