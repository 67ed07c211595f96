"""`twin export --format mitsuba`: a scene at rest and under its press, for other renderers."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

from twin.arrays import Progress
from twin.files import make_folder, write_whole
from twin.parts.scene import Scene
from twin.study.sensor import Motion, Sensor


def export_scene(scene: Scene, out: Path, progress: Progress | None = None) -> list[Path]:
    """Write a scene in Mitsuba's format into the folder ``out`` and return the XML files.

    Raises
    ------
    RecipeError
        The scene has no camera, or one that stock Mitsuba lacks.
    """
    from twin.world.picture.stock_scene import check_stock, write_stock_scene

    sensor = Sensor(scene, progress)
    actual = sensor.actual.scene
    renderer = sensor.renderer  # refuses a scene without a camera
    check_stock(actual)
    exposure = renderer.exposure
    # The states: at rest, and pressed if the scene has a press or tractions.
    motions: dict[str, Motion | None] = {"rest": None}
    if scene.tractions or scene.press is not None:
        load = scene.load if scene.tractions else sensor.press().load
        motions["pressed"] = sensor.motion(load)
    make_folder(out)
    files = []
    for name, motion in motions.items():
        cover = None if motion is None else motion.cover
        shapes = sensor.ellipsoids(motion)
        files.append(write_stock_scene(out, name, actual, exposure, shapes, cover))
    write_whole(out / "README.md", _readme(scene, actual.window_middle_mm, files).encode())
    return files


def _readme(scene: Scene, middle_mm: float, files: list[Path]) -> str:
    light = scene.light
    assert light is not None
    left_out = [
        "the body's sides: the rubber fills all space below the window, and the cover stands only "
        "where the camera sees it",
        "the shift of colours, blur, noise and compression by the CCD (`[ccd]`)",
    ]
    if scene.camera is not None and scene.camera.in_rubber:
        left_out += ["marks in the rubber"]
    if any(light.outside) or (scene.press is not None and scene.press.albedo is not None):
        left_out += ["the probe, and the light of the surroundings (`light.outside`)"]
    if light.ambient:
        left_out += [f"the even share of light, `light.ambient` = {light.ambient:g}: no source"]
    if not light.radius_mm:
        left_out += ["that LEDs are points: here they are discs of 1 mm radius, as bright in all"]
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
        the cosine; its radiance already holds the exposure.

        Left out:

        """
    return dedent(said) + "".join(f"- {each}\n" for each in left_out)
