"""Make opencv.json: places in the picture by OpenCV's own lens models, and files of intrinsics as it writes them.

Needs opencv-python-headless (Apache-2.0) in an environment of its own: ``python tests/reference/make_opencv.py``.
"""

import json
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).parent
SIZE, FOCAL, ASPECT, CENTRE = (640, 480), 500.0, 1.02, (331.5, 228.25)
PINHOLE = [
    [-0.1, 0.02],
    [-0.1, 0.02, 0.003, -0.002],
    [-0.1, 0.02, 0.003, -0.002, 0.01],
    [0.2, 0.02, 0.003, -0.002, 0.01, 0.3, -0.01, 0.02],
]
FISHEYE = [[-0.02, 0.001, 0.0005, -0.0002]]


def main() -> None:
    """Write the reference."""
    rng = np.random.default_rng(4)
    matrix = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL * ASPECT, CENTRE[1]], [0, 0, 1]])
    zero = np.zeros(3)
    # In OpenCV's axes: x right, y down, z ahead.
    points = np.column_stack([rng.uniform(-0.6, 0.6, (40, 2)), np.ones(40)])
    rows = []
    for lens, sets in (("pinhole", PINHOLE), ("equidistant", FISHEYE)):
        for distortion in sets:
            padded = np.array([*distortion, 0.0, 0.0][: max(len(distortion), 4)])
            if lens == "pinhole":
                places, _ = cv2.projectPoints(points[:, None], zero, zero, matrix, padded)
            else:
                wide = points * [4, 4, 1]
                places, _ = cv2.fisheye.projectPoints(wide[:, None], zero, zero, matrix, padded)
            rows.append({"lens": lens, "distortion": distortion, "places_px": places[:, 0].tolist()})
    table = {"opencv": cv2.__version__, "focal_px": FOCAL, "aspect": ASPECT, "principal_px": CENTRE,
             "points": points.tolist(), "rows": rows}  # fmt: skip
    (HERE / "opencv.json").write_text(json.dumps(table, indent=1) + "\n")
    for name in ("opencv_camera.yml", "opencv_camera.json"):
        file = cv2.FileStorage(str(HERE / name), cv2.FILE_STORAGE_WRITE)
        file.write("image_width", SIZE[0])
        file.write("image_height", SIZE[1])
        file.write("camera_matrix", matrix)
        file.write("distortion_coefficients", np.array([PINHOLE[2]]))
        file.release()


if __name__ == "__main__":
    main()
