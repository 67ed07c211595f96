"""`twin export --format mitsuba`: a scene at rest and under its press, for other renderers."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

from twin.arrays import Progress
from twin.files import make_folder, write_whole
from twin.parts.scene import Scene
from twin.study.sensor import Motion, Sensor

_LED_MM = 1.0
"""Radius of the disc that stands for an LED without one: chance never finds a point."""


def export_scene(scene: Scene, out: Path, progress: Progress | None = None) -> list[Path]:
    """Write a scene in Mitsuba's format into the folder ``out`` and return the XML files;
    `RecipeError` without a camera, or with one that stock Mitsuba lacks."""
    from twin.world.picture.render import Renderer
    from twin.world.picture.stock_scene import check_stock, write_stock_scene

    # What can't be written is refused before anything is computed.
    if scene.camera is not None:
        check_stock(scene)
        make_folder(out)
    sensor = Sensor(scene, progress)
    renderer = sensor.renderer  # refuses a scene without a camera
    actual = renderer.scene
    exposure = renderer.exposure
    # Discs that stand for points are mirrored in the window, points are not.
    brighter = 1.0
    _, light = actual.imaging
    if not light.radius_mm:
        discs = light.model_copy(update={"radius_mm": _LED_MM})
        actual = actual.model_copy(update={"light": discs})
        rest = sensor.ellipsoids(None)
        mirrored = Renderer(actual, rest)
        brighter = float(mirrored.radiance(rest).mean() / renderer.radiance(rest).mean())
        brighter *= exposure / mirrored.exposure
    # The states: at rest, and pressed if the scene has a press or tractions.
    motions: dict[str, Motion | None] = {"rest": None}
    if scene.tractions or scene.press is not None:
        load = scene.load if scene.tractions else sensor.press().load
        motions["pressed"] = sensor.motion(load)
    states = {
        name: (sensor.ellipsoids(motion), None if motion is None else motion.cover)
        for name, motion in motions.items()
    }
    files = write_stock_scene(out, actual, exposure, states)
    readme = _readme(scene, actual.window_middle_mm, files, brighter)
    write_whole(out / "README.md", readme.encode())
    return files


def _readme(scene: Scene, middle_mm: float, files: list[Path], brighter: float) -> str:
    camera, light = scene.imaging
    left_out = [
        "the body's sides: the rubber fills all space below the window, and the cover stands only "
        "where the camera sees it",
        "the shift of colours, blur, noise and compression by the CCD (`[ccd]`)",
    ]
    cover = scene.cover
    if cover is not None and cover.transmittance and not cover.moves:
        left_out += [
            "that the probe lifts the cover (`cover.deforms`): it stands out of the cover, which "
            "it shadows beside it, by some per cent of the picture"
        ]
    if light.lit:
        left_out += ["all LEDs but the first group of `light.lit`"]
    if any(light.outside):
        left_out += ["the light of the surroundings (`light.outside`)"]
    if scene.material.abbe_number or any(layer.abbe_number for layer in camera.layers):
        left_out += ["dispersion: one index stands for all colours"]
    if light.ambient:
        left_out += [f"the even share of light, `light.ambient` = {light.ambient:g}: no source"]
    if not light.radius_mm:
        left_out += [
            f"that LEDs are points: here they are discs of {_LED_MM:g} mm radius, as bright. "
            "Points have no mirror images; those of the discs in the window make the picture "
            f"{brighter:.3g} times as bright as the program's at rest, in a few spots. `renderer = "
            '"path"` with `light.radius_mm = 1` draws them, too'
        ]
    lens = ""
    if not camera.is_plain:
        lens = f"""\
        ## The lens

        Mitsuba has no such lens. Its picture is that of a pinhole, wider and twice as fine. To make
        the camera's picture of it, with its distortion, its vignetting and its size:

            import cv2, mitsuba, numpy
            mitsuba.set_variant("llvm_ad_rgb")
            picture = numpy.array(mitsuba.Bitmap("{files[0].stem}.exr"))
            lens = numpy.load("lens.npz")
            picture = cv2.remap(picture, lens["columns"], lens["rows"], cv2.INTER_LINEAR)
            picture = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            picture *= lens["light"][:, :, None]

        Directions of more than 76 degrees to the axis are black.

        """
    said = f"""\
        # {scene.title or "A tactile sensor"}

        {", ".join(f"`{file.name}`" for file in files)}: the sensor as it was made, with its
        tolerances, for Mitsuba 3 with the plug-ins that come with it.

            pip install mitsuba
            mitsuba -m llvm_ad_rgb {files[0].name}

        The picture, an EXR file, is linear: 1 fills a well of the camera, as in the program. LEDs
        behind glass are met by chance only, so it takes 4096 paths a pixel, and is noisy with small
        LEDs: make `sample_count` larger, or set `light.radius_mm`.

        Lengths are in mm. x and y are the sensor's; z is its height minus {middle_mm:g} mm, the
        middle of the window, as rays are most exact near 0. z grows from the sensing surface to the
        camera. The PLY files hold triangles with normals and, as `r`, `g`, `b`, linear reflectance:
        markers are ellipsoids of 1280 triangles each, in the sensor's order; lost ones are absent.
        Indices of refraction are at the `interface` rectangles. Each LED is a disc that shines by
        the cosine; its radiance already holds the exposure. `specks` are marks in the rubber and
        `marks` those on the window, which shadow nothing in the program's pictures; a `probe` is
        what the camera sees of it behind clear rubber, whose `surface` it may pass.

        """
    return (
        dedent(said)
        + dedent(lens)
        + "## Left out\n\n"
        + "".join(f"- {each}\n" for each in left_out)
    )
