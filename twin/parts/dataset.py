"""How a dataset is drawn from a scene and cut into files."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from twin.parts.part import Part
from twin.parts.pipeline import Sites


class Dataset(Part):
    """How ``twin dataset`` draws and stores samples of a scene.

    Attributes
    ----------
    sampling
        ``stratified``: a scrambled Sobol' sequence, which fills the space of what varies more evenly; ``random``:
        independent draws. Either way a sample is known from the scene's seed and its number alone.
    samples_per_sensor
        After how many samples the next sensor is made: keys in ``[vary]`` that do not begin with ``press.``, and the
        tolerances, are drawn once for each sensor. Every sensor has one rest picture.
    samples_per_shard
        Samples in one file; what is lost at most when a worker is killed.
    every_step
        Keep the state after every step of a press's path, not just the last.
    sites
        Grid over the surface into whose cells tractions are summed; every contact must lie inside it.
    columns
        Which columns are kept (all if empty); what none of them needs is not computed.
    """

    sampling: Literal["stratified", "random"] = "stratified"
    samples_per_sensor: int = Field(default=1000, ge=1, le=10**9)
    samples_per_shard: int = Field(default=64, ge=1, le=100_000)
    every_step: bool = False
    sites: Sites | None = None
    columns: tuple[str, ...] = ()
