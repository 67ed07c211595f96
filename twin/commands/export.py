"""`twin export`: a dataset in another program's format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from twin.commands.common import progress


def export(
    folder: Annotated[Path, Parameter(help="Folder of the dataset.")],
    *,
    format: Annotated[str, Parameter(help="hdf5, coco or webdataset.")],
    out: Annotated[Path, Parameter(help="Folder to write to.")],
) -> None:
    """Write a dataset as HDF5, as COCO keypoints, or as WebDataset tar files; failed samples are left out.

    Examples:
    twin export data/flat --format hdf5 --out flat_h5
    twin export data/flat --format coco --out flat_coco
    """
    from twin.study.dataset.export import export_dataset

    files = export_dataset(folder, format, out, progress())
    print(f"{files[0] if files else out}: {len(files)} file{'s' if len(files) != 1 else ''}")
