"""A description that rests on an STL file: the file is checked, and its digest goes wherever the description goes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field, field_validator, model_validator

from twin.errors import InputError
from twin.parts.part import Part


def each_file(value: Any, changed: Callable[[str], str]) -> Any:
    """Return a plain value in which every probe's own file (``kind = "stl"``), however deep, has another name."""
    if isinstance(value, Mapping):
        table = {key: each_file(inner, changed) for key, inner in value.items()}
        own = table.get("kind") == "stl" and isinstance(table.get("file"), str)
        return {**table, "file": changed(table["file"])} if own else table
    return [each_file(inner, changed) for inner in value] if isinstance(value, list | tuple) else value


class StlFile(Part):
    """The inside of a closed STL surface.

    Attributes
    ----------
    file
        STL file in mm, relative to the recipe.
    sha256
        Digest of the file; filled in when it is read, checked when it is given.
    """

    largest_mm: ClassVar[tuple[float, float]]
    """Allowed longest side of the box around the surface, mm."""

    file: str
    sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$")

    @field_validator("file")
    @classmethod
    def _is_a_closed_surface(cls, file: str) -> str:
        from twin.geometry.closed import read_surface

        try:
            read_surface(file, cls.largest_mm)
        except InputError as problem:
            raise ValueError(str(problem)) from None
        return file

    @model_validator(mode="before")
    @classmethod
    def _carries_a_digest(cls, table: Any) -> Any:
        """Fill in the digest of the file, so that hashes and copies of the description stand for its content."""
        if isinstance(table, dict) and isinstance(table.get("file"), str) and not table.get("sha256"):
            path = Path(table["file"])
            if path.is_file():
                return {**table, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        return table

    @model_validator(mode="after")
    def _file_is_the_one(self) -> StlFile:
        found = hashlib.sha256(Path(self.file).read_bytes()).hexdigest()
        if self.sha256 != found:
            raise ValueError(
                f"sha256 = {self.sha256[:12]}... but {Path(self.file).name} has {found[:12]}...: the file was changed; "
                "leave sha256 out to take the new one"
            )
        return self
