"""What a dataset is: the scene, how it is cut, and where everything lies."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from twin.errors import RecipeError, did_you_mean
from twin.parts.footprint import Footprint
from twin.parts.load import Load
from twin.parts.part import Part, in_words
from twin.parts.press import Press
from twin.parts.scene import Scene
from twin.parts.vary import Distribution
from twin.streams import Purpose
from twin.study.batch.draw import Table, copied, drawn, plain_table, put_all, unit_numbers, width, with_values
from twin.study.dataset.columns import Column, chosen_columns, drawn_columns, sensor_columns

FORMAT = 1
"""Version of the folder's layout and of what columns mean."""

FIXED = ("body", "seed", "cover", "accuracy", "dataset", "vary", "tracking", "calibration", "reconstruction")
"""Tables that can't vary inside a dataset: its mesh, and what its truth's accuracy and format rest on, are one."""

MOST_STEPS = 1024

P = TypeVar("P", bound=Part)


@dataclass(frozen=True)
class Plan:
    """A dataset to be made.

    Attributes
    ----------
    scene
        The nominal scene, with ``vary`` and ``dataset``.
    samples
        How many.
    """

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
        """Return which sensor a sample is pressed on."""
        return sample // self.scene.dataset.samples_per_sensor

    def sensors_of(self, shard: int) -> range:
        """Return the sensors whose first sample is in a shard."""
        each, samples = self.scene.dataset.samples_per_sensor, self.of_shard(shard)
        return range(-(-samples.start // each), -(-samples.stop // each))

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """The sample columns, without those that are always there."""
        return chosen_columns(self.scene, self.scene.dataset.columns)

    @cached_property
    def needs(self) -> frozenset[str]:
        """What has to be computed."""
        return frozenset(need for column in self.columns for need in column.needs)

    @cached_property
    def press_axes(self) -> dict[str, Distribution]:
        """What is drawn for every sample."""
        return {k: v for k, v in self.scene.vary.items() if k.split(".")[0] == self.pushed_by}

    @property
    def pushed_by(self) -> str:
        """The table of the scene that says what pushes: ``press`` or ``tractions``."""
        return "tractions" if self.scene.tractions else "press"

    @cached_property
    def sensor_axes(self) -> dict[str, Distribution]:
        """What is drawn for every sensor."""
        return {k: v for k, v in self.scene.vary.items() if k not in self.press_axes}

    @property
    def alike(self) -> str:
        """Why all samples are of one press, and how to make them differ; empty where they do, or there is but one."""
        if self.press_axes or self.samples == 1:
            return ""
        sensors = self.sensor_of(self.samples - 1) + 1
        where = "one made sensor" if sensors == 1 else f"{sensors} made sensors"
        example = "at_mm" if self.pushed_by == "press" else "0.centre_mm"
        return (
            f"vary: nothing of the {self.pushed_by} varies, so that all {self.samples} samples are the same one, on "
            f'{where}; say what differs, such as [vary."{self.pushed_by}.{example}"] with low and high'
        )

    @property
    def drawn_columns(self) -> tuple[Column, ...]:
        """A column for every axis of the samples."""
        return drawn_columns(self.press_axes)

    @property
    def sensor_columns(self) -> tuple[Column, ...]:
        """The columns of the sensors table."""
        return (*sensor_columns(self.columns, self.scene), *drawn_columns(self.sensor_axes))

    @cached_property
    def _plain(self) -> Table:
        return plain_table(self.scene)

    def press_values(self, samples: range) -> list[Table]:
        """Return what is drawn for the samples, by dotted key."""
        return self._values(self.press_axes, Purpose.SAMPLING, samples)

    def sensor_values(self, sensors: range) -> list[Table]:
        """Return what is drawn for the sensors, by dotted key."""
        return self._values(self.sensor_axes, Purpose.SENSOR, sensors)

    def _values(self, axes: Mapping[str, Distribution], purpose: Purpose, numbers: range) -> list[Table]:
        u = unit_numbers(self.scene.seed, purpose, self.scene.dataset.sampling, numbers, width(axes))
        return [drawn(axes, row) for row in u]

    def press_table(self, values: Table) -> Any:
        """Return the plain table of a press, or the tables of tractions, with their drawn values."""
        table = {self.pushed_by: copied(self._plain.get(self.pushed_by, {}))}
        put_all(table, values, self.press_axes)
        return table[self.pushed_by]

    def check(self) -> None:
        """Refuse what can't vary, and keys that the scene does not have.

        Raises
        ------
        RecipeError
            With all problems at once.
        """
        problems = []
        if self.samples < 1:
            problems.append(f"samples = {self.samples}: give at least 1")
        if self.scene.press is None and not self.scene.tractions:
            problems.append("press: the scene has no [press] table, and no [[tractions]], to draw samples of")
        if self.scene.cover is not None and (self.scene.cover.youngs_modulus_mpa or self.scene.cover.poisson_ratio):
            problems.append(
                "cover: one of its own modulus needs a new mesh for every press, and meshes are not reproducible; "
                "leave youngs_modulus_mpa and poisson_ratio out of [cover]"
            )
        for key in self.scene.vary:
            if key.split(".")[0] in FIXED:
                problems.append(f"vary.{key}: {key.split('.')[0]} can't vary inside a dataset; make several datasets")
            if self.scene.tractions and key.split(".")[0] == "press":
                problems.append(f"vary.{key}: no press is done where [[tractions]] are given; take it out of [vary]")
        if problems:
            raise RecipeError(problems)
        try:
            table = self.press_table(self.press_values(range(1))[0])
            _ = load_of(table) if self.scene.tractions else press_of(table)
        except UnknownKey:
            raise
        except RecipeError as problem:  # a value that is not allowed is the sample's failure, not the dataset's
            if not all(line.startswith(f"{self.pushed_by}.") for line in problem.problems):
                raise
        with_values(self.scene, self.sensor_values(range(1))[0], self.sensor_axes)
        _ = self.columns


class UnknownKey(RecipeError):
    """A key that varies is none of a press's."""


def press_of(table: Table) -> Press:
    """Return the press of a plain table.

    Raises
    ------
    RecipeError
        It is not allowed; `UnknownKey` if it has a key that no press has.
    """
    return _valid(Press, table, "press")


def load_of(tables: list[Table]) -> Load:
    """Return the load of plain tables of tractions.

    Raises
    ------
    RecipeError
        One is not allowed; `UnknownKey` if it has a key that none has.
    """
    return sum((_valid(Footprint, table, f"tractions.{i}").load() for i, table in enumerate(tables)), Load())


def _valid(part: type[P], table: Table, where: str) -> P:
    try:
        return part.model_validate(table)
    except ValidationError as problem:
        lines, unknown = [], False
        for error in problem.errors():
            key = ".".join(str(k) for k in (where, *error["loc"]))
            if error["type"] == "extra_forbidden":
                unknown = True
                otherwise = f"known are {', '.join(part.model_fields)}"
                hint = did_you_mean(str(error["loc"][-1]), part.model_fields, otherwise)
                lines.append(f"vary.{key}: unknown key; {hint}")
            else:
                lines.append(f"{key}: {in_words(error)}")
        raise (UnknownKey if unknown else RecipeError)(lines) from None


def content_hash(facts: Mapping[str, Any]) -> str:
    """Return the SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Places:
    """Where the files of a dataset are."""

    folder: Path

    @property
    def data(self) -> Path:
        """Folder of the samples."""
        return self.folder / "data"

    @property
    def sensors(self) -> Path:
        """Folder of the sensors."""
        return self.folder / "sensors"

    @property
    def meta(self) -> Path:
        """Folder of everything else."""
        return self.folder / "meta"

    @property
    def info(self) -> Path:
        """What the dataset is; written last of what must be there before the first sample."""
        return self.meta / "info.json"

    @property
    def sums(self) -> Path:
        """Checksums of all files; there only while the dataset is finished."""
        return self.meta / "SHA256SUMS"

    def shard(self, number: int) -> Path:
        """File of a shard's samples."""
        return self.data / f"part-{number:05d}.parquet"

    def sensor_shard(self, number: int) -> Path:
        """File of a shard's sensors."""
        return self.sensors / f"part-{number:05d}.parquet"
