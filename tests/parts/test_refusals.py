"""Descriptions whose keys do not go together are refused by key."""

from typing import Any

import pytest

from twin.errors import RecipeError
from twin.parts.body import Dome, Finger
from twin.parts.camera import Camera, Ccd, Light
from twin.parts.load import Footprint
from twin.parts.material import Cover

LED, DARK = (0.8, 0.1, 0.0), (0.0, 0.0, 0.0)
PUSH = {"force_n": (0, 0, 1)}


def leds(*colours: tuple[float, ...], **keys: Any) -> Light:
    return Light(positions_mm=[(x, 0, 50) for x in range(4)], colours=colours, **keys)


def of_profile(*profile: tuple[float, float]) -> Light:
    return Light(positions_mm=((0, 0, 70),), profile=profile)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Dome(radius_mm=10, height_mm=2.9), r"height_mm = .* must be 0.3 to 1 radius"),
        (lambda: Dome(radius_mm=10, height_mm=10.01), r"height_mm = .* must be 0.3 to 1 radius"),
        (lambda: Finger(radius_mm=8, barrel_mm=8, skirt_mm=2, back="glued"), "back"),
        (lambda: Cover(albedo=(0.3, 0.1, 0.1), transmittance=0.8), r"transmittance = 0.8: with an albedo of 0.3"),
        (lambda: Camera(focal_px=500, pupil_mm=(0, 0, 60), distortion=(0.1, 0.2, 0.3)), "3 coefficients"),
        (lambda: Ccd(crosstalk=0.4), "crosstalk"),
        (lambda: Ccd(crosstalk=((1, 0, 0), (0, 0, 0), (0, 0, 1))), "row"),
        (lambda: Ccd(quantum_efficiency=(0.5, 0, 1)), "quantum_efficiency"),
        (lambda: Ccd(bandwidth_mhz=(4.2, 0, 0.4)), "bandwidth_mhz"),
        (lambda: Ccd(preset="ideal", readout_ms=5.0), "give frames_per_second"),
        (lambda: Ccd(preset="ideal", frames_per_second=200), "exposure_ms = 10 and readout_ms = 0"),
        (lambda: Ccd(preset="ideal", frames_per_second=30, readout_ms=40.0), "readout_ms = 40: each must be at most"),
        (lambda: of_profile((0, 1)), "at least two"),
        (lambda: of_profile((0, 1), (0, 2)), "rise"),
        (lambda: of_profile((0, -1), (90, 1)), "above 0"),
        (lambda: leds(LED), "colours: 1 for 4 LEDs"),
        (lambda: leds(DARK, DARK, DARK, DARK), "every LED is dark"),
        (lambda: leds(LED, DARK, LED, LED, lit=[[0], [4]]), r"group 1 is \[4\]; give each group at least one of the"),
        (lambda: leds(LED, DARK, LED, LED, lit=[[-1]]), "numbers 0 to 3 of the 4 LEDs"),
        (lambda: leds(LED, DARK, LED, LED, lit=[[0, 0]]), "each once"),
        (lambda: leds(LED, DARK, LED, LED, lit=[[0], []]), "group 1 is "),
        (lambda: leds(LED, DARK, LED, LED, lit=[[0], [1]]), r"every LED of group 1, \[1\], is dark"),
        (lambda: Footprint(kind="disk", **PUSH), "needs radius_mm"),
        (lambda: Footprint(kind="rectangle", radius_mm=1, **PUSH), "needs size_mm"),
        (lambda: Footprint(kind="rectangle", size_mm=(1, 0), **PUSH), "size_mm.1 = 0"),
        (lambda: Footprint(kind="twist", radius_mm=1, **PUSH), "needs torque_nmm"),
        (lambda: Footprint(kind="bump", radius_mm=1, torque_nmm=1), "needs force_n"),
        (lambda: Footprint(kind="bump", radius_mm=-1, **PUSH), "radius_mm"),
    ],
)
def test_what_does_not_go_together_is_refused(make: Any, words: str) -> None:
    with pytest.raises(RecipeError, match=words):
        make()
