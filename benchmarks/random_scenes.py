"""Random scenes: what must be true of every answer, and what must be said of every wrong recipe.

``python -m benchmarks random_scenes [--count N] [--kind valid|invalid]`` draws N of each kind
(`benchmarks.random_recipes`; 2,000 if not said, the tests draw 200), takes up where it was stopped, and stores what
became of them in benchmarks/results/random_scenes.json; exit code 1 if anything failed, with the smallest recipe that
does. What is drawn depends on the seed and the descriptions alone (`SeedOnly`), so that a failure met anywhere can be
met again; ``--again FILE`` checks a recipe that was printed, and tests/stability/found keeps those that have failed.

Of a valid scene: it is computed, or refused with a cause; everything is finite; pieces of force add up to the total,
and the total is what was asked; every pixel's ray passes through the marker that is projected there; the sum of two
loads moves markers by the sum of the motions; the scene mirrored at y = 0 gives the mirrored answer.

Of a spoilt one: exit code 2, and a message with the file and the key.
"""

import contextlib
import copy
import io
import json
import math
import re
import sys
import tempfile
import time
import tomllib
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from hypothesis import HealthCheck, Phase, Verbosity, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider

from benchmarks.random_recipes import Spoilt, Table, recipes, spoilt
from benchmarks.record import Count, machine, read, table, write
from twin.errors import ContactError, InputError, MeshError, RecipeError, TwinError
from twin.parts.load import Traction
from twin.parts.markers import MarkerSet
from twin.parts.scene import Scene
from twin.results import RunResult
from twin.study.recipe import load_scene, shipped_scenes, validate_scene
from twin.study.run import run as run_scene
from twin.study.sensor import Sensor
from twin.theory.optics import rays
from twin.world.elasticity.discretise import tile

COUNT, CHUNK = 2000, 50

BALANCE, ASKED, THROUGH_MM, SUPERPOSED, MIRRORED = 1e-6, 1e-6, 1e-5, 1e-9, 3.0
"""Forces over the total; the same; a ray's distance from its marker; what motions may be off beside the estimated
error; mirrored answers over the estimated error (both are off)."""

LEFT_OUT = "left out, for lack of time"

LEAST = 1e-3
"""Error that two mirrored answers may always have: patches are laid along the probe's axes, which are not mirrored."""


class SeedOnly(HypothesisProvider):
    """Draws that depend on the seed and the strategies alone, so that a failure met anywhere can be met again.

    Hypothesis mixes in numbers that it finds in the sources of whatever is imported, so that every change of the
    program, anywhere, would draw other scenes. What lies far out is tried by `benchmarks.extremes`.
    """

    def _maybe_draw_constant(self, *arguments: Any, **settings: Any) -> None:
        return None


AVAILABLE_PROVIDERS["seed-only"] = f"{__name__}.SeedOnly"


@dataclass
class Tally:
    """What became of the scenes of one kind."""

    outcomes: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    slowest_s: float = 0.0
    smallest_failure: str = ""

    def note(self, what: str, size: float, most: float = math.inf, complaint: str = "") -> None:
        """Keep the largest figure of a kind; assert that it is at most ``most``."""
        self.worst[what] = max(self.worst.get(what, 0.0), size)
        assert size <= most, complaint.format(size)


def survey(
    strategy: st.SearchStrategy[Any],
    check: Callable[[Any, Tally], str],
    count: int,
    seed: int,
    most_s: float = math.inf,
) -> Tally:
    """Check ``count`` drawn things, or what ``most_s`` allows; return the tally, with the smallest failure found."""
    tally, began = Tally(), time.monotonic()

    @seeded(seed)
    @settings(
        max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink), verbosity=Verbosity.quiet, print_blob=False, backend="seed-only",
    )  # fmt: skip
    @given(strategy)
    def each(drawn: Any) -> None:
        if time.monotonic() - began > most_s:
            tally.outcomes[LEFT_OUT] += 1
            return
        started = time.process_time()
        try:
            tally.outcomes[check(drawn, tally)] += 1
        except BaseException as problem:
            tally.outcomes["failed"] += 1
            tally.smallest_failure = f"{type(problem).__name__}: {problem}\n{shown(drawn)}"
            raise
        finally:
            tally.slowest_s = max(tally.slowest_s, time.process_time() - started)

    with contextlib.suppress(Exception, SystemExit):
        each()
    return tally


def shown(drawn: Any) -> str:
    """Return a drawn recipe as text."""
    found = drawn.table if isinstance(drawn, Spoilt) else drawn
    head = f"# {drawn.how}: {drawn.key}\n" if isinstance(drawn, Spoilt) else ""
    return head + tomli_w.dumps(found)


def check_valid(recipe: Table, tally: Tally) -> str:
    """Compute a scene and assert what must be true of it; return what became of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = validate_scene(recipe, "drawn")
        try:
            result = run_scene(scene)
        except (ContactError, RecipeError, InputError, MeshError) as refused:
            return f"refused: {_cause(refused)}"
        assert_sound(scene, result, tally)
        assert_superposed(scene, tally)
        if result.facts["contact"].get("incomplete"):
            return "a step did not converge, and the result says so"
        assert_mirrored(recipe, scene, result, tally)
        return f"computed, {scene.body.shape}{', with pictures' if result.rest is not None else ''}"


def _cause(refused: TwinError) -> str:
    words = {
        "outside the body": "markers outside the body", "over the edge": "contact over the edge",
        "leaves the sensing": "contact over the edge", "can carry": "friction can't carry the side force",
        "slides": "the probe slides", "can't be balanced": "force can't be balanced",
        "outside the sensing surface": "sites outside the sensing surface", "tear": "tears",
        "lifted": "lifted off", "sinks in": "sinks in too far", "misses": "misses the surface",
        "no patch": "touches no patch", "positions_mm": "a light inside a layer",
        "cone's base": "contact reaches the cone's base", "depth_mm": "marker depth",
    }  # fmt: skip
    return next((told for word, told in words.items() if word in str(refused)), str(refused)[:90])


def assert_sound(scene: Scene, result: RunResult, tally: Tally) -> None:
    """Assert finite answers, balanced forces, held forces, and rays through the projected markers."""
    truth = result.truth
    for name in ("marker_rest_mm", "marker_displacement_mm", "surface_mm", "surface_force_n", "total_torque_nmm"):
        assert np.isfinite(getattr(truth, name)).all(), f"truth.{name} is not finite"
    size = max(float(np.linalg.norm(truth.total_force_n)), 1e-12)
    off = float(np.linalg.norm(truth.surface_force_n.sum(axis=0) - truth.total_force_n)) / size
    tally.note("balance, of the total", off, BALANCE, "pieces of force are {:.1e} off their total")
    contact = result.facts.get("contact")  # none with given tractions
    if contact is not None and not contact.get("incomplete"):
        # forces that the last step holds, over the largest that it asks for
        pairs = zip(contact["force_n"], scene.press.path[-1].force_n, strict=True)
        asked = [(found, force) for found, force in pairs if force is not None]
        size = max((abs(force) for _, force in asked), default=0.0) or math.inf
        off = max((abs(found - force) / size for found, force in asked), default=0.0)
        tally.note("held force, of the total", off, ASKED, "a force that is held is {:.1e} off")
    json.dumps(result.score, allow_nan=False)
    if result.estimate is not None:
        assert not np.isinf(result.estimate.marker_shift_px).any(), "a shift is infinite"
        assert np.isfinite(result.estimate.force_n).all(), "an estimated force is not finite"
    for picture in (result.rest, result.pressed):
        assert picture is None or picture.dtype == (np.uint8 if scene.ccd.bits == 8 else np.uint16)
    if scene.camera is not None:
        _assert_projected(scene, result, tally)


def _assert_projected(scene: Scene, result: RunResult, tally: Tally) -> None:
    truth, actual = result.truth, Sensor(scene).actual.scene
    places = truth.marker_rest_mm + truth.marker_displacement_mm
    seen = np.isfinite(truth.marker_pressed_px).all(axis=1)
    pixels, index = truth.marker_pressed_px[seen], actual.material.refractive_index
    start, way = rays(pixels, actual.camera, index, actual.body.base_z_mm)
    arm = places[seen] - start
    off = np.linalg.norm(arm - np.sum(arm * way, axis=1, keepdims=True) * way, axis=1).max(initial=0.0)
    tally.note("ray past its marker, mm", float(off), THROUGH_MM, "the ray of a marker's pixel passes it by {:.1e} mm")


def assert_superposed(scene: Scene, tally: Tally) -> None:
    """Assert that two loads together do what each does, added."""
    sensor = Sensor(scene)
    body, points = sensor.actual.scene.body, sensor.actual.markers.points
    places = body.chart_points(np.array([[0.0, 0.0], [1.0, 0.5]]))
    one = Traction.rectangle(tuple(places[0]), (1.0, 1.5), (0.1, 0.2, 1.0))
    other = Traction.bump(tuple(places[1]), 0.8, (-0.2, 0.1, 0.7))
    apart = sum(sensor.compliance.displacement(points, tile(load, body)) for load in (one, other))
    both, told = sensor.compliance.answer(points, tile(one + other, body))
    off = float(np.abs(both - apart).max() / np.abs(both).max())
    complaint = f"two loads together are {off:.1e} off the sum of their motions, estimated are {told:.1e}"
    tally.note("superposition, of what is estimated", off / (SUPERPOSED + told), 1.0, complaint)


def assert_mirrored(recipe: Table, scene: Scene, result: RunResult, tally: Tally) -> None:
    """Assert that the made sensor mirrored at y = 0 moves its markers as in the mirror."""
    truth, score, flip = result.truth, result.score, np.array([1.0, -1.0, 1.0])
    material = Sensor(scene).actual.scene.material.model_dump(exclude_none=True)
    as_made = {**mirrored(recipe), "tolerance": {"preset": "none"}, "material": material}
    there = Sensor(validate_scene(as_made, "drawn, mirrored"))
    here = MarkerSet.place(scene.body, scene.markers).points
    apart = np.linalg.norm(here[:, None] - (there.nominal_markers.points * flip)[None], axis=2)
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-9, "mirrored markers lie elsewhere"
    try:
        state = there.press()
    except ContactError as refused:
        if just_over_base(refused, scene.displacement_error):
            return
        raise
    if not state.complete:
        return
    answer = there.ladder.displacement(truth.marker_rest_mm * flip, there.rectangles(state.load))
    size = float(np.abs(truth.marker_displacement_mm).max())
    off = float(np.abs(answer.displacement_mm * flip - truth.marker_displacement_mm).max()) / size
    stated = result.facts["contact"]["error"]
    unshared = float(stated["body"]["markers"] + stated["patches"]["markers"])
    told = max(score["elastic"]["displacement_error"], answer.error) + unshared
    complaint = f"the mirrored scene's answer is {off:.1e} off, estimated are {told:.1e}"
    tally.note("mirror, of what is estimated", off / (MIRRORED * told + LEAST), 1.0, complaint)


def just_over_base(refused: ContactError, error: float) -> bool:
    """Return whether a contact is refused at a cone's base by less than the error that the mesh is asked for."""
    sizes = re.search(r"reaches (\S+) mm across, over the cone's base of (\S+) mm", str(refused))
    return sizes is not None and float(sizes[1]) <= (1.0 + error) * float(sizes[2])


def mirrored(recipe: Table) -> Table:
    """Return a recipe mirrored at y = 0: places, sideways forces and motions along y, turns about x and z."""
    found = copy.deepcopy(recipe)
    for layer in found["markers"].values():
        if "offset_mm" in layer:
            s, t = layer["offset_mm"]
            layer["offset_mm"] = [s, -t]
    press = found["press"]
    press["at_mm"] = [press["at_mm"][0], -press["at_mm"][1]]
    for step in press.get("steps", []):
        for key, flipped in (("force_n", "y"), ("move_mm", "y"), ("turn_deg", "xz"), ("torque_nmm", "xz")):
            step[key] = {axis: -v if axis in flipped else v for axis, v in step.get(key, {}).items()}
            if not step[key]:
                del step[key]
    return found


COMMANDS = (["check"], ["run", "--want", "displacement"], ["mesh"], ["view"])


def check_spoilt(one: Spoilt, tally: Tally) -> str:
    """Give a spoilt recipe to the command line and assert what it says; return how it was spoilt."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drawn.toml"
        file.write_text(tomli_w.dumps(one.table))
        command = COMMANDS[len(file.read_bytes()) % len(COMMANDS)]
        code, told = said([command[0], str(file), *command[1:]])
        left = sorted(path.name for path in Path(folder).iterdir())
    assert code == 2, f"exit code {code}: {told[-400:]}"
    assert "drawn.toml" in told, f"the file is not named: {told[-400:]}"
    assert one.key in told, f"the key '{one.key}' is not named: {told[-400:]}"
    assert "internal error" not in told
    assert left == ["drawn.toml"], f"files were left: {left}"
    return one.how


def said(arguments: list[str]) -> tuple[int, str]:
    """Return the exit code of a command line in this process, and what it writes to stderr."""
    from twin.cli import main

    told = io.StringIO()
    with contextlib.redirect_stderr(told), contextlib.redirect_stdout(io.StringIO()):
        try:
            main(arguments)
        except SystemExit as done:
            return int(done.code or 0), told.getvalue()
    raise AssertionError("the command line returned")


def spoilt_recipes() -> st.SearchStrategy[Spoilt]:
    """Return spoilt recipes, of random scenes and of the shipped ones."""
    shipped = st.sampled_from(sorted(shipped_scenes())).map(load_scene)
    return spoilt(st.one_of(recipes().map(lambda found: validate_scene(found, "drawn")), shipped))


KINDS: dict[str, tuple[Callable[[], st.SearchStrategy[Any]], Callable[[Any, Tally], str]]] = {
    "invalid": (spoilt_recipes, check_spoilt),
    "valid": (recipes, check_valid),
}


def measure(*, count: Count = COUNT, kind: Literal["valid", "invalid"] | None = None, again: Path | None = None) -> int:
    """Draw the scenes, print and store what became of them; exit code 1 if any failed.

    Parameters
    ----------
    count
        Scenes of each kind.
    kind
        One kind only.
    again
        Check this recipe alone, as one that had failed.
    """
    if again:
        print(check_valid(tomllib.loads(again.read_text()), Tally()))
        return 0
    bad = False
    for each in [kind] if kind else sorted(KINDS):
        strategy, check = KINDS[each]
        new = {"chunks": 0, "drawn": 0, "cpu_s": 0.0, "slowest_s": 0.0, "worst": {}, "outcomes": {}}
        found = read("random_scenes").get(each, new)
        while found["drawn"] < count and not bad:
            started = time.process_time()
            tally = survey(strategy(), check, CHUNK, seed=found["chunks"] + 1)
            if bad := bool(tally.outcomes["failed"]):
                print(f"\nsmallest failure: {tally.smallest_failure}", file=sys.stderr)
                break
            outcomes = Counter(found["outcomes"]) + tally.outcomes
            worst = {k: max(found["worst"].get(k, 0.0), v) for k, v in tally.worst.items()}
            found |= {"chunks": found["chunks"] + 1, "drawn": sum(outcomes.values()), "machine": machine()}
            found |= {"worst": found["worst"] | worst, "outcomes": dict(outcomes.most_common())}
            found["cpu_s"] += time.process_time() - started
            found["slowest_s"] = max(found["slowest_s"], tally.slowest_s)
            write("random_scenes", {**read("random_scenes"), each: found})
        print(f"\n{table([{each: what, 'count': n} for what, n in found['outcomes'].items()])}")
        print(f"\nworst: {found['worst']}, {found['cpu_s']:.4g} CPU s")
    return int(bad)
