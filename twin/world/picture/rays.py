"""Tracing a picture ray by ray with Mitsuba's scalar variant, which runs on every machine.

The same sum as in `twin.world.picture.wavefront`, numpy around single rays; a test holds the two together. About a
second a picture instead of a tenth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from twin.arrays import Bools, Floats, Ints, Singles
from twin.world.picture.frame import DEPTH, INSIDE, INTO, OPAQUE, STEP, Frame
from twin.world.picture.shape import Shape
from twin.world.picture.view import View


class RayByRay:
    """Camera rays and shadow rays, one after the other."""

    def __init__(self, mi: Any, view: View, unit_mm: float, ambient: float) -> None:
        self._mi = mi
        self._padded, self._exact = Shape(mi), Shape(mi)
        self._corners = view.corners / [unit_mm, unit_mm, 1, 1]
        self._ambient = ambient

    def shade(self, frame: Frame) -> tuple[Singles, Singles]:
        """Return (m, 3) light from markers in the frame's pixels, and (m,) the share of each that they leave free."""
        padded, exact = self._padded.hold(frame.padded), self._exact.hold(frame.exact)
        light, free = np.zeros((len(frame.near.pixels), 3)), np.zeros(len(frame.near.pixels))
        for sample in range(frame.subpixels**2):
            for lane, marker, covers, surface, normal, clear in self._walk(frame, padded, sample, free, OPAQUE):
                bright = (1 - self._ambient) * self._irradiance(frame, exact, marker, surface, normal) + self._ambient
                light[lane] += frame.colour[marker] * (bright * covers * clear)[:, None]
        share = np.float32(1 / frame.subpixels**2)
        return light.astype(np.float32) * share, free.astype(np.float32) * share

    def _walk(self, frame: Frame, padded: Any, sample: int, free: Floats, opaque: float) -> Any:
        """Follow one sub-pixel's rays from marker to marker and yield what they meet, front to back.

        Yields lanes, markers, coverages, places on the surface from the centres, normals, and the share that is still
        clear in front of each. Adds what stays clear to ``free``.
        """
        starts, along, place = self._rays(frame, sample)
        lane = np.arange(len(starts))
        clear, last = np.ones(len(starts)), np.full(len(starts), -1)
        for _ in range(DEPTH):
            marker, distance = self._first(padded, starts[lane], along[lane])
            hit = marker >= 0
            lane, marker, distance = lane[hit], marker[hit], distance[hit]
            covers, surface, normal = _meet(frame, marker, starts[lane], along[lane], place[lane])
            fresh = marker != last[lane]
            chosen = lane[fresh]
            yield chosen, marker[fresh], covers[fresh], surface[fresh], normal[fresh], clear[chosen].copy()
            clear[chosen] *= 1 - covers[fresh]
            starts[lane] += along[lane] * (distance + STEP)[:, None]
            last[lane] = marker
            lane = lane[clear[lane] > opaque]
            if not len(lane):
                break
        free += clear

    def _rays(self, frame: Frame, sample: int) -> tuple[Floats, Floats, Floats]:
        """Return (m, 3) starts, (m, 3) directions and (m, 2) places in px of one sub-pixel of every pixel."""
        k, c = frame.subpixels, self._corners
        row, column = np.divmod(frame.near.pixels, c.shape[1] - 1)
        across, down = (sample % k + 0.5) / k, (sample // k + 0.5) / k
        upper = c[row, column] * (1 - across) + c[row, column + 1] * across
        lower = c[row + 1, column] * (1 - across) + c[row + 1, column + 1] * across
        ray = upper * (1 - down) + lower * down
        starts = np.column_stack([ray[:, :2] + ray[:, 2:] * frame.starts[:, :1], frame.starts[:, 1]])
        along = np.column_stack([ray[:, 2:], -np.ones(len(ray))])
        place = np.column_stack([column + across - 0.5, row + down - 0.5])
        return starts, along / np.linalg.norm(along, axis=1, keepdims=True), place

    def _first(self, scene: Any, starts: Floats, along: Floats) -> tuple[Ints, Floats]:
        """Return the (m,) first marker on each ray, -1 for none, and the distance."""
        ray, point, vector, meet = self._mi.Ray3f, self._mi.Point3f, self._mi.Vector3f, scene.ray_intersect_preliminary
        found = [meet(ray(point(*o), vector(*d)), True) for o, d in zip(starts.tolist(), along.tolist(), strict=True)]
        distance = np.array([f.t for f in found], float)
        marker = np.array([f.prim_index for f in found], np.int64)
        return np.where(np.isfinite(distance), marker, -1), distance

    def _irradiance(self, frame: Frame, exact: Any, marker: Ints, surface: Floats, normal: Floats) -> Floats:
        """Return (m,) the light of all LEDs on places of markers, shadows included."""
        total = np.zeros(len(marker))
        centre = frame.centres[marker].astype(float)
        for led in range(frame.lamps.shape[1]):
            lamp = frame.lamps[marker, led].astype(float)
            towards = lamp[:, :3] - (centre + surface)
            length = np.linalg.norm(towards, axis=1)
            cosine = np.einsum("ni,ni->n", normal, towards) / length
            lit = cosine > 0
            doubt = np.flatnonzero(lit & frame.shadowed[marker, led])
            start = centre[doubt] + surface[doubt] * (1 - INSIDE)
            lit[doubt] = ~self._blocked(exact, start, towards[doubt] / length[doubt, None])
            total += np.where(lit, lamp[:, 3] * cosine / length**2, 0.0)
        return total

    def _blocked(self, scene: Any, starts: Floats, along: Floats) -> Bools:
        ray, point, vector, test = self._mi.Ray3f, self._mi.Point3f, self._mi.Vector3f, scene.ray_test
        pairs = zip(starts.tolist(), along.tolist(), strict=True)
        return np.array([test(ray(point(*o), vector(*d))) for o, d in pairs], bool)


def _meet(frame: Frame, marker: Ints, starts: Floats, along: Floats, place: Floats) -> tuple[Floats, Floats, Floats]:
    """Return coverage, way from centre to surface, and normal where rays meet or just miss markers."""
    metric = frame.metric[marker].astype(float)
    from_centre = starts - frame.centres[marker]
    turned = np.einsum("nij,nj->ni", metric, along)
    square = np.einsum("ni,ni->n", along, turned)
    away = from_centre - along * (np.einsum("ni,ni->n", from_centre, turned) / square)[:, None]
    miss = np.sqrt(np.einsum("ni,nij,nj->n", away, metric, away))
    off = place - frame.near.centres_px[marker]
    slope = np.einsum("nij,nj->ni", np.linalg.inv(frame.near.conjugate)[marker], off)
    steepness = np.linalg.norm(slope, axis=1) / np.sqrt(np.maximum(np.einsum("ni,ni->n", off, slope), 1e-12))
    edge = np.clip(0.5 + frame.subpixels * (1 - miss) / np.maximum(steepness, 1e-6), 0, 1)
    covers = np.where(miss < 0.5, 1.0, edge)
    within = np.clip(np.where(covers < 1, 1 - INTO * covers * steepness / frame.subpixels, miss), 0, 1)
    depth = np.sqrt((1 - within**2) / square)
    surface = away * (within / np.maximum(miss, 1e-6))[:, None] - along * depth[:, None]
    normal = np.einsum("nij,nj->ni", metric, surface)
    return covers, surface, normal / np.linalg.norm(normal, axis=1, keepdims=True)
