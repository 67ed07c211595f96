"""Calibrate a camera from pictures of a checkerboard, into a file that a recipe's `intrinsics` names.

    pip install opencv-python-headless
    python docs/examples/checkerboard.py board 9 6 camera.yaml

`board` is a folder of ten pictures or more (PNG, JPEG, BMP) of one printed board, held at different places and slants,
sharp, up to the corners of the picture; 9 and 6 count the inner corners, where four squares meet. The size of the
squares doesn't matter. The lens is OpenCV's: three radial terms and two tangential ones.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

ENDINGS = {".png", ".jpg", ".jpeg", ".bmp"}


def calibrate(folder: Path, columns: int, rows: int, out: Path) -> str:
    """Write the camera file; return how many boards were found and how well they are explained."""
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    found, size = [], None
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in ENDINGS)
    for file in files:
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if picture is None or picture.shape[::-1] != (size or picture.shape[::-1]):
            sys.exit(f"{file}: is no picture, or not of the size of those before")
        size = picture.shape[::-1]
        seen, corners = cv2.findChessboardCornersSB(picture, (columns, rows))
        if seen:
            found.append(corners)
        else:
            print(f"{file}: no board of {columns} x {rows} inner corners")
    if len(found) < 5:
        sys.exit(f"{folder}: boards in {len(found)} of {len(files)} pictures; at least 5 are needed")
    off_px, matrix, distortion, *_ = cv2.calibrateCamera([board] * len(found), found, size, None, None)
    store = cv2.FileStorage(str(out), cv2.FILE_STORAGE_WRITE)
    store.write("image_width", size[0])
    store.write("image_height", size[1])
    store.write("camera_matrix", matrix)
    store.write("distortion_coefficients", distortion)
    store.release()
    return f"{out}: {len(found)} of {len(files)} pictures, corners {off_px:.2f} px off (root mean square)"


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    print(calibrate(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])))
