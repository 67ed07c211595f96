"""The options that commands share, and their scene and output name."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, Token

from twin.errors import InputError, RecipeError

if TYPE_CHECKING:
    from twin.parts.scene import Scene
    from twin.study.batch.pool import Scheduler


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number; the command line's library would round others without a word."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"'{tokens[0].value}' is no whole number") from None


Whole = Annotated[int, Parameter(converter=_whole)]
SceneName = Annotated[
    str, Parameter(help="Path of a scene file, or the name of a shipped scene (see: twin scenes).")
]
Overrides = Annotated[
    tuple[str, ...],
    Parameter(
        name=["-s", "--set"],
        help="Override any scene key: -s material.poisson_ratio=0.49",
        show_default=False,
        negative_iterable="",
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Batch:
    """Options of the commands that compute many samples or designs."""

    out: Annotated[Path | None, Parameter(help="Folder of the results (default out/<name>).")] = (
        None
    )
    workers: Annotated[
        Whole | None,
        Parameter(help="Processes on this machine (default: its cores, fewer for small jobs)."),
    ] = None
    scheduler: Annotated[
        str | None,
        Parameter(
            help="dask scheduler whose workers are used: tcp://host:8786, or tls:// with the "
            "files below. Without TLS whoever reaches it can run code as you."
        ),
    ] = None
    tls_ca: Annotated[
        Path | None,
        Parameter(help="PEM file of the authority that signed the cluster's certificates."),
    ] = None
    tls_cert: Annotated[
        Path | None, Parameter(help="PEM file of a certificate for this process.")
    ] = None
    tls_key: Annotated[Path | None, Parameter(help="PEM file of that certificate's key.")] = None
    dry_run: Annotated[
        bool, Parameter(help="Only print the job's size and the time it takes.", negative="")
    ] = False

    def workers_and_scheduler(self) -> tuple[int, Scheduler | None]:
        """Return the number of processes, and the scheduler; None without an address.

        Raises
        ------
        InputError
            No process, TLS files without an address, or only some of them.
        """
        count = self.workers if self.workers is not None else len(os.sched_getaffinity(0))
        if count < 1:
            raise InputError(f"--workers {count}: give at least 1")
        if self.scheduler is None:
            if self.tls_ca or self.tls_cert or self.tls_key:
                raise InputError("--tls-ca, --tls-cert and --tls-key belong to --scheduler")
            return count, None
        from twin.study.batch.pool import Scheduler

        return count, Scheduler(
            address=self.scheduler, ca=self.tls_ca, cert=self.tls_cert, key=self.tls_key
        )


LONGEST = 80
"""Characters of the overrides in a name."""


def load(scene: str, overrides: Sequence[str]) -> Scene:
    """Return a scene with ``key.path=value`` overrides."""
    from twin.study.recipe import load_scene, parse_override

    return load_scene(scene, dict(parse_override(text) for text in overrides))


@contextmanager
def scene_named(scene: str) -> Iterator[None]:
    """Begin the messages of recipe errors, which know "this scene" only, with its name."""
    try:
        yield
    except RecipeError as problem:
        if problem.where is not None:
            raise
        raise RecipeError(problem.problems, scene) from None


def file_name(scene: Path, overrides: Sequence[str]) -> str:
    """Return a name, without suffix, for output of a scene: other overrides, another name.

    Characters that file systems or shells treat specially become ``_``, with a hash of the whole
    at the end.
    """
    if not overrides:
        return scene.stem
    whole = ",".join(overrides)
    plain = re.sub(r"[^A-Za-z0-9_.=,+-]+", "_", whole)[:LONGEST]
    if plain != whole:
        plain = f"{plain}-{hashlib.sha256(whole.encode()).hexdigest()[:8]}"
    return f"{scene.stem},{plain}"
