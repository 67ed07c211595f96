"""`twin run`: one press through the whole twin."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import Overrides, SceneName, Whole, load, progress
from twin.errors import InputError, did_you_mean

WANTED = ("displacement", "picture", "tracking", "forces", "score", "report")


def run(
    scene: SceneName,
    *,
    out: Annotated[Path | None, Parameter(help="Folder for the results (default out/<scene>).")] = None,
    want: Annotated[
        tuple[str, ...], Parameter(help="What to compute (default all).", show_default=False, negative_iterable="")
    ] = (),
    live: Annotated[
        bool, Parameter(help="Move the probe by hand in a page on this machine instead.", negative="")
    ] = False,
    port: Annotated[
        Whole, Parameter(help="Port of the live page (default: any that is free).", show_default=False)
    ] = 0,
    set_: Overrides = (),
) -> None:
    """Take one press through the whole twin.

    What can be wanted: displacement, picture, tracking, forces, score, report; several, separated by commas. Only
    what is wanted, and what it needs, is computed; unwanted files are absent. Where a step of the press after
    the first is refused or doesn't converge, what belongs to the step before is saved, and the exit code is 3.

    With --live nothing is written: a page opens at the address that is printed, where keys, sliders or the pointer move
    and load the scene's probe, and picture and force field follow, with their errors. It listens on this machine only.
    Fewer contact patches and coarser pictures than the scene's are used unless -s says otherwise.

    Examples:
    twin run kamiyama_pillar
    twin run my_scene.toml -s press.force_n='{z=2}' --out out/two
    twin run sato_press --want displacement
    twin run kamiyama_pillar --live
    """
    if live:
        _live(scene, out, want, port, set_)
        return
    if port:
        raise InputError("--port: belongs to --live")
    from twin.study.recipe import find_scene
    from twin.study.run_folder import run_to_folder

    wanted = _wanted(want)
    path = find_scene(scene)
    loaded = load(scene, set_)
    folder = out or Path("out") / path.stem
    summary = run_to_folder(loaded, folder, wanted, progress=progress())
    print(summary)


def _live(scene: str, out: Path | None, want: Sequence[str], port: int, set_: Sequence[str]) -> None:
    from twin.study.live import QUICK, run_live

    if out is not None or want:
        raise InputError("--live writes nothing and shows all there is: leave out --out and --want")
    run_live(load(scene, (*QUICK, *set_)), port, progress())


def _wanted(names: Sequence[str]) -> frozenset[str]:
    given = [part.strip() for name in names for part in name.split(",") if part.strip()]
    for name in given:
        if name not in WANTED:
            hint = did_you_mean(name, WANTED, f"allowed are {', '.join(WANTED)}")
            raise InputError(f"--want {name}: unknown; {hint}")
    if names and not given:
        raise InputError(f"--want names nothing: give any of {', '.join(WANTED)}, or leave it out for all")
    return frozenset(given or WANTED)
