"""Train a ridge regression on a dataset: total force from marker shifts, against a named baseline.

    twin dataset dataset_kamiyama --samples 2500 --columns force_n,marker_pressed_px --out data/flat
    python docs/examples/read_force.py data/flat

Input: the shift of every marker in the picture with 0.02 px of tracking noise, times the sensor's Young's modulus,
which a calibration tells, as force is modulus times strain. Baseline, "mean shift": least squares on the mean shift of
each layer along each axis and its mean length, which is what a sensor without a force field would be calibrated with.
The first 80 % of the samples train, the rest tests; the ridge's weight is chosen on the last fifth of those that train.
"""

from __future__ import annotations

import json
import sys

import numpy as np

import twin

NOISE_PX = 0.02


def inputs(data: twin.study.dataset.reader.DatasetReader) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (n, m, 2) shifts times modulus, (m,) layer numbers, and (n, 3) forces."""
    rng = np.random.default_rng(0)
    shifts, forces = [], []
    layer = np.zeros(0, int)
    for sample in data:
        if sample["status"] != "ok":
            continue
        sensor = data.sensor(sample["sensor"])
        modulus = json.loads(sensor["actual"])["material"]["youngs_modulus_mpa"]
        counts = [count for _, count in json.loads(sensor["marker_layer"])]
        layer = np.repeat(np.arange(len(counts)), counts)
        shift = sample["marker_pressed_px"] - sensor["marker_rest_px"]
        shifts.append(modulus * (shift + rng.normal(0, NOISE_PX, shift.shape)))
        forces.append(sample["force_n"])
    return np.array(shifts), layer, np.array(forces)


def ridge(x: np.ndarray, y: np.ndarray, weight: float) -> np.ndarray:
    """Return the (features + 1, 3) coefficients that minimise the squared error plus weight times their squares."""
    mean = x.mean(axis=0)
    kernel = (x - mean) @ (x - mean).T
    slope = (x - mean).T @ np.linalg.solve(kernel + weight * np.eye(len(x)), y - y.mean(axis=0))
    return np.vstack([slope, y.mean(axis=0) - mean @ slope])


def error(x: np.ndarray, y: np.ndarray, coefficients: np.ndarray) -> float:
    """Return the root mean square length of the error of the force, N."""
    return float(np.sqrt(np.mean(np.sum((x @ coefficients[:-1] + coefficients[-1] - y) ** 2, axis=1))))


def compare(folder: str) -> dict[str, float]:
    """Return the test errors in N of the ridge, of the mean shift, and of always saying the mean force."""
    shifts, layer, forces = inputs(twin.open_dataset(folder))
    train = slice(0, int(0.8 * len(forces)))
    test = slice(train.stop, len(forces))
    flat = shifts.reshape(len(shifts), -1)
    fit, check = slice(0, int(0.8 * train.stop)), slice(int(0.8 * train.stop), train.stop)
    scale = float(np.sum((flat[train] - flat[train].mean(axis=0)) ** 2)) / train.stop
    weights = scale * 10.0 ** np.arange(-6, 2.5, 0.5)
    best = min(weights, key=lambda w: error(flat[check], forces[check], ridge(flat[fit], forces[fit], w)))
    means = [shifts[:, layer == k].mean(axis=1) for k in np.unique(layer)]
    lengths = [np.linalg.norm(shifts[:, layer == k], axis=2).mean(axis=1)[:, None] for k in np.unique(layer)]
    few = np.hstack([*means, *lengths])
    constant = np.vstack([np.zeros((1, 3)), forces[train].mean(axis=0)])
    return {
        "samples": len(forces),
        "ridge": error(flat[test], forces[test], ridge(flat[train], forces[train], best)),
        "mean shift": error(few[test], forces[test], ridge(few[train], forces[train], 1e-9 * scale)),
        "mean force": error(np.zeros((test.stop - test.start, 1)), forces[test], constant),
    }


if __name__ == "__main__":
    for name, value in compare(sys.argv[1]).items():
        print(f"{name:12s} {value:.4g}" + ("" if name == "samples" else " N, root mean square"))
