"""The gallery: pictures that the lines beside them make, when the documentation is built."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

import matplotlib as mpl
import matplotlib.pyplot as plt

import twin
from benchmarks.dark_figures import save_both
from twin.errors import MissingCapability
from twin.files import write_whole
from twin.study.view import body_view


@dataclass(frozen=True)
class Plate:
    """A picture: its name, what to see in it, and the lines that make it."""

    name: str
    said: str
    lines: str


@dataclass(frozen=True)
class Room:
    """Plates that belong together."""

    title: str
    said: str
    plates: tuple[Plate, ...]


def _moved(name: str, scene: str, said: str) -> Plate:
    """Return the plate of a scene's markers, moved by its press."""
    lines = f"""
        sensor = twin.Sensor(twin.load_scene("{scene}"))
        rest = sensor.picture(None)
        pressed = sensor.picture(sensor.press())
        figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
        left.imshow((pressed / 255) ** 0.5)  # brightened
        grey = pressed.max(axis=2, keepdims=True) // 2
        twin.track(rest, pressed, sensor.layout_px).plot(right, np.repeat(grey, 3, axis=2))
    """
    return Plate(name, said, lines)


SENSORS = Room(
    "Sensors: what the camera sees, and how markers move",
    "The picture under the press of each scene, brightened, and the tracked motion of its markers.",
    (
        _moved(
            "flat",
            "kamiyama_pillar",
            "Flat sensor, 5 mm pillar: markers move away from it, the deep red ones less. The real one (Kamiyama "
            "et al.) is a block of clear silicone with two layers of coloured beads, filmed through an acrylic "
            "plate by a video camera, whose own chain is `kamiyama_paper`.",
        ),
        _moved("twist", "kamiyama_twist", "The same sensor under a pillar that turns about its axis."),
        _moved("shear", "kamiyama_shear", "The same sensor, pressed and pulled aside."),
        _moved(
            "finger",
            "sato_press",
            "The finger under a 3 mm sphere, through its fisheye lens. The real one (Sato et al.) has the shape of "
            "a fingertip, red and blue dots and a black silicone skin; `sato_paper` assumes a mosaic and JPEG for "
            "its camera.",
        ),
        _moved(
            "gelpad",
            "gelpad_press",
            "A gel pad 4 mm thick with one layer of printed dots, under a 6 mm sphere. Real ones, such as GelSight "
            "with markers (Yuan et al., Sensors 17, 2762, 2017), are clear gel under a reflecting coat with dark "
            "dots; the shape that they read from coloured light is left out here.",
        ),
        _moved(
            "white",
            "gelpad_white_dots",
            "The same pad with white dots under a black skin, which keeps the room's light out, as pads for "
            "tracking alone have it; coloured LEDs from four sides.",
        ),
        _moved("dome", "dome_press", "A round dome under a 6 mm sphere beside its apex."),
    ),
)


OBJECTS = ("letter", "gear", "screw", "brick", "grating", "ring")

CONTACTS = Room(
    "Contact: pressure under probes and objects",
    "Patches in contact, coloured by their pressure; a dot marks a patch that slips.",
    (
        Plate(
            "probes",
            "A sphere presses most in the middle; a pillar at its rim; a sphere pulled aside slips behind.",
            """
            figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
            for ax, scene in zip(axes, ("gelpad_press", "kamiyama_pillar", "sato_shear")):
                twin.Sensor(twin.load_scene(scene)).press().plot(ax)
                ax.set_title(scene)
            """,
        ),
        Plate(
            "shapes",
            "Flat faces press most at their sharp rims; a cone presses most at its tip.",
            """
            shapes = {
                "cylinder": {"kind": "cylinder", "diameter_mm": 4},
                "cylinder with a rounded rim": {"kind": "cylinder", "diameter_mm": 4, "edge_mm": 0.8},
                "pillar": {"kind": "pillar", "width_mm": 3, "length_mm": 5},
                "cone": {"kind": "cone", "apex_deg": 120, "diameter_mm": 5},
            }
            figure, axes = plt.subplots(1, 4, figsize=(13, 2.8), layout="constrained")
            for ax, (name, probe) in zip(axes, shapes.items()):
                twin.Sensor(twin.load_scene("gelpad_press", {"press.probe": probe})).press().plot(ax)
                ax.set_title(name)
            """,
        ),
        Plate(
            "friction",
            "A sphere pressed, then pulled aside, with little and with much friction: "
            "the rim slips, the middle sticks.",
            """
            figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
            steps = [{"force_n": {"x": 0, "y": 0, "z": 0.2}}, {"force_n": {"x": 0.07, "y": 0, "z": 0.2}}]
            for ax, friction in zip(axes, (0.4, 0.6, 1.0)):
                pulled = {"press.friction": friction, "press.steps": steps}
                twin.Sensor(twin.load_scene("gelpad_press", pulled)).press().plot(ax)
                ax.set_title(f"friction {friction:g}")
            """,
        ),
        Plate(
            "objects",
            "Everyday objects on a flat gel. `dataset_objects` presses all of them.",
            f"""
            figure, axes = plt.subplots(2, 3, figsize=(13, 7.6), layout="constrained")
            for ax, name in zip(axes.flat, {OBJECTS}):
                twin.Sensor(twin.load_scene("object_" + name)).press().plot(ax)
                ax.set_title(name)
            """,
        ),
    ),
)


RUBBER = Room(
    "Rubber: stiffness and finite strain",
    "A 6 mm sphere on a gel pad 4 mm thick.",
    (
        Plate(
            "stiffness",
            "Twice the modulus, about two thirds of the indentation.",
            """
            figure, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
            forces_n = (0.05, 0.1, 0.2, 0.3, 0.4)
            for modulus in (0.1, 0.2, 0.4):
                sensor = twin.Sensor(twin.load_scene("gelpad_press", {"material.youngs_modulus_mpa": modulus}))
                presses = [twin.Press(probe=twin.Sphere(diameter_mm=6), force_n=(0, 0, f)) for f in forces_n]
                deep = [sensor.press(press).indentation_mm for press in presses]
                ax.plot(deep, forces_n, "o-", label=f"{modulus:g} MPa")
            ax.set(xlabel="indentation (mm)", ylabel="force into the pad (N)")
            ax.legend()
            """,
        ),
        Plate(
            "laws",
            "Linear theory and a neo-Hookean law: the same force goes a little deeper at finite strain.",
            """
            figure, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
            forces_n = (0.1, 0.2, 0.4)
            for law, name in (("linear", "linear"), ("neo_hookean", "neo-Hookean")):
                sensor = twin.Sensor(twin.load_scene("gelpad_press", {"material.law": law}))
                presses = [twin.Press(probe=twin.Sphere(diameter_mm=6), force_n=(0, 0, f)) for f in forces_n]
                deep = [sensor.press(press).indentation_mm for press in presses]
                ax.plot(deep, forces_n, "o-", label=name)
            ax.set(xlabel="indentation (mm)", ylabel="force into the pad (N)")
            ax.legend()
            """,
        ),
    ),
)


CAMERAS = Room(
    "Cameras: what the light and the CCD do",
    "The middle of one picture, as other renderers and cameras deliver it.",
    (
        Plate(
            "renderers",
            "`splat` and `mitsuba` draw the same picture, without and with Mitsuba. `path` is Mitsuba's own path "
            "integrator: markers shadow the cover and light each other. Brightened.",
            """
            figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
            for ax, renderer in zip(axes, ("splat", "mitsuba", "path")):
                scene = twin.load_scene("kamiyama_pillar", {"renderer": renderer})
                ax.imshow((twin.Sensor(scene).picture(None)[180:300, 240:400] / 255) ** 0.5)
                ax.set_title(renderer)
            """,
        ),
        Plate(
            "presets",
            "The capture chains: no blur and no noise; a machine-vision camera; composite video of the flat paper; "
            "a colour mosaic and JPEG, as the finger's paper may have had.",
            """
            figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
            for ax, preset in zip(axes, ("ideal", "industrial", "kamiyama_ntsc", "sato_60fps")):
                scene = twin.load_scene("kamiyama_pillar", {"ccd.preset": preset})
                ax.imshow(twin.Sensor(scene).picture(None)[210:270, 280:360])
                ax.set_title(preset)
            """,
        ),
        Plate(
            "focus",
            "A wide pupil blurs what lies out of focus: here the red layer, the blue one, and neither.",
            """
            figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
            for ax, focus in zip(axes, (6.0, 3.0, -6.0)):
                wide = {"camera.aperture_mm": 8.0, "camera.focus_z_mm": focus}
                scene = twin.load_scene("kamiyama_pillar", wide)
                ax.imshow(twin.Sensor(scene).picture(None)[210:270, 280:360])
                ax.set_title(f"8 mm pupil, sharp at z = {focus:g} mm")
            """,
        ),
        Plate(
            "effects",
            "What real sensors have, off above and on below, brightened: red LEDs of unequal power; LEDs as discs that "
            "the window mirrors; dust on the window; hot and dead pixels, and noise of rows and columns; glossy red "
            "beads; ink that did not spread evenly.",
            """
            light = {"light.positions_mm": [[11, 8, 105], [-11, 8, 105], [11, -8, 105], [-11, -8, 105]]}
            effects = {
                "coloured LEDs": {"light.colours": [[1, 0.2, 0.1]] * 2 + [[0.2, 0.04, 0.02]] * 2},
                "mirrored LEDs": {"light.radius_mm": 0.6},
                "dust": {"camera.dust": {"count": 4000, "size_mm": 0.15}},
                "faulty pixels, rows": {
                    "ccd": {"hot_pixels": 300, "dead_pixels": 300, "row_noise_e": 120, "column_noise_e": 120}
                },
                "gloss": {"markers.red.gloss": [2.5, 0.05]},
                "texture": {"markers.red.texture": [0.4, 0.2], "markers.blue.texture": [0.4, 0.2]},
            }
            figure, axes = plt.subplots(2, 6, figsize=(12, 3.4), layout="constrained")
            for column, (name, effect) in zip(axes.T, effects.items()):
                for ax, keys in zip(column, (light, light | effect)):
                    picture = twin.Sensor(twin.load_scene("kamiyama_pillar", keys)).picture(None)
                    ax.imshow((picture[75:165, 110:230] / 255) ** 0.5)
                    ax.set(xticks=[], yticks=[])
                column[0].set_title(name)
            for ax, state in zip(axes[:, 0], ("off", "on")):
                ax.set_ylabel(state)
            """,
        ),
        Plate(
            "clear",
            "What clear rubber shows, at rest above and pressed by a ball of 6 mm below, brightened: through a grey "
            "coat; the ball through a thin coat; with light of the surroundings; a gear; bubbles and dust that the "
            "rubber carries.",
            """
            thin = {"cover.albedo": [0.1, 0.1, 0.1], "cover.transmittance": 0.6}
            seen = {**thin, "press.albedo": [0.25, 0.18, 0.16]}
            gear = {"press.probe": {"kind": "object", "shape": "gear"}, "press.at_mm": [0, 0]}
            gear["accuracy.displacement"] = 0.05  # asked: no more than a picture shows
            cases = {
                "covered": {},
                "probe": seen,
                "light outside": {**seen, "light.outside": [0.3, 0.35, 0.5]},
                "gear": {**seen, **gear},
                "bubbles": {"camera.bubbles": {"count": 60, "size_mm": 0.6, "hollow": 0.7, "albedo": 0, "depth_mm": 2}},
                "dust": {"camera.dust": {"count": 800, "size_mm": 0.12, "albedo": 0.9, "depth_mm": 2}},
            }
            figure, axes = plt.subplots(2, 6, figsize=(12, 3.6), layout="constrained")
            for column, (name, keys) in zip(axes.T, cases.items()):
                sensor = twin.Sensor(twin.load_scene("gelpad_press", {"ccd.exposure": 0.4, **keys}))
                for ax, load in zip(column, (None, sensor.press().load)):
                    ax.imshow((sensor.picture(load)[100:360, 170:520] / 255) ** 0.5)
                    ax.set(xticks=[], yticks=[])
                column[0].set_title(name)
            """,
        ),
        Plate(
            "chain",
            "The same for window, lens and camera: scratches and bubbles on the window; haze; a ghost; smear; flicker "
            "under a rolling shutter, on the whole picture; white balance of reddish light, by the picture's mean, "
            "which takes the red of the beads for red light, too.",
            """
            rolling = {"exposure_ms": 3, "frames_per_second": 30, "readout_ms": 20}
            effects = {
                "scratches": {"camera.scratches": {"count": 400, "size_mm": 0.06, "length_mm": 8}},
                "bubbles": {"camera.bubbles": {"count": 2000, "size_mm": 0.8, "hollow": 0.7, "albedo": 0}},
                "haze": {"ccd": {"haze": 0.4, "haze_px": 20}},
                "ghost": {"ccd": {"ghost": 0.3, "ghost_px": [9, 4]}},
                "smear": {"ccd": {"smear": 0.3}},
                "flicker": {"ccd": {"flicker": 0.8, "flicker_hz": 200, **rolling}},
                "white balance": {"light.colours": [[1, 0.7, 0.5]] * 4, "ccd": {"white_balance": "grey"}},
            }
            figure, axes = plt.subplots(2, 7, figsize=(11, 3.4), layout="constrained")
            for column, (name, effect) in zip(axes.T, effects.items()):
                light = {key: value for key, value in effect.items() if key == "light.colours"}
                for ax, keys in zip(column, (light, effect)):
                    picture = twin.Sensor(twin.load_scene("kamiyama_pillar", keys)).picture(None)
                    part = picture[:, 80:560] if name == "flicker" else picture[175:295, 260:380]
                    ax.imshow((part / 255) ** 0.5)
                    ax.set(xticks=[], yticks=[])
                column[0].set_title(name)
            for ax, state in zip(axes[:, 0], ("off", "on")):
                ax.set_ylabel(state)
            """,
        ),
    ),
)


FIELDS = Room(
    "Force fields: what the sensor's software makes of the pictures",
    "Colour is the force along z, arrows are along the surface; the last panel is the truth.",
    (
        Plate(
            "run",
            "A whole run, as `twin run kamiyama_pillar` computes it.",
            """
            twin.run("kamiyama_pillar").plot()
            """,
        ),
        Plate(
            "errors",
            "Tracked minus true motion of every marker: random is noise, ordered is bias.",
            """
            result = twin.run("kamiyama_pillar")
            truth, found = result.truth, result.estimate
            moved = truth.marker_outline_pressed_px - truth.marker_outline_rest_px
            figure, ax = plt.subplots(figsize=(7, 5), layout="constrained")
            error = found.marker_shift_px - moved
            ax.quiver(*found.marker_rest_px.T, *error.T, angles="xy", scale_units="xy", scale=1e-3, width=0.003)
            ax.set(xlabel="column (px)", ylabel="row (px)", title="error, drawn 1000 times as long", aspect="equal")
            ax.invert_yaxis()
            """,
        ),
        Plate(
            "inverses",
            "Two balls 6 mm apart, reconstructed by each inverse from the same picture.",
            """
            figure, axes = plt.subplots(2, 3, figsize=(13, 6.4), layout="constrained")
            for ax, method in zip(axes.flat, ("smooth", "norm", "pinv", "local")):
                inverse = {"reconstruction.method": method}
                result = twin.run("two_points", want=["displacement", "forces"], overrides=inverse)
                result.estimate.plot(ax)
                ax.set_title(method)
            result.truth.plot(axes[1, 1])
            axes[1, 2].set_axis_off()
            """,
        ),
    ),
)

DESIGNS = Room(
    "Designs: which depth and pitch to cast",
    "What a sweep screens designs by before it makes pictures of the best ones ([sweeps](../sweeps.md)).",
    (
        Plate(
            "sweep",
            "Least distance at which two pushes are resolved, and noise of the total force (0.4 mm markers).",
            """
            from twin.study.sweep.designs import Designs, load_sweep
            from twin.study.sweep.fidelities import closed
            designs = Designs.of(*load_sweep("sweep_kamiyama_depth_pitch"))
            found = closed(designs)[0]
            wide = designs.numbers("markers.*.diameter_mm", 0) == 0.4
            depth, pitch = (designs.numbers(key, 0)[wide] for key in ("markers.blue.depth_mm", "markers.*.pitch_mm"))
            figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
            for ax, key, title in zip(axes, ("two_point_mm", "resolution_gf"), ("two points (mm)", "force noise (gf)")):
                drawn = ax.tricontourf(depth, pitch, found[key][wide], cmap="cividis_r")
                ax.set(xlabel="depth of the blue layer (mm)", ylabel="pitch (mm)", title=title)
                figure.colorbar(drawn)
            """,
        ),
    ),
)

ROOMS = (SENSORS, CONTACTS, RUBBER, CAMERAS, FIELDS, DESIGNS)

PAPERS = {
    "reproduction_limits": "What limits each sensor: the width of a narrow force, with one thing changed at a time.",
    "reproduction_half_space": "The papers' half-space against the real block: motion of the blue layer.",
}
"""Figures of `twin reproduce all` that are stored with the documentation."""

BODIES = ("kamiyama_pillar", "sato_press", "gelpad_press")


def make_gallery(folder: Path) -> None:
    """Write ``gallery.md``, its pictures, and pages of deformed bodies."""
    (folder / "pages").mkdir(parents=True, exist_ok=True)
    text = ["# Gallery", "Made when this documentation was built; each picture by the lines below it, after"]
    text += ["```python\nimport matplotlib.pyplot as plt\nimport numpy as np\nimport twin\n```"]
    for room in ROOMS:
        text += [f"## {room.title}", room.said]
        for plate in room.plates:
            text += [plate.said, _shown(plate, folder)]
    text += [
        "## By hand",
        "`twin run kamiyama_pillar --live`: move the probe by keys or by dragging ([Live](../live.md)).",
    ]
    text += ["![Page with the camera's picture, both force fields, sliders and errors](../live.webp)"]
    text += ["## Papers", "`twin reproduce all` makes these and all others ([Reproduction](../reproduction.md))."]
    text += [f"{said}\n\n![{said}](../{name}.svg)" for name, said in PAPERS.items()]
    text += ["## Bodies", "Turn them in the browser:"]
    for scene in BODIES:
        page = body_view(twin.Sensor(twin.load_scene(scene))).page()
        write_whole(folder / "pages" / f"{scene}.html", lambda f, page=page: f.write(page.encode()))
        text += [f'- <a href="../{scene}.html">{scene}</a> (`twin view {scene}`)']
    (folder / "gallery.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def _shown(plate: Plate, folder: Path) -> str:
    """Run a plate's lines, write its picture, and return both as text; or why it can't be drawn here."""
    lines = dedent(plate.lines).strip()
    code = f"```python\n{lines}\n```"
    with mpl.rc_context({"figure.dpi": 80, "font.size": 9}):
        try:
            exec(lines, {"plt": plt, "np": __import__("numpy"), "twin": twin})
        except MissingCapability as problem:
            plt.close("all")
            return f"{code}\n\nNot drawn on the machine that built these pages: {problem}"
        save_both(plt.gcf(), folder / f"gallery_{plate.name}.webp", bbox_inches="tight")
        plt.close("all")
    return f"![{plate.said}](gallery_{plate.name}.webp)\n\n{code}"
