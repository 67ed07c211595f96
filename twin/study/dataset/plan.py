"""What a dataset is: the scene, its shards and draws, the places of its files, and their sums."""

from __future__ import annotations

import json
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import ValidationError

from twin.arrays import Floats
from twin.errors import InputError, RecipeError, did_you_mean
from twin.files import file_digest
from twin.parts.load import Footprint, Load
from twin.parts.part import Purpose
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.parts.shape import StlFile
from twin.parts.vary import Choice, Distribution, Follows, ForceCone, Normal, Uniform
from twin.study.batch.draw import Sampling, SceneTable, Table, with_values
from twin.study.batch.pool import Job
from twin.study.dataset.columns import ALWAYS, SAMPLE, SENSOR, Column, Kind, Need
from twin.study.recipe import validate_scene

FORMAT = 1
"""Version of the folder's layout and of the columns' meaning."""

_FIXED = (
    "body",
    "seed",
    "cover",
    "accuracy",
    "dataset",
    "vary",
    "tracking",
    "calibration",
    "reconstruction",
    "light.lit",
)
"""What can't vary inside a dataset: it has one mesh, one accuracy and one format."""

TEST_EACH = 5
"""One sequence, or one made sensor, in so many is of the test part."""

MOST_STEPS = 1024

AUDITS, AUDIT_EVERY = 100, 100
"""One sample in a hundred is computed again, a hundred at most, one at least."""

MISSES, LOOKED_AT = 8, 64
"""Presses drawn first of which one must be possible, and those that a warning counts over."""

_WORK = "twin.study.dataset.sample:make_shard"


@dataclass(frozen=True)
class Plan:
    """A dataset to be made: the nominal scene, with ``vary`` and ``dataset``, and the number of
    samples."""

    scene: Scene
    samples: int

    @property
    def shards(self) -> int:
        """Number of files."""
        return -(-self.samples // self.scene.dataset.samples_per_shard)

    def of_shard(self, shard: int) -> range:
        """Return the numbers of the samples in a shard."""
        size = self.scene.dataset.samples_per_shard
        return range(shard * size, min((shard + 1) * size, self.samples))

    def sensor_of(self, sample: int) -> int:
        """Return the sensor that a sample is pressed on."""
        return sample // self.scene.dataset.samples_per_sensor

    def sensors_of(self, shard: int) -> range:
        """Return the sensors whose first sample is in a shard."""
        each = self.scene.dataset.samples_per_sensor
        samples = self.of_shard(shard)
        return range(-(-samples.start // each), -(-samples.stop // each))

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """The sample columns, without `twin.study.dataset.columns.ALWAYS`."""
        return _chosen_columns(self.scene, self.scene.dataset.columns)

    @cached_property
    def needs(self) -> frozenset[str]:
        """What has to be computed."""
        return frozenset(need for column in self.columns for need in column.needs)

    @property
    def load_table(self) -> str:
        """The scene's table of the load: ``press`` or ``tractions``."""
        return "tractions" if self.scene.tractions else "press"

    @cached_property
    def press_axes(self) -> dict[str, Distribution]:
        """What is drawn for every sample."""
        return {k: v for k, v in self.scene.vary.items() if k.split(".")[0] == self.load_table}

    @cached_property
    def sensor_axes(self) -> dict[str, Distribution]:
        """What is drawn for every sensor."""
        return {k: v for k, v in self.scene.vary.items() if k not in self.press_axes}

    @cached_property
    def row_columns(self) -> tuple[Column, ...]:
        """All columns of the samples table."""
        return (*ALWAYS, *_drawn_columns(self.press_axes), *self.columns)

    @cached_property
    def sensor_columns(self) -> tuple[Column, ...]:
        """The columns of the sensors table."""
        found = [column for column in SENSOR if _available(column, self.scene, self.needs)]
        if "picture" in self.needs:
            found += [
                Column(f"picture_{group}", "png", f"CCD picture at rest, lit by group {group}")
                for group in range(1, len(self.scene.imaging[1].lit))
            ]
        return (*found, *_drawn_columns(self.sensor_axes))

    def audited(self, failed: Collection[int] = ()) -> list[int]:
        """Return which samples are computed again: spread over those that did not fail."""
        count = min(AUDITS, max(1, self.samples // AUDIT_EVERY), self.samples - len(failed))
        bad = np.array(sorted(failed), int)
        good = np.linspace(0, self.samples - len(bad) - 1, count).astype(int)
        for index in bad:  # the n-th good sample's number is n plus the failed ones before it
            good[good >= index] += 1
        return [int(number) for number in good]

    @property
    def alike(self) -> str:
        """Warning that all samples are of one press; empty where they differ, or there is one."""
        if self.press_axes or self.samples == 1:
            return ""
        sensors = self.sensor_of(self.samples - 1) + 1
        where = "one made sensor" if sensors == 1 else f"{sensors} made sensors"
        example = "at_mm" if self.load_table == "press" else "0.centre_mm"
        return (
            f"vary: nothing of the {self.load_table} varies, so that all {self.samples} samples "
            f"are the same one, on {where}; name what differs, such as "
            f'[vary."{self.load_table}.{example}"] with low and high'
        )

    @cached_property
    def _plain(self) -> SceneTable:
        return SceneTable.of(self.scene)

    def press_values(self, samples: range) -> list[Table]:
        """Return what is drawn for the samples, by dotted key."""
        return _draws(self.press_axes, self.scene, Purpose.SAMPLING, samples)

    def sensor_values(self, sensors: range) -> list[Table]:
        """Return what is drawn for the sensors, by dotted key."""
        return _draws(self.sensor_axes, self.scene, Purpose.SENSOR, sensors, self.press_axes)

    def press_table(self, values: Table) -> Any:
        """Return the plain table of a press, or the tables of tractions, with drawn values."""
        table = SceneTable({self.load_table: deepcopy(self._plain.get(self.load_table, {}))})
        table.put(values, self.press_axes)
        return table[self.load_table]

    def press_of(self, table: Any) -> Press | Load:
        """Return the press, or the load of tractions, of `press_table`; or raise `RecipeError`."""
        try:
            if not self.scene.tractions:
                return Press.model_validate(table)
            return sum((Footprint.model_validate(one).load() for one in table), Load())
        except ValidationError:  # said in a recipe's words
            validate_scene({**self._plain, self.load_table: table}, "")
            raise

    @staticmethod
    def drawn_values(axes: Mapping[str, Distribution], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return drawn values under the names of their columns."""
        row: dict[str, Any] = {}
        for key, value in values.items():
            kind = _kind(axes[key])
            if kind == "text":
                row[_name(key)] = json.dumps(StlFile.bare(value), sort_keys=True)
            else:
                row[_name(key)] = np.array(value, float) if kind == "numbers" else float(value)
        return row

    def check(self) -> None:
        """Refuse what can't vary, and keys that the scene does not have.

        Raises
        ------
        RecipeError
            With all problems at once.
        """
        scene = self.scene
        problems = []
        if self.samples < 1:
            problems.append(f"samples = {self.samples}: give at least 1")
        if scene.press is None and not scene.tractions:
            problems.append(
                "press: the scene has no [press] table, and no [[tractions]], to draw samples of"
            )
        if scene.cover is not None and scene.cover.has_own_material:
            problems.append(
                "cover: one of its own modulus needs a new mesh for every press, and meshes are "
                "not reproducible; leave youngs_modulus_mpa and poisson_ratio out of [cover]"
            )
        for key in scene.vary:
            table = key.split(".")[0]
            fixed = next((name for name in _FIXED if f"{key}.".startswith(f"{name}.")), None)
            if fixed is not None:
                problems.append(
                    f"vary.{key}: {fixed} can't vary inside a dataset; make several datasets"
                )
            if scene.tractions and table == "press":
                problems.append(
                    f"vary.{key}: no press is done where [[tractions]] are given; take it out of "
                    "[vary]"
                )
        if problems:
            raise RecipeError(problems)
        try:
            plain = self.press_table(self.press_values(range(1))[0])
            _ = self.press_of(plain)
        except RecipeError as problem:
            if unknown := [line for line in problem.problems if ": unknown key" in line]:
                raise RecipeError([f"vary.{line}" for line in unknown]) from None
            # a value that is not allowed is the sample's failure, not the dataset's
            if not all(line.startswith(f"{self.load_table}.") for line in problem.problems):
                raise
        if len(missed := self._missed(MISSES)) == MISSES:
            raise RecipeError(f"vary: the first {MISSES} presses all fail, the first: {missed[0]}")
        first = self.sensor_values(range(1))[0]
        ranges = {key: axis for key, axis in self.sensor_axes.items() if isinstance(axis, Uniform)}
        for end in (0.0, 1.0):
            ends = {key: axis.at(np.full(axis.takes, end)) for key, axis in ranges.items()}
            try:
                with_values(scene, {**first, **ends}, self.sensor_axes)
            except RecipeError as problem:
                at = f"at the {'high' if end else 'low'} ends of the ranges in [vary]: "
                raise RecipeError([at + line for line in problem.problems]) from None
        _ = self.columns

    @property
    def misses(self) -> str:
        """Warning that some presses can't be done; empty where the first ones all can."""
        if not (found := self._missed(LOOKED_AT)):
            return ""
        return f"vary: {len(found)} of the first {LOOKED_AT} presses fail, the first: {found[0]}"

    def _missed(self, samples: int) -> list[str]:
        """Return why presses miss the nominal body, have values that are not allowed, or sink in
        too deep."""
        from twin.world.contact.probe_gap import Approach

        missed = []
        for values in [] if self.scene.tractions else self.press_values(range(samples)):
            try:
                press = self.press_of(self.press_table(values))
                assert isinstance(press, Press)
                Approach.of_press(press, self.scene.body).check_depth(press, self.scene.body)
            except (InputError, RecipeError) as problem:
                missed.append(str(problem))
        return missed


def _draws(
    axes: Mapping[str, Distribution],
    scene: Scene,
    purpose: Purpose,
    numbers: Sequence[int],
    apart_from: Mapping[str, Distribution] | None = None,
) -> list[Table]:
    """Return the values of all axes by dotted key, a table for every sample number, without keys
    that follow others. Axes that are drawn for another purpose are named in ``apart_from``: the
    same dimension of two scrambled sequences is correlated (-0.6 over 64 points), so these take
    later dimensions."""
    width = sum(axis.takes for axis in axes.values())
    taken = sum(axis.takes for axis in (apart_from or {}).values())
    rows = _unit_numbers(scene.seed, purpose, scene.dataset.sampling, numbers, width, taken)
    found = []
    for u in rows:
        values = {}
        start = 0
        for key in sorted(axes):
            axis = axes[key]
            if not isinstance(axis, Follows):
                values[key] = axis.at(u[start : start + axis.takes])
                start += axis.takes
        found.append(values)
    return found


def _unit_numbers(
    seed: int, purpose: Purpose, sampling: Sampling, numbers: Sequence[int], width: int, taken: int
) -> Floats:
    """Return (len(numbers), width) numbers in [0, 1), a row a sample: the dimensions of a sequence
    after the first ``taken``."""
    if width == 0 or not numbers:
        return np.zeros((len(numbers), width))
    if sampling == "random":
        return np.array([purpose.stream(seed, number).random(width) for number in numbers])
    from scipy.stats import qmc

    sequence = qmc.Sobol(taken + width, scramble=True, rng=purpose.stream(seed))
    first, last = min(numbers), max(numbers)
    with warnings.catch_warnings():  # a part of the sequence need not be a power of two
        warnings.simplefilter("ignore", UserWarning)
        if first:
            sequence.fast_forward(first)
        points = sequence.random(last - first + 1)
    return np.asarray(points[np.asarray(numbers) - first, taken:])


class Places:
    """The places of a dataset's files.

    Attributes
    ----------
    data, sensors, meta
        Folders of the samples, of the sensors, and of everything else.
    info
        Facts about the dataset; written last of what must precede the first sample.
    sums, written
        Checksums of all files of a finished dataset, and of the shards of an unfinished one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.data = folder / "data"
        self.sensors = folder / "sensors"
        self.meta = folder / "meta"
        self.info = self.meta / "info.json"
        self.sums = self.meta / "SHA256SUMS"
        self.written = self.meta / "written.sha256"

    def shard(self, number: int) -> Path:
        """File of a shard's samples."""
        return self.data / f"part-{number:05d}.parquet"

    def sensor_shard(self, number: int) -> Path:
        """File of a shard's sensors."""
        return self.sensors / f"part-{number:05d}.parquet"

    @property
    def job(self) -> Job:
        """The job that makes shards: everything a worker needs to know."""
        kept = [
            path
            for path in sorted(self.meta.iterdir())
            if path.suffix in {".npz", ".toml", ".stl"} or path == self.info
        ]
        return Job(files={path.name: path.read_bytes() for path in kept}, work=_WORK)

    def read_info(self) -> dict[str, Any]:
        """Return info.json, or raise `InputError` if there is none or it can't be read."""
        try:
            facts: dict[str, Any] = json.loads(self.info.read_text())
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(f"{self.folder}: has no meta/info.json, so it is no dataset") from None
        except (OSError, ValueError, RecursionError) as problem:
            raise InputError(f"{self.info}: can't be read ({problem})") from None
        if not isinstance(facts, dict) or facts.get("format") != FORMAT:
            found = facts.get("format") if isinstance(facts, dict) else None
            raise InputError(f"{self.info}: format {found}; this program reads {FORMAT}")
        lists = [facts.get(name) for name in ("columns", "sensor_columns")]
        whole = all(isinstance(each, list) and all(map(_is_column, each)) for each in lists)
        numbers = isinstance(facts.get("samples"), int)
        if not (whole and numbers and isinstance(facts.get("content"), str)):
            raise InputError(
                f"{self.info}: columns, sensor_columns, samples or content are missing or damaged"
            )
        return facts

    def sums_of_files(self, known: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the SHA-256 of every file of a dataset, by relative path; ``known`` ones are not
        computed again."""
        found = {}
        for path in sorted(self.folder.rglob("*")):
            name = path.relative_to(self.folder).as_posix()
            others = (self.sums, self.written, self.meta / "writer.lock")
            if path.is_file() and path not in others:
                found[name] = (known or {}).get(name) or file_digest(path)
        return found

    @staticmethod
    def listed(file: Path) -> dict[str, str]:
        """Return the checksums in a file that ``sha256sum`` reads, by path; none without a file."""
        if not file.is_file():
            return {}
        lines = [
            line.split("  ", 1)
            for line in file.read_text(errors="replace").splitlines()
            if "  " in line
        ]
        return {name: digest for digest, name in lines}


def _is_column(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and isinstance(entry.get("name"), str)
        and entry.get("kind") in get_args(Kind)
    )


def _chosen_columns(scene: Scene, names: Iterable[str]) -> tuple[Column, ...]:
    """Return the sample columns of these names, in their one order; without names all that the
    scene has, else a `RecipeError`. `ALWAYS` may be named, too."""
    asked = list(dict.fromkeys(names))
    wanted = [name for name in asked if name not in {column.name for column in ALWAYS}]
    has: set[Need] = {"load", "motion"}
    if not scene.tractions:
        has.add("contact")
    if scene.camera is not None:
        has |= {"picture", "outlines"}
    if scene.dataset.sites is not None or scene.reconstruction is not None:
        has.add("sites")
    known = {column.name: column for column in SAMPLE}
    problems = []
    for name in wanted:
        if name not in known:
            hint = did_you_mean(name, known, f"known are {', '.join(known)}")
            problems.append(f"columns: no '{name}'; {hint}")
        elif not _available(known[name], scene, has):
            lacking = known[name].needs - has
            table = "[dataset.sites]" if "sites" in lacking else "[camera]"
            why = f"needs a {table} table, which this scene lacks"
            if "contact" in lacking:
                why = "is known of a press only, and this scene gives [[tractions]]"
            problems.append(f"columns: '{name}' {why}")
    if problems:
        raise RecipeError(problems)
    if asked:
        return tuple(column for column in SAMPLE if column.name in wanted)
    kept = {"lit"} if scene.light is not None and scene.light.lit else set()
    return tuple(
        c for c in SAMPLE if _available(c, scene, has) and (c.name in kept or not c.by_name)
    )


def _available(column: Column, scene: Scene, has: AbstractSet[str]) -> bool:
    return column.needs <= has and (scene.camera is not None or column.kind != "pixels")


def _drawn_columns(axes: Mapping[str, Distribution]) -> tuple[Column, ...]:
    """Return a column for every key that varies: a number, numbers, or JSON for anything else."""
    return tuple(Column(_name(key), _kind(axes[key]), f"drawn {key}") for key in sorted(axes))


def _name(key: str) -> str:
    return f"vary_{key.replace('.', '_')}"


def _kind(axis: Distribution) -> Literal["number", "numbers", "text"]:
    if isinstance(axis, ForceCone):
        return "numbers"
    if isinstance(axis, Uniform | Normal):
        value = axis.low if isinstance(axis, Uniform) else axis.mean
        return "numbers" if isinstance(value, tuple) else "number"
    if not isinstance(axis, Choice) or all(_is_number(value) for value in axis.choice):
        return "number"
    lists = all(isinstance(v, list | tuple) and all(map(_is_number, v)) for v in axis.choice)
    return "numbers" if lists else "text"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
