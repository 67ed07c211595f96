"""OpenCV's files of a camera's intrinsics (YAML or JSON): read and written.

They hold the size of the picture, focal lengths, principal point and distortion. Matrices are read
in OpenCV's form (``!!opencv-matrix``, or ``type_id`` in JSON) and in ROS's (a plain table of rows,
cols, data), and written in OpenCV's. A fisheye lens needs ``distortion_model`` or
``fisheye_model``, because its four coefficients look like a pinhole's.

Why PyYAML: its loader for plain data creates nothing but numbers, text, lists and tables, whatever
the file contains.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError, TwinError
from twin.files import write_whole
from twin.parts.camera import Camera

FISHEYE = ("fisheye", "equidistant", "kannala_brandt")
_DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")
_MATRIX = ("camera_matrix", "cameraMatrix", "K")
_LARGEST = 1_000_000


def read_intrinsics(file: str | Path) -> dict[str, Any]:
    """Read a camera's inner numbers.

    Parameters
    ----------
    file
        ``.json``, ``.yml`` or ``.yaml`` as OpenCV's calibration or ROS's writes it.

    Returns
    -------
    The keys of `twin.parts.camera.Camera` in the file: ``lens``, ``focal_px``, ``aspect``,
    ``principal_px``, ``distortion`` and, if there, ``width_px`` and ``height_px``.

    Raises
    ------
    InputError
        The file can't be read, or lacks a matrix, or holds a lens that this program doesn't know.

    Examples
    --------
    >>> import tempfile
    >>> import twin
    >>> camera = twin.load_scene("gelpad_press").camera
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     twin.write_intrinsics(camera, f"{folder}/camera.yml")
    ...     numbers = twin.read_intrinsics(f"{folder}/camera.yml")
    >>> numbers["lens"], numbers["width_px"]
    ('pinhole', 640)
    """
    path = Path(file)
    table = _table(path)
    matrix = _numbers(_first(table, _MATRIX, path), "camera_matrix", path)
    if matrix.size != 9:
        raise InputError(f"{path}: camera_matrix has {matrix.size} numbers; it must be 3 x 3")
    # The camera matrix: two focal lengths and the principal point, no skew.
    (fx, skew, cx), (below, fy, cy), last = matrix.reshape(3, 3)
    if (
        not (fx > 0 and fy > 0)
        or abs(skew) > 1e-9 * fx
        or below != 0
        or not np.array_equal(last, [0, 0, 1])
    ):
        raise InputError(
            f"{path}: camera_matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx and fy "
            f"above 0"
        )
    # The distortion: radial and tangential, or the four terms of a fisheye lens.
    distortion = _numbers(
        _first(table, _DISTORTION, path), "distortion_coefficients", path
    ).tolist()
    model = str(table.get("distortion_model", "")).lower()
    fisheye = model in FISHEYE or bool(table.get("fisheye_model", 0))
    if any(distortion[8:]):
        raise InputError(
            f"{path}: more than 8 distortion coefficients (thin prism, tilt): calibrate without "
            f"them"
        )
    if fisheye and len(distortion) > 4:
        raise InputError(f"{path}: {len(distortion)} distortion coefficients; a fisheye lens has 4")
    # The same in the keys of a camera table.
    keys: dict[str, Any] = {
        "lens": "equidistant" if fisheye else "pinhole",
        "focal_px": float(fx),
        "aspect": float(fy / fx),
        "principal_px": (float(cx), float(cy)),
        "distortion": tuple(distortion[:8]),
    }
    for name, key in (("image_width", "width_px"), ("image_height", "height_px")):
        if name in table:
            keys[key] = int(table[name])
    return keys


def write_intrinsics(camera: Camera, file: str | Path) -> None:
    """Write a camera's inner numbers for OpenCV, JSON if the file's name ends so, else YAML.

    Raises
    ------
    InputError
        The file can't be written (`TwinError` on a full disk), or the lens is none of OpenCV's.

    Examples
    --------
    >>> import tempfile
    >>> import twin
    >>> camera = twin.load_scene("gelpad_press").camera
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     twin.write_intrinsics(camera, f"{folder}/camera.json")
    ...     print(sorted(twin.read_intrinsics(f"{folder}/camera.json"))[:3])
    ['aspect', 'distortion', 'focal_px']
    """
    if camera.lens not in ("pinhole", "equidistant"):
        raise InputError(
            f"camera.lens = {camera.lens!r}: OpenCV's files know 'pinhole' and 'equidistant' alone"
        )
    # The numbers in OpenCV's order.
    path = Path(file)
    column, row = camera.centre_px
    fx = camera.focal_px
    fy = camera.focal_px * camera.aspect
    fisheye = camera.lens == "equidistant"
    padded = [*camera.distortion, *[0.0] * 4]
    length = 4 if len(camera.distortion) <= 4 else len(camera.distortion)
    matrices = {
        "camera_matrix": (3, 3, [fx, 0.0, column, 0.0, fy, row, 0.0, 0.0, 1.0]),
        "distortion_coefficients": (1, length, padded[:length]),
    }
    plain = {
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "fisheye_model": int(fisheye),
        "distortion_model": "fisheye" if fisheye else "brown_conrady",
    }
    # OpenCV's FileStorage, as JSON or as YAML 1.0.
    if path.suffix.lower() == ".json":
        tables = {
            name: {
                "type_id": "opencv-matrix",
                "rows": rows,
                "cols": columns,
                "dt": "d",
                "data": data,
            }
            for name, (rows, columns, data) in matrices.items()
        }
        text = json.dumps({**plain, **tables}, indent=4)
    else:
        lines = ["%YAML:1.0", "---", *(f"{key}: {value}" for key, value in plain.items())]
        for name, (rows, columns, data) in matrices.items():
            values = ", ".join(repr(float(value)) for value in data)
            lines += [
                f"{name}: !!opencv-matrix",
                f"   rows: {rows}",
                f"   cols: {columns}",
                "   dt: d",
            ]
            lines += [f"   data: [ {values} ]"]
        text = "\n".join(lines)
    write_whole(path, f"{text}\n".encode())


def _table(path: Path) -> dict[str, Any]:
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is no file")
    try:
        data = path.read_bytes()
    except OSError as problem:
        raise TwinError.unreadable(path, problem) from None
    if len(data) > _LARGEST:
        raise InputError(f"{path}: {len(data)} bytes; a file of intrinsics is at most 1 MB")
    try:
        text = data.decode("utf-8-sig")
        table = json.loads(text) if path.suffix.lower() == ".json" else _yaml(text)
    except (ValueError, RecursionError) as problem:
        raise InputError(
            f"{path}: not valid JSON or YAML: {str(problem).splitlines()[0]}"
        ) from None
    if not isinstance(table, dict):
        raise InputError(
            f"{path}: must hold a table with camera_matrix and distortion_coefficients"
        )
    return table


def _yaml(text: str) -> Any:
    """Parse OpenCV's YAML, whose first line and matrix tag are its own."""
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(
                yaml.events.AliasEvent
            ):  # a few lines of them stand for a billion numbers
                raise yaml.YAMLError("it refers to itself (*name): write the numbers out")
            return super().compose_node(parent, index)

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, deep=True),
    )
    lines = text.splitlines()
    if lines and lines[0].startswith("%YAML"):
        lines = lines[1:]
    try:
        return yaml.load("\n".join(lines), Loader)
    except yaml.YAMLError as problem:
        raise ValueError(problem) from None


def _first(table: dict[str, Any], names: tuple[str, ...], path: Path) -> Any:
    for name in names:
        if name in table:
            return table[name]
    raise InputError(
        f"{path}: has no {names[0]}; it holds {', '.join(map(str, table)) or 'nothing'}"
    )


def _numbers(value: Any, name: str, path: Path) -> np.ndarray:
    data = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.asarray(data, float).ravel()
    except (TypeError, ValueError):
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise InputError(f"{path}: {name} must hold finite numbers")
    return numbers
