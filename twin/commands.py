"""The commands of `twin`, a function each: arguments in, one call into `twin.study` or `twin.show`,
lines and records out.

A command yields what it has to say as it comes: a line, or a line (which may be empty) with the
record that it shows. `twin.cli` prints the lines, or both as JSON. Every decision lives elsewhere.
Heavy packages are imported inside the functions, so that ``twin --help`` prints at once.
"""

from __future__ import annotations

import gc
import hashlib
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from cyclopts import Parameter, Token

from twin.errors import InputError, MissingCapability, SomeFailed
from twin.files import fact
from twin.parts.methods import WANTED, Method, WeightRule
from twin.study.new_scene import Pad

if TYPE_CHECKING:
    from twin.arrays import Progress
    from twin.parts.scene import Scene
    from twin.study.batch.pool import Pool


_Output = Iterator[str | tuple[str, Mapping[str, Any]]]

PAGES = (".html", ".htm")

MOST_SAMPLES = 1_000_000_000
"""Years of work, and a plan that still fits into memory."""

LONGEST = 80
"""Characters of the overrides in the name of output."""


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
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _Batch:
    """Options of the commands that compute many samples or designs.

    Attributes
    ----------
    out
        Folder of the results (default out/<name>).
    workers
        Processes on this machine (default: its cores, fewer for small jobs).
    scheduler
        dask scheduler whose workers are used: tcp://host:8786, or tls:// with the files below.
        Without TLS whoever reaches it can run code as you.
    tls_ca
        PEM file of the authority that signed the cluster's certificates.
    tls_cert
        PEM file of a certificate for this process.
    tls_key
        PEM file of that certificate's key.
    dry_run
        Only print the job's size and the time it takes.
    """

    out: Path | None = None
    workers: Whole | None = None
    scheduler: str | None = None
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    dry_run: bool = False

    def workers_and_scheduler(self) -> tuple[int, Pool.Scheduler | None]:
        """Return the number of processes, at least one, and the scheduler; None without an
        address."""
        count = self.workers if self.workers is not None else len(os.sched_getaffinity(0))
        if count < 1:
            raise InputError(f"--workers {count}: give at least 1")
        if self.scheduler is None:
            if self.tls_ca or self.tls_cert or self.tls_key:
                raise InputError("--tls-ca, --tls-cert and --tls-key belong to --scheduler")
            return count, None
        from twin.study.batch.pool import Pool

        return count, Pool.Scheduler(
            address=self.scheduler, ca=self.tls_ca, cert=self.tls_cert, key=self.tls_key
        )


def _progress() -> Progress | None:
    """Return a function that shows (what, share done), or None where stderr is not a terminal."""
    shown = sys.__stderr__  # --json collects what else is printed there
    if shown is None or not shown.isatty():
        return None
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    console = Console(file=shown)
    bar = Bar(*columns, TimeRemainingColumn(), console=console, transient=True)
    task = bar.add_task("starting", total=1.0)
    bar.start()

    def show(what: str, share: float) -> None:
        bar.update(task, description=what, completed=share)
        if share >= 1.0:
            bar.stop()

    return show


def _load(scene: str, overrides: Sequence[str]) -> Scene:
    """Return a scene with ``key.path=value`` overrides."""
    from twin.study.recipe import load_scene, parse_overrides

    return load_scene(scene, parse_overrides(overrides))


def _file_name(scene: Path, overrides: Sequence[str]) -> str:
    """Return a name for output of a scene, without suffix: other overrides, another name.
    Characters that are special to file systems or shells become ``_``, and a hash is added."""
    if not overrides:
        return scene.stem
    whole = ",".join(overrides)
    plain = re.sub(r"[^A-Za-z0-9_.=,+-]+", "_", whole)[:LONGEST]
    if plain != whole:
        plain = f"{plain}-{hashlib.sha256(whole.encode()).hexdigest()[:8]}"
    return f"{scene.stem},{plain}"


def run(
    scene: SceneName,
    *,
    out: Path | None = None,
    want: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    live: bool = False,
    film: bool = False,
    h264: bool = False,
    open_: Annotated[bool, Parameter(name="--open")] = False,
    port: Annotated[Whole, Parameter(show_default=False)] = 0,
    set_: Overrides = (),
) -> _Output:
    """Compute one press through the whole twin.

    --want takes any of displacement, picture, tracking, forces, score, report, separated by commas.
    Only these, and what they need, are computed; other files are absent. Where a step of the press
    after the first has no equilibrium or doesn't converge, the results of the step before are
    saved, and the exit code is 3; so it is where the pictures give no motion or no forces.

    With --live nothing is written: a page opens at the address that is printed, where keys, sliders
    or the pointer move and load the scene's probe, and picture and force field follow, with their
    errors. It listens on this machine only. Fewer contact patches and coarser pictures than the
    scene's are the default.

    With --film the folder (default out/<scene>/film) gets frames/000000.png and so on, rest.png (or
    a folder rest with one for each group of LEDs in light.lit), and truth.npz: of every frame time,
    force, contact, slip of every patch, and markers' places.
    With --h264 frames.mp4 holds the frames (pip install imageio-ffmpeg). twin reconstruct reads
    both. After Ctrl-C or a kill the same command goes on, to the same bytes.

    Parameters
    ----------
    out
        Folder for the results (default out/<scene>, with the overrides behind the name).
    want
        What to compute (default all).
    live
        Move the probe by hand in a page on this machine instead.
    film
        Film the press's steps instead, at ccd.frames_per_second.
    h264
        Film as a video, frames.mp4, not as PNG files.
    open_
        Open the report in the browser.
    port
        Port of the live page (default: any that is free).

    Examples:
    twin run kamiyama_pillar
    twin run kamiyama_pillar -s press.force_n='{z=2}' --out out/two
    twin run sato_press --want displacement
    twin run gelpad_press --open
    twin run kamiyama_pillar --live
    twin run gelpad_slide --film
    """
    if film and (live or want or open_):
        raise InputError("--film has pictures and their truth only: leave out other options")
    if h264 and not film:
        raise InputError("--h264: belongs to --film")
    if live:
        if out is not None or want or open_:
            raise InputError(
                "--live writes nothing and shows all there is: leave out --out, --want and --open"
            )
        from twin.study.live import QUICK, run_live
        from twin.study.recipe import load_scene, parse_overrides

        run_live(load_scene(scene, QUICK | parse_overrides(set_)), port, _progress())
        return
    if port:
        raise InputError("--port: belongs to --live")
    # Loading the libraries makes a million objects that all stay: looking for garbage among them
    # takes a twentieth of a run.
    gc.set_threshold(10_000, 50, 10)
    from twin.study.recipe import find_scene

    wanted = _listed("--want", want, f"any of {', '.join(WANTED)}") or WANTED
    path = find_scene(scene)
    loaded = _load(scene, set_)
    folder = out or Path("out") / _file_name(path, set_)
    if film:
        from twin.study.film import film_to_folder

        folder = out or folder / "film"
        yield film_to_folder(loaded, folder, _progress(), h264=h264), {"folder": str(folder)}
        return
    from twin.results import RunResult
    from twin.study.run import run_to_folder

    if open_ and "report" not in wanted:
        raise InputError("--open: --want leaves the report out; add report to it")
    try:
        text = run_to_folder(loaded, folder, wanted, progress=_progress())
    except SomeFailed:
        yield "", RunResult.on_disk(folder)
        raise
    yield text, RunResult.on_disk(folder)
    if open_:
        import webbrowser

        page = folder / "report.html"
        if not webbrowser.open(page.resolve().as_uri()):
            print(f"twin: no browser found here; open {page} yourself", file=sys.stderr)


def explain(
    path: Path,
    /,
) -> _Output:
    """Print what each number of a run means, with its unit and a verdict.

    The verdicts good, fair and poor are this program's own scale; each stands with the limit of
    good.

    Parameters
    ----------
    path
        score.json of a run, or the run's folder.

    Examples:
    twin explain out/kamiyama_pillar/score.json
    twin explain out/gelpad_press --json
    """
    from twin.results import RunResult
    from twin.show.explain import explain as findings_of

    found = findings_of(*RunResult.scored(path))
    if not found:
        raise InputError(f"{path}: holds no number of a run; compute one with --want score")
    yield from ((one.line(), asdict(one)) for one in found)


def _listed(option: str, given: Sequence[str], known: str) -> list[str]:
    """Return what an option names, separated by commas or given again."""
    names = [part.strip() for name in given for part in name.split(",") if part.strip()]
    if given and not names:
        raise InputError(f"{option} names nothing: give {known}, or leave it out for all")
    return names


def mesh(
    scene: SceneName,
    *,
    rebuild: bool = False,
    export: Path | None = None,
    set_: Overrides = (),
) -> _Output:
    """Show the meshes of a scene's body, or make them again.

    Parameters
    ----------
    rebuild
        Make the meshes again, even if shipped or cached.
    export
        Write the truth's mesh as .vtu for other programs.

    Examples:
    twin mesh sato_press
    twin mesh sato_press --export finger.vtu
    """
    from twin.world.mesh.body_mesh import body_mesh
    from twin.world.mesh.quality import Quality
    from twin.world.mesh.sizing import Level

    body = _load(scene, set_).body
    progress = _progress()
    levels: tuple[Level, ...] = ("standard", "nominal")  # others are made on request
    for level in levels:
        made = body_mesh(body, level, rebuild=rebuild, progress=progress)
        if export is not None and level == "standard":
            made.export(body, export)
        worst = Quality.of(made, body)
        failures = worst.failures()
        record = {
            "level": level,
            "tetrahedra": len(made.tets),
            "nodes": len(made.points),
            "unknowns": made.unknowns,
            "least_dihedral_deg": worst.least_dihedral_deg,
            "failures": failures,
        }
        text = "{level:8s} {tetrahedra} tetrahedra, {nodes} nodes, {unknowns} unknowns; "
        good = "smallest dihedral angle {least_dihedral_deg:.1f} deg, volume and surface ok"
        text += "; ".join(failures) or good
        yield text.format(**record), record
    if progress is not None:
        progress("done", 1.0)


_Layers = Annotated[
    tuple[float, ...],
    Parameter(
        help="Of the dots, mm; two numbers for two layers.",
        show_default=False,
        consume_multiple=1,
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _Pad(Pad):
    depth_mm: _Layers = ()
    pitch_mm: _Layers = ()
    diameter_mm: _Layers = ()
    resolution: tuple[Whole, Whole] = (640, 480)


def scenes(
    *,
    new: Path | None = None,
    pad: _Pad = _Pad(),
) -> _Output:
    """List the shipped scenes, or write a recipe of your own sensor.

    --new NAME writes NAME.toml: a soft pad on a plate, dots near its surface, a camera behind. The
    other options are numbers that a maker knows; what is left out follows from the size.

    Parameters
    ----------
    new
        Write a recipe of this name (.toml).

    Examples:
    twin scenes
    twin scenes --new mine
    twin scenes --new mine --size-mm 30 20 5 --modulus-mpa 0.15 --pitch-mm 1.5 --fov-deg 60
    """
    if new is not None:
        file, lines = pad.write(new)
        yield lines[0], {"file": str(file)}
        yield from lines[1:]
        return
    if pad != _Pad():
        given = next(each.name for each in fields(pad) if getattr(pad, each.name) != each.default)
        raise InputError(f"--{given.replace('_', '-')} belongs to a new recipe: give --new NAME")
    from twin.study.recipe import load_scene, shipped_scenes

    for name, path in shipped_scenes().items():
        title = load_scene(name).title
        yield f"{name:20s} {title}", {"name": name, "title": title, "path": str(path)}


def check(
    file: str,
    second: Path | None = None,
    /,
    *,
    scene: str | None = None,
    camera: bool = False,
    set_: Overrides = (),
) -> _Output:
    """Check a file or a folder and print everything that is wrong with it.

    Two rest pictures of a sensor and its scene: print noise, saturation, blur, compression, the
    errors of shifts and forces to expect, and whether the camera is good enough.

    Parameters
    ----------
    file
        Scene or sweep file, calibration (.npz), OpenCV's camera file (.yaml, .json), result folder
        or dataset; or a rest picture.
    second
        Another rest picture: is this camera good enough?
    scene
        The pictures' sensor: a scene (path or shipped name).
    camera
        Measure the scene's camera chip by EMVA 1288, and compare what it states.

    Examples:
    twin check gelpad_press -s material.poisson_ratio=0.45
    twin check out/kamiyama_pillar
    twin check gelpad_press --camera
    twin check rest1.png rest2.png --scene mine.toml
    twin check camera.yaml
    """
    if (second is None) != (scene is None):
        raise InputError(
            "two rest pictures and --scene belong together: twin check rest1.png rest2.png --scene "
            "SCENE"
        )
    if second is not None and scene is not None:
        from twin.study.check import check_camera

        yield from check_camera(Path(file), second, _load(scene, set_))
        return
    if camera:
        from twin.study.photon_transfer import photon_transfer

        ccd = _load(file, set_).ccd
        yield from photon_transfer(ccd).facts(ccd)
        return
    from twin.study.check import check_path
    from twin.study.recipe import parse_overrides

    yield from check_path(file, parse_overrides(set_))


def doctor() -> _Output:
    """Print what is installed, which Mitsuba variant and solver are used, and where the caches are.

    Exit code 4 if the main job can't run on this machine.
    """
    from twin.study.check import examine

    facts, missing = examine()
    yield from (fact(*each) for each in facts.items())
    if missing:
        raise MissingCapability("the main job can't run: " + "; ".join(missing))


def view(
    path: str,
    *,
    out: Path | None = None,
    set_: Overrides = (),
) -> _Output:
    """Write a page that shows a body under its press and turns in the browser, without a server.

    The body is deformed, with its marker layers, tractions, and which patches stick or slip; every
    step of the press's path is a frame. Drag to turn, wheel to come nearer.

    An --out that ends in .gif, .png or .mp4 (H.264; pip install imageio-ffmpeg) is a film instead:
    what the camera sees along the path.

    Of a dataset it shows a sheet of samples, with the truth drawn in; of an STL file the surface,
    on which a click picks a face and gives the lines of a recipe that hold it or press it.

    Parameters
    ----------
    path
        A scene (path or shipped name), a run's or dataset's folder, or an STL.
    out
        Page to write (default: view.html in the run's folder; SCENE.html or DATASET.html here), or
        a film: .gif, .png or .mp4.

    Examples:
    twin view kamiyama_shear
    twin view pad.stl
    twin view out/kamiyama_pillar
    twin view kamiyama_shear --out shear.gif
    """

    # A dataset has a page of its own, and so has a surface.
    folder = Path(path)
    is_dataset = (folder / "meta" / "info.json").is_file()
    is_surface = folder.suffix.lower() == ".stl"
    if is_dataset:
        from twin.study.dataset.reader import DatasetReader

        page = out or Path(f"{folder.name or 'dataset'}.html")
        yield DatasetReader(folder).write_sheet(page), {"file": str(page)}
        return
    from twin.files import make_folder, write_whole
    from twin.study.film import FILMS, write_film
    from twin.study.recipe import find_scene
    from twin.study.sensor import Sensor
    from twin.study.view import body_view, surface_view

    if is_surface:
        page = out or Path(f"{folder.stem}.html")
        if page.suffix.lower() not in PAGES:
            raise InputError(f"{path}: an STL file gives a page, --out NAME.html")
        if set_:
            raise InputError(f"{path}: -s belongs to a scene; a surface has no keys")
        write_whole(page, surface_view(folder).page().encode())
        line = f"written to {page}; open it in a browser and click what is pressed or held"
        yield line, {"file": str(page)}
        return
    # The page of a run goes into the run's folder, that of a scene into the current one.
    if folder.is_dir():
        if not (folder / "scene.toml").is_file():
            raise InputError(
                f"{path}: holds neither scene.toml (of a run) nor meta/info.json (of a dataset)"
            )
        path, page = str(folder / "scene.toml"), out or folder / "view.html"
    else:
        page = out or Path(f"{_file_name(find_scene(path), set_)}.html")
    if page.suffix.lower() not in {*PAGES, *FILMS}:
        raise InputError(
            f"--out {page}: allowed are .html for a page, {', '.join(FILMS)} for a film"
        )
    # Write the page or the film.
    scene = _load(path, set_)
    bar = _progress()
    sensor = Sensor(scene, bar)
    make_folder(page.parent)
    if page.suffix.lower() in FILMS:
        line = write_film(sensor, page)
    else:
        write_whole(page, body_view(sensor).page().encode())
        line = f"written to {page}; open it in a browser"
    yield line, {"file": str(page)}
    if bar is not None:
        bar("done", 1.0)


def calibrate(
    folder: Path | None = None,
    /,
    *,
    scene: SceneName | None = None,
    out: Path | None = None,
    method: Literal["sato", "fitted", "compliance", "halfspace"] | None = None,
    layout_from: Path | None = None,
    overlay: Path | None = None,
    pitch_mm: _Layers = (),
    depth_mm: _Layers = (),
    set_: Overrides = (),
) -> _Output:
    """Calibrate a scene's sensor, on the twin or from a recording, and write the calibration file.

    A recording is a folder with rest.png (or .jpg, .bmp), a picture of every press, and presses.csv
    with the columns frame, x_mm, y_mm, z_mm (place on the outer surface), fx_n, fy_n, fz_n (load
    cell), and of rubber that relaxes held_s (how long the press was held before its picture).
    Methods compliance and halfspace need the rest picture only.

    Method sato presses the simulated sensor at every site in three directions, in pictures with
    noise; fitted presses five and fits the design's parameters to them.

    With --layout-from no calibration is made: the markers' grids are found in a rest picture and
    written as the [markers] tables of a recipe, with a picture that shows the dots and their
    numbers. Millimetres come from --pitch-mm (and --depth-mm), or from --scene: then it prints
    which camera gives the drawn pitch, and writes tables only to an --out.

    Parameters
    ----------
    folder
        Recording of a real sensor: rest.png, pictures, presses.csv (else the twin's).
    out
        Calibration file to write (.npz); with --layout-from tables (.toml).
    method
        Default: the scene's.
    layout_from
        Find the markers in this rest picture instead, without a drawing.
    overlay
        Picture of the markers found (.png, with --layout-from).

    Examples:
    twin calibrate --scene gelpad_press --out pad.npz
    twin calibrate recording --scene mine.toml --method fitted --out mine.npz
    twin calibrate --layout-from out/gelpad_press/rest.png --pitch-mm 1.25 --depth-mm 0.5
    """
    if layout_from is not None:
        if folder is not None or method is not None:
            raise InputError(
                "--layout-from makes no calibration: leave the folder and --method out"
            )
        from twin.study.found_layout import layout_to_files

        # A scene has tables already, and its camera's pitch is what is questioned.
        tables = out or (Path("markers.toml") if scene is None else None)
        drawn = overlay or (tables and tables.with_suffix(".png"))
        yield from layout_to_files(
            layout_from,
            tables,
            drawn,
            pitch_mm=pitch_mm,
            depth_mm=depth_mm,
            scene=None if scene is None else _load(scene, set_),
        )
        return
    if overlay is not None or pitch_mm or depth_mm:
        raise InputError("--overlay, --pitch-mm and --depth-mm belong to --layout-from")
    if scene is None:
        raise InputError(
            "--scene is missing: path of a scene file, or the name of a shipped scene (twin scenes)"
        )
    if out is None:
        raise InputError("--out is missing: calibration file to write (.npz)")
    from twin.study.calibrate import calibrate_to_file

    loaded = _load(scene, (*set_, f"calibration.method={method}") if method else set_)
    yield calibrate_to_file(loaded, out, _progress(), folder), {"file": str(out)}


def reconstruct(
    rest: Path,
    frames: Annotated[tuple[str, ...], Parameter(allow_leading_hyphen=True)],
    /,
    *,
    calibration: Path,
    out: Path | None = None,
    overlay: Path | None = None,
    size: str | None = None,
    format: str | None = None,
    method: Method | None = None,
    weight: str | None = None,
    push_only: Annotated[bool | None, Parameter(negative="--no-push-only")] = None,
    friction: float | None = None,
    robust: Annotated[bool | None, Parameter(negative="--no-robust")] = None,
    camera: Annotated[bool | None, Parameter(negative="--no-camera")] = None,
    frames_per_second: float | None = None,
    times: Path | None = None,
) -> _Output:
    """Track the markers of recorded frames and reconstruct the forces.

    Every frame is one row: total force and torque with standard deviations, centre of pressure,
    markers found, the shift that all markers share (a bumped camera), and in .parquet and .npz the
    force at every site. A frame that fails is a row with its reason, and the sequence goes on (exit
    code 3). Standard deviations are of the noise, and of what the tolerances of modulus and focal
    length leave open; other errors of the calibration come on top.

    What isn't given from --method to --frames-per-second is taken from the [reconstruction] table
    of the recipe that was calibrated.

    Parameters
    ----------
    rest
        Picture without load: PNG, BMP or JPEG; or a folder, one for each group of LEDs.
    frames
        Pictures, folders of them, videos; or - for raw frames from stdin.
    calibration
        Calibration file (see: twin calibrate).
    out
        Table to write: .parquet, .csv (totals only) or .npz.
    overlay
        Draw the motion into the frames: a .png, a folder of them, or a video (.mp4).
    size
        Size of raw frames: 640x480.
    format
        Format of raw frames: rgb24 or gray8.
    method
        How it is solved; local: forces only where some are found.
    weight
        The papers' omega, px2/N2, or auto, likelihood, gcv.
    push_only
        No site pulls; or they may, without bounds.
    friction
        Friction coefficient that bounds every site's force.
    robust
        Leave wrong vectors out.
    camera
        Follow the camera's bend (needed for large motion).
    frames_per_second
        Rate of the frames: forces of rubber that relaxes (0: each frame by itself).
    times
        Instead: a CSV file with the columns frame, time_s.

    Examples:
    twin reconstruct out/gelpad_press/rest.png out/gelpad_press/pressed.png --calibration pad.npz
    twin reconstruct rest.png press*.png --calibration mine.npz --out forces.parquet
    twin reconstruct rest.png film.mp4 --calibration mine.npz --overlay drawn.mp4
    ... | twin reconstruct rest.png - --size 640x480 --format rgb24 --calibration mine.npz
    """
    from twin.study.recorded import reconstruct_recording

    yield from reconstruct_recording(
        rest,
        frames,
        calibration,
        out=out,
        overlay=overlay,
        size=size,
        layout=format,
        method=method,
        weight=None if weight is None else _weight(weight),
        push_only=push_only,
        friction=friction,
        robust=robust,
        camera=camera,
        frames_per_second=frames_per_second,
        times=times,
    )


def _weight(text: str) -> float | WeightRule:
    try:
        return float(text)
    except ValueError:
        return cast(WeightRule, text)


_DEFAULT = _Batch()


def dataset(
    scene: SceneName,
    *,
    samples: Whole,
    columns: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    batch: _Batch = _DEFAULT,
    set_: Overrides = (),
) -> _Output:
    """Make a dataset of a scene whose [vary] table lists what differs between samples.

    DIR/data holds the samples as Parquet, DIR/sensors the sensors they were pressed on, DIR/meta
    everything else. An interrupted job continues when the same command is given again, and ends
    with the same bytes. A sample that fails is a row with its error (exit code 3).

    Parameters
    ----------
    samples
        How many samples; a dataset can grow later.
    columns
        What to keep, separated by commas (default all).

    Examples:
    twin dataset dataset_kamiyama --samples 1000 --out data/flat
    twin dataset dataset_sato --samples 50 --columns force_n,marker_pressed_px
    twin dataset dataset_sato --samples 100000 --scheduler tcp://10.0.0.1:8786
    """
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # read when numba is loaded; workers inherit it
    from twin.study.dataset.create import create_dataset, estimate
    from twin.study.recipe import find_scene

    loaded = _load(scene, set_)
    if names := _listed("--columns", columns, "some"):
        kept = loaded.dataset.model_copy(update={"columns": tuple(names)})
        loaded = loaded.model_copy(update={"dataset": kept})
    if not 1 <= samples <= MOST_SAMPLES:
        raise InputError(f"--samples {samples}: allowed are 1 to {MOST_SAMPLES:,}")
    workers, cluster = batch.workers_and_scheduler()
    folder = batch.out or Path("out") / find_scene(scene).stem
    if batch.dry_run:
        yield from estimate(loaded, samples, workers=workers, progress=_progress())
        return
    done = create_dataset(
        loaded, folder, samples, workers=workers, scheduler=cluster, progress=_progress()
    )
    rate = f" ({done.made / done.seconds:.3g} a second)" if done.made else ""
    facts = {name: getattr(done, name) for name in ("samples", "made", "failed", "seconds")}
    record = {**facts, "missing": len(done.missing), "folder": str(done.folder)}
    yield f"samples     {done.samples}, {done.made} of them made now{rate}", record
    yield f"written to  {done.folder}"
    if done.missing:
        raise SomeFailed(f"{len(done.missing)} shards are missing, {done.reason}")
    if done.failed:
        raise SomeFailed(
            f"{done.failed} of {done.samples} samples failed, the first: {done.reason}"
        )


def export(
    source: str,
    *,
    format: str,
    out: Path,
    set_: Overrides = (),
) -> _Output:
    """Write a dataset as HDF5, as COCO keypoints, or as WebDataset tar files; or a scene for
    Mitsuba.

    Of a dataset, failed samples are left out. Of a scene, rest.xml and pressed.xml are written with
    triangles as PLY files and a README: stock Mitsuba renders them, and so can others.

    Parameters
    ----------
    source
        Folder of a dataset, or a scene for mitsuba.
    format
        hdf5, coco, webdataset, or mitsuba.
    out
        Folder to write to.

    Examples:
    twin export data/flat --format hdf5 --out flat_h5
    twin export data/flat --format coco --out flat_coco
    twin export kamiyama_pillar --format mitsuba --out flat_scene
    """
    if format == "mitsuba":
        from twin.study.export_scene import export_scene

        files = export_scene(_load(source, set_), out, _progress())
    else:
        from twin.study.dataset.export import export_dataset

        if set_:
            raise InputError("-s: belongs to a scene (--format mitsuba)")
        files = export_dataset(Path(source), format, out, _progress())
    line = f"{files[0] if files else out}: {len(files)} file{'s' if len(files) != 1 else ''}"
    yield line, {"files": list(map(str, files))}


def sweep(
    sweep: str,
    *,
    optimise: bool = False,
    batch: _Batch = _DEFAULT,
    set_: Overrides = (),
) -> _Output:
    """Judge many designs of a sensor: by a closed form, by their linear information, by pictures.

    Prints what to make, and the best designs; -s changes keys of the scene for every design.
    Writes DIR/designs.parquet (and .csv) with a row for every design, DIR/report.html, and DIR/best
    with a scene for each of the best designs, ready for twin run. An interrupted job continues when
    the same command is given again, and ends with the same table. A design that fails is a row with
    its error (exit code 3).

    Shipped sweeps: sweep_kamiyama_depth_pitch, sweep_sato_pitch_diameter, sweep_lens,
    sweep_youngs_modulus.

    Parameters
    ----------
    sweep
        Path of a sweep file, or the name of a shipped sweep.
    optimise
        Search the best design between the axes' ends instead of sampling them.

    Examples:
    twin sweep sweep_lens --out out/lens
    twin sweep sweep_youngs_modulus --workers 2
    twin sweep sweep_kamiyama_depth_pitch --optimise
    """
    from twin.study.recipe import parse_overrides
    from twin.study.sweep.designs import load_sweep

    wanted, scene = load_sweep(sweep, parse_overrides(set_))
    workers, cluster = batch.workers_and_scheduler()
    if batch.dry_run:
        from twin.study.sweep.sweep_run import estimate

        yield from estimate(wanted, scene, workers=workers, optimise=optimise)
        return
    from twin.study.sweep.sweep_report import write_report
    from twin.study.sweep.sweep_run import run_sweep

    folder = batch.out or Path("out") / Path(sweep).stem
    bar = _progress()
    done = run_sweep(
        wanted, scene, folder, workers=workers, scheduler=cluster, progress=bar, optimise=optimise
    )
    lines, best = write_report(done, folder)
    if bar is not None:
        bar("done", 1.0)
    kinds = {kind: int((done.status == kind).sum()) for kind in ("ok", "dropped", "failed")}
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    yield f"designs     {len(done.designs)}: {counts}"
    for warning in done.warnings:
        yield f"warning     {warning}"
    if not kinds["ok"] and not done.failed:
        raise InputError(lines[0])
    yield from lines
    yield from (("", record) for record in best)
    yield f"written to  {folder}: report.html says how far to trust them ('Fidelities and reuse')"
    if done.failed:
        reason = next(str(e) for e, s in zip(done.error, done.status, strict=True) if s == "failed")
        raise SomeFailed(
            f"{done.failed} of {len(done.designs)} designs failed, the first: {reason}"
        )


def reproduce(
    *names: str,
    out: Path = Path("reproduce"),
    quick: bool = False,
    seed: Whole = 1,
    renderer: Literal["auto", "splat", "mitsuba", "path"] = "auto",
) -> _Output:
    """Reproduce the papers' tables and figures, with the papers' figures for comparison.

    Without names it lists what there is, and the time and memory that each takes.

    Every experiment runs through the full chain: contact, picture, CCD, tracking, inverse. Writes
    DIR/index.html, DIR/results.json and an SVG for each. Results in DIR that are still valid are
    not computed again.

    Parameters
    ----------
    names
        Entries (kamiyama/table-1), papers (sato), or all; none: the list.
    out
        Folder for the page, the records and the pictures.
    quick
        One made sensor, fewer steps, no long entries.
    seed
        Root seed of sensors and noise.
    renderer
        What draws the pictures; path takes seconds for each.

    Examples:
    twin reproduce all
    twin reproduce kamiyama/table-1 sato --out here
    twin reproduce kamiyama/table-1 --quick --renderer path --out by_paths
    """
    from twin.study.reproduce.reproduction_run import reproduce as run

    if not 0 <= seed < 2**63 - 100:
        raise InputError(f"--seed {seed}: allowed are whole numbers from 0 to 2^63 - 101")
    done = run(names, out, seed=seed, quick=quick, renderer=renderer, progress=_progress())
    yield from done.lines
    if done.failed:
        raise SomeFailed(
            f"{len(done.failed)} of the entries failed: {', '.join(done.failed)}; see "
            f"{out / 'index.html'}"
        )
