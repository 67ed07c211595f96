"""What this machine can do: the renderer, and the memory for a picture.

Renderers: ``cuda_ad_rgb`` is Mitsuba on an NVIDIA GPU, ``llvm_ad_rgb`` Mitsuba on the processor and
``splat`` a renderer without Mitsuba. Mitsuba on the processor needs a system libLLVM of version 19
or later; with LLVM 15 or 16 it aborts the process, which no ``except`` can catch. So each library
is tried once in a process of its own, and the verdict is stored with its path, size and time.

Memory: a scene may have 8192 x 8192 pixels, which take 9 GB, and four times as much through a wide
pupil. Linux ends a process that takes more memory than there is without any message, so the need is
estimated before a picture is computed. Measured on pictures of 9 and 17 million pixels with
tracking: 127 to 144 bytes a pixel through a point, 577 through a pupil.
"""

from __future__ import annotations

import glob
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from twin.errors import InputError, MissingCapability
from twin.files import cache_folder, kept_if_possible, write_whole
from twin.parts.camera import DISC_WEIGHTS
from twin.parts.scene import Scene

FORCE = "TWIN_VARIANT"
LIBRARY = "DRJIT_LIBLLVM_PATH"
DRIVER = "DRJIT_LIBCUDA_PATH"
VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb", "splat")
OLDEST = 19
REMEDY = (
    "install LLVM 19 or later (Debian, Ubuntu: apt install libllvm19), or set DRJIT_LIBLLVM_PATH "
    "to its library"
)

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

DRIVERS = (
    "/usr/lib/*/libcuda.so.1",
    "/usr/lib64/libcuda.so.1",
    "/usr/lib/libcuda.so.1",
    "/usr/lib/wsl/lib/libcuda.so.1",
    "/usr/local/nvidia/lib64/libcuda.so.1",
    "C:/Windows/System32/nvcuda.dll",
)

_UNTRIED = "could not be tried"
_CRASHED = "Mitsuba on it ends with code"

PROBE = """
import ctypes, os, sys
library, oldest, variant = sys.argv[1:]
number = 0
if variant == "llvm_ad_rgb":
    try:
        report = ctypes.CDLL(library).LLVMGetVersion
    except (OSError, AttributeError):
        print("bad")
        sys.exit()
    numbers = [ctypes.c_uint() for _ in range(3)]
    report(*map(ctypes.byref, numbers))
    number = numbers[0].value
    if number < int(oldest):
        print("old", number)
        sys.exit()
    os.environ["DRJIT_LIBLLVM_PATH"] = library
import mitsuba
mitsuba.set_variant(variant)
marker = mitsuba.TensorXf([0, 0, 0, 1, 1, 1, 0, 0, 0, 1], (1, 10))
shape = {"type": "ellipsoids", "data": marker, "extent": 1.0}
scene = mitsuba.load_dict({"type": "scene", "one": shape})
ray = mitsuba.Ray3f(mitsuba.Point3f(0, 0, 5), mitsuba.Vector3f(0, 0, -1))
total = mitsuba.Float([1, 2, 3]) * 2
good = sum(total) == 12 and abs(scene.ray_intersect_preliminary(ray, True).t[0] - 4) < 1e-3
print("good" if good else "wrong", number)
"""

RAYS_BYTES = 63
"""Bytes a pixel of rays, light and shares, for each point of the pupil and for its middle."""

_LIGHT_BYTES = 75
"""Bytes a pixel while the picture is rendered, exposed and tracked."""

MEMORY_FILES = Path("/proc/meminfo"), Path("/sys/fs/cgroup/memory.max")
"""Files in which Linux states the free memory, and the limit of a container."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A usable way of rendering.

    Attributes
    ----------
    name
        Mitsuba's ``llvm_ad_rgb`` or ``cuda_ad_rgb``, or ``splat``.
    library
        The libLLVM it uses, if any.
    reason
        One line: why this one, and how to get a faster one if there is.
    """

    name: str
    library: str | None
    reason: str

    @staticmethod
    def choose(force: str | None = None, candidates: Iterable[str] | None = None) -> Variant:
        """Choose how to render: Mitsuba on a GPU, else with LLVM, else ``splat``; prepare the
        environment for it.

        Parameters
        ----------
        force
            A variant's name; None: ``$TWIN_VARIANT``, or the best.
        candidates
            libLLVM files to consider; None: ``$DRJIT_LIBLLVM_PATH``, then the usual places, newest
            first.

        Raises
        ------
        InputError
            ``$TWIN_VARIANT`` names no variant.
        MissingCapability
            A variant of Mitsuba's is forced and no library or GPU for it works.
        """
        name = force or _named_variant()
        if name and not name.endswith("_ad_rgb"):  # no variant of Mitsuba's: it needs nothing here
            return Variant(name=name, library=None, reason=f"{name} was chosen by name")
        if name != "llvm_ad_rgb" and (driver := _working_driver()):
            return Variant(
                name="cuda_ad_rgb", library=None, reason=f"{driver} and Mitsuba on it work"
            )
        if name == "cuda_ad_rgb":
            if (verdict := _try("", name)) != "good":  # Dr.Jit may find another driver
                raise MissingCapability(
                    f"cuda_ad_rgb was chosen by name, but no GPU can be used here ({verdict}): "
                    f"install NVIDIA's driver, set {DRIVER} to its libcuda, or unset {FORCE} for "
                    "the best way that works"
                )
            return Variant(name=name, library=None, reason=f"{name} was chosen by name")
        refused = []
        for library in _libraries() if candidates is None else candidates:
            verdict = _verdict(library)
            if verdict == "good":
                os.environ[LIBRARY] = library
                return Variant(name="llvm_ad_rgb", library=library, reason=f"{library} works")
            refused.append(f"{library}: {verdict}")
        why = f"no libLLVM works ({'; '.join(refused)})" if refused else "there is no libLLVM here"
        if name:
            raise MissingCapability(f"llvm_ad_rgb was chosen by name, but {why}: {REMEDY}")
        return Variant(
            name="splat",
            library=None,
            reason=f"pictures are made without Mitsuba, as {why}: {REMEDY}",
        )

    @staticmethod
    def mitsuba(name: str) -> Any:
        """Return Mitsuba, switched to a variant (others may have turned it), on no more threads
        than this process gives to numba: one in workers."""
        import drjit
        import mitsuba
        from numba import config

        if mitsuba.variant() != name:
            mitsuba.set_variant(name)
        if drjit.thread_count() > config.NUMBA_NUM_THREADS:
            drjit.set_thread_count(config.NUMBA_NUM_THREADS)
        return mitsuba

    @staticmethod
    def check_machine(scene: Scene, at_once: int = 1) -> None:
        """Raise an error if ``at_once`` pictures of the scene can't be made on this machine.

        Raises
        ------
        InputError
            ``$TWIN_VARIANT`` names no variant.
        MissingCapability
            Memory is lacking, with the size and what makes it smaller.
        """
        _named_variant()
        camera = scene.camera
        if camera is None:
            return
        views = 1 if camera.aperture_mm == 0 else 1 + len(DISC_WEIGHTS)
        pixels = camera.width_px * camera.height_px
        needed = at_once * pixels * (_LIGHT_BYTES + views * RAYS_BYTES)
        free = _free_bytes()
        if free is None or needed <= free:
            return
        pupil = ", camera.aperture_mm = 0 (a quarter of it)" if camera.aperture_mm > 0 else ""
        workers = ", fewer --workers" if at_once > 1 else ""
        raise MissingCapability(
            f"camera.width_px = {camera.width_px}, camera.height_px = {camera.height_px}: "
            f"{f'{at_once} pictures at once take' if at_once > 1 else 'a picture takes'} about "
            f"{needed / 1e9:,.1f} GB of memory, of which {free / 1e9:,.1f} GB are free here: take "
            f"fewer pixels{pupil}{workers}, or a machine with more memory"
        )


def _free_bytes() -> int | None:
    """Return the bytes that this process may still take; None where the system has no figure."""
    found = []
    for file in MEMORY_FILES:
        try:
            words = file.read_text().split()
        except OSError:
            continue
        if "MemAvailable:" in words:
            found.append(1024 * int(words[words.index("MemAvailable:") + 1]))
        elif words and words[0].isdigit():
            found.append(int(words[0]))
    if not found and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(found, default=None)


def _named_variant() -> str:
    """Return the variant that ``$TWIN_VARIANT`` names, "" where it is unset."""
    name = os.environ.get(FORCE) or ""
    if name and name not in VARIANTS:
        raise InputError(f"{FORCE} is {name!r}; it must be one of {', '.join(VARIANTS)}, or unset")
    return name


def _working_driver() -> str | None:
    """Return NVIDIA's driver where there is one on which Mitsuba works."""
    named = os.environ.get(DRIVER)
    found = [named] if named else []
    found += [path for place in DRIVERS for path in glob.glob(place)]
    return next((path for path in found if _verdict(path, "cuda_ad_rgb") == "good"), None)


def _libraries() -> Sequence[str]:
    """Return distinct libLLVM files: the one the user named first, then the newest."""
    places = (*_PLACES, str(Path(sys.prefix) / "lib" / "libLLVM*"))
    found = {os.path.realpath(path): path for place in places for path in glob.glob(place)}
    newest = sorted(found.values(), key=_named_version, reverse=True)
    named = os.environ.get(LIBRARY)
    return [*([named] if named else []), *(path for path in newest if path != named)]


def _named_version(path: str) -> int:
    """Return the version in a library's file name, 0 if none."""
    found = re.search(r"libLLVM[-.a-z]*(\d+)", Path(os.path.realpath(path)).name)
    return int(found.group(1)) if found else 0


def _verdict(library: str, variant: str = "llvm_ad_rgb") -> str:
    """Return ``good`` or why a library can't be used, from the store or a child process."""
    if variant == "llvm_ad_rgb" and 0 < _named_version(library) < OLDEST:
        return f"older than {OLDEST}"
    try:
        facts = os.stat(library)
    except OSError as problem:
        return problem.strerror or "unreadable"
    programs = (version("mitsuba"), version("drjit"), sys.version[:6])
    key = "|".join([library, str(facts.st_size), str(facts.st_mtime_ns), *programs])
    store = cache_folder() / "llvm.json"
    known = _stored(store)
    if key in known:
        return known[key]
    verdict = _try(library, variant)
    if verdict.startswith(_CRASHED):
        # A child may also end because something outside stopped it: stored only if it repeats.
        verdict = _try(library, variant)
    if not verdict.startswith(_UNTRIED):
        with kept_if_possible():
            write_whole(store, json.dumps({**_stored(store), key: verdict}, indent=1).encode())
    return verdict


def _try(library: str, variant: str) -> str:
    """Load a library, and Mitsuba on it, in a child process."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", PROBE, library, str(OLDEST), variant],
            capture_output=True,
            text=True,
            timeout=120,
        )
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"{_UNTRIED} ({type(problem).__name__})"
    words = child.stdout.split()
    if child.returncode != 0 or not words:
        return f"{_CRASHED} {child.returncode}"
    verdicts = {
        "good": "good",
        "wrong": "Mitsuba on it computes wrongly",
        "old": f"version {words[-1]} is older than {OLDEST}",
        "bad": "not a library of LLVM 16 or later",
    }
    return verdicts[words[0]]


def _stored(store: Path) -> dict[str, str]:
    try:
        known = json.loads(store.read_text())
    except (OSError, ValueError):
        return {}
    return {str(k): str(v) for k, v in known.items()} if isinstance(known, dict) else {}
