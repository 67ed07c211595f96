"""What a sensor feels, as ROS 2 messages: plain tables under the messages' own field names, without
ROS.

- image (sensor_msgs/msg/Image): CCD picture, ``rgb8`` or ``rgb16``
- camera_info (sensor_msgs/msg/CameraInfo): nominal lens as in air, without the layers
- wrench (geometry_msgs/msg/WrenchStamped): recovered total force and torque about the origin
- wrench_true (the same): the true ones; no real sensor has this topic
- force_field (sensor_msgs/msg/PointCloud2): recovered, by site: x, y, z (m), fx, fy, fz (N)

Units are ROS's (REP 103): metres, newtons, newton metres. The frame is the sensor's own,
right-handed: origin on the sensing surface, z into the body; forces are the world's on the body.
Pictures are in ``FRAME_optical``, whose z looks out of the camera (towards -z of the sensor), x to
the right and y down in the picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.errors import InputError
from twin.parts.camera import Camera
from twin.study.environment import Observation

Table = dict[str, Any]
Messages = dict[str, tuple[str, Table]]

M_PER_MM = 1e-3
_FLOAT32 = 7
"""sensor_msgs/msg/PointField.FLOAT32."""

_MODELS = {0: "plumb_bob", 2: "plumb_bob", 4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}


def ros_messages(
    observation: Observation, camera: Camera, *, stamp_ns: int = 0, frame_id: str = "tactile_sensor"
) -> Messages:
    """Return the messages of one step: type and fields by topic.

    Parameters
    ----------
    observation
        Of `Environment.step`.
    camera
        The scene's nominal camera.
    stamp_ns
        Time of the exposure, nanoseconds since the epoch.
    frame_id
        Name of the sensor's frame.

    Raises
    ------
    InputError
        The time is negative, or the lens is none of ROS's.
    """
    if stamp_ns < 0 or stamp_ns >= 2**31 * 10**9:
        raise InputError(
            f"stamp_ns = {stamp_ns}: allowed are 0 to {2**31 * 10**9 - 1} ns, as ROS 2 counts "
            f"seconds"
        )
    here = _header(stamp_ns, frame_id)
    there = _header(stamp_ns, f"{frame_id}_optical")
    truth = observation.truth
    return {
        "image": ("sensor_msgs/msg/Image", _image(there, observation.picture)),
        "camera_info": ("sensor_msgs/msg/CameraInfo", _camera_info(camera, there)),
        "wrench": _wrench(here, observation.total_force_n, observation.total_torque_nmm),
        "wrench_true": _wrench(here, truth.total_force_n, truth.total_torque_nmm),
        "force_field": (
            "sensor_msgs/msg/PointCloud2",
            _cloud(here, observation.site_mm, observation.force_n),
        ),
    }


def _camera_info(camera: Camera, header: Table) -> Table:
    """Return the fields of sensor_msgs/msg/CameraInfo.

    Raises
    ------
    InputError
        The lens is none of ROS's.
    """
    known = {"pinhole": _MODELS.get(len(camera.distortion)), "equidistant": "equidistant"}
    model = known.get(camera.lens)
    if model is None:
        raise InputError(
            f"camera.lens = {camera.lens!r}: ROS knows 'pinhole' and 'equidistant' alone"
        )
    count = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}[model]
    fx = camera.focal_px
    fy = camera.focal_px * camera.aspect
    cx, cy = camera.centre_px
    coefficients = np.array([*camera.distortion, *[0.0] * count][:count])
    return {
        "header": header,
        "height": camera.height_px,
        "width": camera.width_px,
        "distortion_model": model,
        "d": coefficients,
        "k": np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
        "r": np.eye(3).ravel(),
        "p": np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _header(stamp_ns: int, frame_id: str) -> Table:
    seconds, rest = divmod(stamp_ns, 10**9)
    return {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame_id}


def _image(header: Table, picture: np.ndarray) -> Table:
    height, width, _ = picture.shape
    size = picture.dtype.itemsize
    return {
        "header": header,
        "height": height,
        "width": width,
        "encoding": f"rgb{8 * size}",
        "is_bigendian": 0,
        "step": 3 * width * size,
        "data": np.ascontiguousarray(picture).reshape(-1).view(np.uint8),
    }


def _wrench(header: Table, force_n: np.ndarray, torque_nmm: np.ndarray) -> tuple[str, Table]:
    def vector(values: np.ndarray) -> Table:
        return dict(zip("xyz", map(float, values), strict=True))

    wrench = {"force": vector(force_n), "torque": vector(M_PER_MM * np.asarray(torque_nmm))}
    return "geometry_msgs/msg/WrenchStamped", {"header": header, "wrench": wrench}


def _cloud(header: Table, site_mm: np.ndarray, force_n: np.ndarray) -> Table:
    rows = np.column_stack([M_PER_MM * np.asarray(site_mm), force_n]).astype("<f4")
    names = ("x", "y", "z", "fx", "fy", "fz")
    fields = [
        {"name": name, "offset": 4 * k, "datatype": _FLOAT32, "count": 1}
        for k, name in enumerate(names)
    ]
    return {
        "header": header,
        "height": 1,
        "width": len(rows),
        "fields": fields,
        "is_bigendian": False,
        "point_step": 24,
        "row_step": 24 * len(rows),
        "data": np.frombuffer(rows.tobytes(), np.uint8),
        "is_dense": True,
    }
