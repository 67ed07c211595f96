"""Tracking on what cameras deliver: markers kept, error, stated deviation and their ratio, condition by condition.

Pictures are drawn as in `benchmarks.tracking`, with layers of 80 and 63 markers that move by up to 3.5 px. JPEG is
Pillow's, H.264 is ffmpeg's. ``chi`` is the root mean square of error over stated deviation, per axis;
``over_bound`` the error over Cramer and Rao's bound for the clean picture; ``wrong`` the share of all markers with a
shift that is off by more than a pixel, ``silent`` of those off by more than five stated deviations and .05 px.
"""

import io
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import convolve, gaussian_filter

from benchmarks.discs import GROUND_DN, bound_px, cover, expose
from twin.sense.track import Found, Tracker, track

COLUMNS, ROWS = 10, 8


class Card:
    """A drawn sensor: two layers of markers ``diameter`` px wide, in the picture's middle."""

    def __init__(self, diameter: float, margin: float = 1.0) -> None:
        self.diameter, self.pitch = diameter, max(30.0, 2.3 * diameter)
        self.size = tuple(round((n - 1 + 2 * margin) * self.pitch) for n in (COLUMNS, ROWS))
        self.layout = {}
        for name, less in (("red", 0), ("blue", 1)):
            grid = np.stack(np.meshgrid(np.arange(COLUMNS - less), np.arange(ROWS - less), indexing="ij"), -1)
            self.layout[name] = (grid.reshape(-1, 2) + 0.5 * less + margin) * self.pitch - 0.5
        self.marks = np.concatenate(list(self.layout.values()))
        self.count = len(self.layout["red"])
        self.bound = np.sqrt(2) * bound_px(diameter)

    def draw(
        self,
        shift: Any = 0.0,
        psf: float = 0.7,
        gain: Any = 1.0,
        shade: Any = None,
        stretch: Any = None,
        grain: Any = 0.0,
    ) -> np.ndarray:
        """Return a noise-free (h, w, 3) picture; ``stretch`` (N, 2, 2) deforms every marker's outline; ``grain`` (h, w)
        is the ground's, which opaque markers hide."""
        moved = self.marks + shift
        picture, bare = np.full((self.size[1], self.size[0], 3), GROUND_DN), np.ones(self.size[::-1])
        for channel, rows in ((0, slice(self.count)), (2, slice(self.count, None))):
            part = None if stretch is None else stretch[rows]
            covered = cover(self.size, moved[rows], self.diameter, psf, shade, part)
            picture[..., channel] += 130.0 * covered
            bare -= covered
        return (picture + (grain * np.fmax(bare, 0.0))[..., None]) * np.asarray(gain)

    def grain(self, counts: float, width_px: float, moved: Any = (0, 0)) -> np.ndarray:
        """Return (h, w) light and dark grains of a standard deviation, moved by whole pixels (column, row)."""
        even = np.random.default_rng(3).normal(0.0, 1.0, self.size[::-1])
        grains = gaussian_filter(even, width_px / 2, mode="wrap")
        return np.roll(counts / grains.std() * grains, moved[::-1], (0, 1))

    def shifts(self, seed: int) -> np.ndarray:
        """Return (N, 2) motion of up to 3.5 px."""
        return np.random.default_rng(seed).uniform(-3.5, 3.5, self.marks.shape)


def jpeg(image: np.ndarray, quality: int = 85, chroma: int = 2) -> np.ndarray:
    """Return the picture after JPEG; ``chroma`` 2 is 4:2:0, 0 is 4:4:4."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "JPEG", quality=quality, subsampling=chroma)
    return np.array(Image.open(stream))


def mosaic(image: np.ndarray) -> np.ndarray:
    """Return the colours of an RGGB mosaic, interpolated bilinearly."""
    row, column = np.indices(image.shape[:2]) % 2
    green = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4
    other = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    out = np.empty(image.shape)
    for channel, kernel in enumerate((other, green, other)):
        out[..., channel] = convolve(image[..., channel] * (row + column == channel), kernel, mode="mirror")
    return np.clip(np.rint(out), 0, 255).astype(np.uint8)


def film(images: list[np.ndarray], bit_rate: str = "4M") -> list[np.ndarray]:
    """Return the pictures after an H.264 film of 60 frames a second."""
    from imageio_ffmpeg import get_ffmpeg_exe

    height, width = (n // 2 * 2 for n in images[0].shape[:2])
    raw, size = ["-f", "rawvideo", "-pix_fmt", "rgb24"], ["-s", f"{width}x{height}", "-r", "60"]
    data = np.ascontiguousarray(np.array(images)[:, :height, :width]).tobytes()
    with tempfile.TemporaryDirectory() as folder:
        path, start = os.path.join(folder, "film.mp4"), [get_ffmpeg_exe(), "-v", "error"]
        code = ["-c:v", "libx264", "-b:v", bit_rate, "-pix_fmt", "yuv420p", path]
        subprocess.run([*start, *raw, *size, "-i", "-", *code], input=data, check=True)
        back = subprocess.run([*start, "-i", path, *raw, "-"], capture_output=True, check=True).stdout
    return list(np.frombuffer(back, np.uint8).reshape(-1, height, width, 3))


def chord(area: float) -> float:
    """Return how deep, in diameters, a straight edge cuts off a share of a disc's area."""
    depth = np.linspace(0.0, 1.0, 10_001)
    angle = np.arccos(1 - 2 * depth)
    return float(np.interp(area, (angle - np.sin(angle) * np.cos(angle)) / np.pi, depth))


def row(
    condition: str, diameter: float, found: list[tuple[Found, np.ndarray]], bound: float, of: Any
) -> dict[str, Any]:
    """Return what came of the markers ``of`` in pictures, each with its true (N, 2) shifts."""
    shift, true = (np.concatenate(p) for p in zip(*((f.shift_px[of], t[of]) for f, t in found), strict=True))
    sd = np.concatenate([f.sd_px[of] for f, _ in found])
    seen, error = np.isfinite(shift[:, 0]), shift - true
    wrong = seen & ~(np.hypot(*error.T) < 1.0)
    fine = seen & ~wrong
    rms = float(np.sqrt(np.mean(error[fine] ** 2))) if fine.any() else np.nan
    score = (error[seen] / sd[seen, None]) ** 2
    off = np.abs(error[seen])
    silent = ((off > 5 * sd[seen, None]) & (off > 0.05)).any(axis=1).sum() / len(seen)
    return {
        "condition": condition, "diameter_px": diameter, "kept": float(seen.mean()), "wrong": float(wrong.mean()),
        "silent": float(silent),
        "error_px": rms, "over_bound": rms / bound,
        "stated_px": float(np.sqrt(np.mean(sd[fine] ** 2))) if fine.any() else np.nan,
        "chi": float(np.sqrt(score.mean())) if seen.any() else np.nan,
    }  # fmt: skip


def stretches(count: int, ratio: float, random: np.random.Generator) -> np.ndarray:
    """Return (count, 2, 2) stretches of an axis ratio, of the same area, along any direction."""
    angle = random.uniform(0, np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    across = np.stack([-np.sin(angle), np.cos(angle)], -1)
    parts = [s * v[:, :, None] * v[:, None, :] for s, v in ((ratio**0.5, along), (ratio**-0.5, across))]
    return np.asarray(parts[0] + parts[1])


def specks(size: Any, count: int, random: np.random.Generator) -> np.ndarray:
    """Return (h, w) light that dust on the window lets through."""
    dark = np.zeros((size[1], size[0]))
    np.maximum.at(dark, (random.integers(0, size[1], count), random.integers(0, size[0], count)), 1.0)
    spread = gaussian_filter(dark, 1.2)
    return 1.0 - 0.5 * spread / spread.max()


def hidden(
    card: Card, drawn: np.ndarray, shift: np.ndarray, which: np.ndarray, area: float, seed: int, psf: float = 0.7
) -> np.ndarray:
    """Return the picture with that share of some markers' area covered in the ground's colour, from any side."""
    random, depth = np.random.default_rng(seed), chord(area) * card.diameter
    for marker in which:
        turn = random.uniform(0, 2 * np.pi)
        centre = card.marks[marker : marker + 1] + shift[marker]

        def seen(dx: Any, dy: Any, _x: float, _y: float, turn: float = turn) -> Any:
            return dx * np.cos(turn) + dy * np.sin(turn) < 0.5 * card.diameter - depth

        whole, part = (cover(card.size, centre, card.diameter, psf, s) for s in (None, seen))
        drawn[..., 0 if marker < card.count else 2] += 130.0 * (part - whole)
    return drawn


def conditions(diameter: float, repeats: int) -> Iterator[dict[str, Any]]:
    """Yield a row of each condition."""
    card = Card(diameter)
    every, some = np.arange(len(card.marks)), np.arange(len(card.marks))[::5]
    shifts = [card.shifts(10 + i) for i in range(repeats)]
    rest = expose(card.draw(), 1)

    def shown(i: int, hide: float = 0.0, **how: Any) -> np.ndarray:
        """Return picture ``i``, drawn as told, with a share of some markers hidden."""
        drawn = card.draw(shifts[i], **how)
        return expose(hidden(card, drawn, shifts[i], some, hide, i, how.get("psf", 0.7)) if hide else drawn, 20 + i)

    def measured(
        name: str, first: np.ndarray = rest, camera: Callable[[np.ndarray], np.ndarray] = np.asarray, **how: Any
    ) -> dict[str, Any]:
        """Return the row of pictures that a camera delivers, after its picture of ``first``."""
        found = [(track(camera(first), camera(shown(i, **how)), card.layout), shifts[i]) for i in range(repeats)]
        return row(name, diameter, found, card.bound, some if "hide" in how else every)

    def lit(name: str, **how: Any) -> dict[str, Any]:
        """Return the row of what is there at rest as well."""
        return measured(name, expose(card.draw(**how), 1), **how)

    yield measured("clean")
    for area in (0.05, 0.14, 0.31, 0.5):
        yield measured(f"{100 * area:.0f} % of the area hidden", hide=area)
    for area in (0.01, 0.02):
        name = f"blur 1.6 px, {100 * area:.0f} % of the area hidden"
        yield measured(name, expose(card.draw(psf=1.6), 1), hide=area, psf=1.6)
    for area in (0.05, 0.14, 0.31):
        yield measured(f"JPEG 85, {100 * area:.0f} % of the area hidden", camera=jpeg, hide=area)
    for ratio in (1.3, 1.5, 1.8):
        turned = stretches(len(every), ratio, np.random.default_rng(5))
        yield measured(f"strained, axis ratio {ratio}", stretch=turned)
    for psf in (1.3, 1.6, 2.0):
        yield measured(f"blur 0.7 to {psf} px", psf=psf)
    yield measured("JPEG 85, 4:2:0", camera=jpeg)
    yield measured("JPEG 60, 4:2:0", camera=lambda p: jpeg(p, 60))
    yield measured("JPEG 85, 4:4:4", camera=lambda p: jpeg(p, 85, 0))
    yield measured("colour mosaic", camera=mosaic)
    yield measured("colour mosaic and JPEG 85", camera=lambda p: jpeg(mosaic(p)))
    frames = film([rest, *(shown(i) for i in range(repeats))])
    found = [(track(frames[0], frame, card.layout), s) for frame, s in zip(frames[1:], shifts, strict=True)]
    yield row("H.264, 4 Mbit/s", diameter, found, card.bound, every)
    glint = lambda dx, dy, x, y: 1 + 0.8 * np.exp(-0.5 * ((dx - 0.2 * diameter) ** 2 + dy**2))  # noqa: E731
    yield lit("a glint on every marker", shade=glint)
    yield measured("glints that weren't at rest", shade=glint)
    dust = specks(card.size, card.size[0] * card.size[1] // 600, np.random.default_rng(6))
    yield lit("dust on the window", gain=dust[..., None])
    yield lit("grained ground that stays", grain=card.grain(5.0, 4.0))
    hot = np.random.default_rng(7).random(rest.shape) < 1e-3
    yield measured("hot pixels, 1 in 1000", camera=lambda p: np.where(hot, 255, p).astype(np.uint8))
    for gain in (0.6, 1.5, 2.2):
        yield measured(f"gain x {gain}", gain=gain)
    row_, column = np.indices(rest.shape[:2]) - (np.array(rest.shape[:2]) / 2)[:, None, None]
    fall = 1.0 - 0.72 * (row_**2 + column**2) / (np.array(rest.shape[:2]) ** 2 / 4).sum()
    yield lit("vignetting to 0.28", gain=fall[..., None])


def motions(diameter: float) -> Iterator[dict[str, Any]]:
    """Yield a row of each large motion from a cold start."""
    card = Card(diameter, 2.5)
    away = card.marks - np.array(card.size) / 2
    bump = 1.5 * card.pitch * np.exp(-0.5 * (away**2).sum(axis=1) / (3.5 * card.pitch) ** 2)[:, None]
    rest = expose(card.draw(), 1)
    for name, shift in (
        ("jump of 1.5 pitches", np.tile([1.5 * card.pitch, 0.0], (len(away), 1))),
        ("jump of 1.5 pitches, askew", np.tile([1.2 * card.pitch, 0.9 * card.pitch], (len(away), 1))),
        ("stretch of 12 %", 0.12 * away),
        ("bump of 1.5 pitches", bump * [0.8, 0.6]),
    ):
        found = track(rest, expose(card.draw(shift), 2), card.layout)
        yield row(f"cold, {name}", diameter, [(found, shift)], card.bound, np.arange(len(away)))


def borders(diameter: float) -> Iterator[dict[str, Any]]:
    """Yield rows of markers near the frame: whole ones, and ones that it cuts by up to a quarter."""
    for name, margin in (("whole, up to the frame", 0.5), ("cut by the frame by a sixth", 0.33)):
        card = Card(diameter, margin * diameter / max(30.0, 2.3 * diameter))
        shift = np.random.default_rng(3).uniform(0.0, 0.5, card.marks.shape) * np.sign(np.mean(card.marks) - card.marks)
        near = (np.minimum(card.marks, np.array(card.size) - card.marks) < 0.6 * diameter).any(axis=1)
        found = track(expose(card.draw(), 1), expose(card.draw(shift), 2), card.layout)
        yield row(name, diameter, [(found, shift)], card.bound, near)


def over_layers(diameter: float, repeats: int) -> dict[str, Any]:
    """Return the row of a layer that has moved over the other: it covers what is below it."""
    card, found = Card(diameter), []
    rest = expose(card.draw(), 1)
    for i in range(repeats):
        shift = card.shifts(10 + i)
        shift[card.count :] += 0.5 * card.pitch - (0.35 + 0.1 * i) * diameter
        drawn = card.draw(shift)
        red = cover(card.size, (card.marks + shift)[: card.count], diameter, 0.7)
        drawn[..., 2] = GROUND_DN + (drawn[..., 2] - GROUND_DN) * (1 - red)
        tracker = Tracker(rest, card.layout)
        for part in (0.3, 0.6, 1.0):
            half = card.draw(part * shift) if part < 1 else drawn
            seen = tracker.track(expose(half, 20 + i + round(100 * (1 - part))))
        found.append((seen, shift))
    return row("layers that overlap", diameter, found, card.bound, np.arange(len(card.marks)))


def textures(diameter: float) -> Iterator[dict[str, Any]]:
    """Yield rows of irregular prints (outline and brightness of each its own), moved by a smooth field."""
    card = Card(diameter)

    def print_(dx: Any, dy: Any, x: float, y: float) -> Any:
        column, row = round(2 * (x + 0.5) / card.pitch), round(2 * (y + 0.5) / card.pitch)
        first = np.random.default_rng(1000 * column + row)
        angle, edge = np.arctan2(dy, dx), first.normal(0, 0.03, (2, 4))
        outline = 1 + sum(e[0] * np.cos((k + 2) * angle) + e[1] * np.sin((k + 2) * angle) for k, e in enumerate(edge.T))
        return (np.hypot(dx, dy) < 0.46 * diameter * outline) * (1 + first.normal(0, 0.1))

    shift = np.stack([1.5 * np.sin(card.marks[:, 1] / 80), 1.5 * np.cos(card.marks[:, 0] / 90)], -1)
    pair = [expose(card.draw(s, shade=print_), i) for i, s in enumerate((0.0, shift))]
    every = np.arange(len(card.marks))
    yield row("irregular prints", diameter, [(track(*pair, card.layout), shift)], card.bound, every)
    lossy = [jpeg(p) for p in pair]
    yield row("irregular prints, JPEG 85", diameter, [(track(*lossy, card.layout), shift)], card.bound, every)


def measure(quick: bool) -> list[dict[str, Any]]:
    """Return the rows of all conditions; the quick form has one diameter and fewer pictures."""
    rows: list[dict[str, Any]] = []
    for diameter in (10.0,) if quick else (10.0, 15.0):
        rows += conditions(diameter, 2 if quick else 6)
        rows += [*motions(diameter), *borders(diameter), over_layers(diameter, 2 if quick else 4), *textures(diameter)]
    return rows
