"""The page and the window of a deformed body: what they hold, and that a browser and OpenGL paint them."""

import base64
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

import twin
from twin.errors import MissingCapability
from twin.show.body_view import TRIAL, TRIAL_S, BodyView
from twin.study.sensor import Sensor
from twin.study.view import body_view, surface_view


@pytest.fixture(scope="module")
def view() -> BodyView:
    scene = twin.load_scene("kamiyama_shear", {"accuracy.contact_patches": 6})
    return body_view(Sensor(scene))


def test_it_begins_at_rest_and_has_a_frame_for_every_step(view: BodyView) -> None:
    assert [frame.name for frame in view.frames] == ["rest", "1", "2"]
    assert not view.frames[0].displacement_mm.any()


def test_the_surface_goes_down_under_the_push_and_along_with_the_shear(view: BodyView) -> None:
    corners, pushed, sheared = view.corner_mm, view.frames[1].displacement_mm, view.frames[2].displacement_mm
    under = np.argmin(np.linalg.norm(corners, axis=1))
    assert pushed[under, 2] > 0.2
    assert sheared[under, 0] > 0.02 > abs(pushed[under, 0])
    held = corners[:, 2] == corners[:, 2].max()
    np.testing.assert_allclose(sheared[held], 0, atol=1e-3)


def test_triangles_are_small_where_it_is_pressed_and_point_outwards(view: BodyView) -> None:
    a, b, c = (view.corner_mm[view.triangle[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    middle = (a + b + c) / 3
    assert area.sum() == pytest.approx(2 * (100 * 90 + 100 * 40 + 90 * 40), rel=1e-9)
    assert np.all(np.einsum("ij,ij->i", normal, middle - [0, 0, 20]) > 0)
    near = np.linalg.norm(middle, axis=1) < 2.5
    assert area[near].max() < 1.5 < area[~near].max()


def test_patches_carry_the_force(view: BodyView) -> None:
    frame = view.frames[2]
    sides = frame.patch_mm[:, [1, 3]] - frame.patch_mm[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    np.testing.assert_allclose((frame.traction_mpa * area[:, None]).sum(axis=0), [1, 0, 3], atol=1e-6)


def test_two_probes_are_both_there_and_both_told() -> None:
    shown = body_view(Sensor(twin.load_scene("two_points", {"accuracy.contact_patches": 6})))
    frame = shown.frames[-1]
    middle = frame.patch_mm.mean(axis=1)
    for side in (-1, 1):
        under = np.hypot(middle[:, 0] - 3 * side, middle[:, 1]) < 1.5
        sides = frame.patch_mm[under][:, [1, 3]] - frame.patch_mm[under][:, :1]
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        assert (frame.traction_mpa[under, 2] * area).sum() == pytest.approx(0.5, abs=1e-6)
        near = np.hypot(shown.corner_mm[:, 0] - 3 * side, shown.corner_mm[:, 1]) < 0.5
        assert frame.displacement_mm[near & (shown.corner_mm[:, 2] == 0), 2].max() > 0.2
    assert frame.said.count("force (0, 0, 0.5) N") == 2


def test_the_page_holds_the_arrays_and_no_markup_of_the_title() -> None:
    frame = BodyView.Frame(
        name="rest", said="</script><b>", displacement_mm=np.zeros((3, 3)), marker_displacement_mm=np.zeros((1, 3)),
        patch_mm=np.zeros((0, 4, 3)), patch_displacement_mm=np.zeros((0, 3)), traction_mpa=np.zeros((0, 3)),
        slip=np.zeros(0, bool),
    )  # fmt: skip
    page = BodyView(
        title="<b>&", corner_mm=np.eye(3), triangle=np.array([[0, 1, 2]]), marker_mm=np.full((1, 3), 0.25),
        marker_layer=np.array(["red"]), layer_radius_mm={"red": 0.25}, frames=(frame,),
    ).page()  # fmt: skip
    assert "<b>" not in page
    assert page.count("</script>") == 2
    assert not re.search(r"(src|href)\s*=|https?://", page), "nothing is fetched"
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])
    np.testing.assert_array_equal(np.frombuffer(base64.b64decode(data["corner"]), "<f4").reshape(-1, 3), np.eye(3))


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="needs a browser: apt install chromium")
def test_a_browser_paints_it(tmp_path: Path) -> None:
    page, picture = tmp_path / "view.html", tmp_path / "view.png"
    page.write_text(body_view(Sensor(twin.load_scene("finger_bare"))).page())
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=900,700"]
    said = subprocess.run([*browser, "--dump-dom", page.as_uri()], capture_output=True, text=True, check=True)
    assert int(re.search(r'data-painted="(\d+)"', said.stdout)[1]) > 300
    subprocess.run([*browser, f"--screenshot={picture}", page.as_uri()], capture_output=True, check=True)
    from PIL import Image

    shades = np.asarray(Image.open(picture).convert("L"))[100:600, 150:750]
    assert (shades < 235).mean() > 0.2, "the body fills a good part of the window"


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("chromium"), reason="needs a browser: apt install chromium")
def test_a_face_that_is_clicked_becomes_a_region_of_a_recipe(tmp_path: Path) -> None:
    """The middle of a box, seen from above, is its top, of which the recipe's region picks the same share."""
    trimesh.creation.box(bounds=[[-10, -8, 0], [10, 8, 5]]).export(tmp_path / "pad.stl")
    page = tmp_path / "pad.html"
    click = "<script>pick(canvas.clientWidth / 2, canvas.clientHeight / 2)</script></body>"
    page.write_text(surface_view(tmp_path / "pad.stl").page().replace("</body>", click))
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=900,700", "--dump-dom"]
    shown = subprocess.run([*browser, page.as_uri()], capture_output=True, text=True, check=True).stdout
    line = re.search(r"sensing\.plane = \{.*?\}", shown)[0]
    plane = tomllib.loads(line)["sensing"]["plane"]
    assert plane["normal"] == [0, 0, -1]
    assert plane["point_mm"][2] == 0
    assert f"Blue: {100 * 320 / (2 * (320 + 100 + 80)):.1f} %" in shown


# --- the window of a deformed body ----------------------------------------------------------------


def view_of(slip: list[bool]) -> BodyView:
    """Return a tetrahedron with two markers, one square in contact on each of some."""
    count = len(slip)
    square = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0], [0, 0.3, 0]])
    frame = BodyView.Frame(
        name="1",
        said="Step 1.",
        displacement_mm=np.zeros((4, 3)),
        marker_displacement_mm=np.full((2, 3), 0.01),
        patch_mm=square + np.array([[0.4 * k - 0.5, 0.0, 0.0] for k in range(count)]).reshape(-1, 1, 3),
        patch_displacement_mm=np.zeros((count, 3)),
        traction_mpa=np.tile([0.0, 0.0, 1.0], (count, 1)),
        slip=np.array(slip, bool),
    )
    return BodyView(
        title="a corner",
        corner_mm=np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [0, 0, 1.5]], float),
        triangle=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
        marker_mm=np.array([[-0.2, 0, 0.3], [0.2, 0, 0.6]]),
        marker_layer=np.array(["blue", "red"]),
        layer_radius_mm={"blue": 0.1, "red": 0.1},
        frames=(frame,),
    )


def test_without_a_display_or_opengl_the_page_is_named_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(MissingCapability, match=r"DISPLAY is not set.*without --window a page is written"):
        BodyView.require_window()
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("twin.show.body_view.TRIAL", "import os; os.abort()")
    with pytest.raises(MissingCapability, match="OpenGL, which does not draw here"):
        BodyView.require_window()
    monkeypatch.setattr("twin.show.body_view.TRIAL", "")
    BodyView.require_window()


@pytest.mark.slow
def test_it_draws_markers_and_what_sticks_and_slips(tmp_path: Path) -> None:
    if subprocess.run([sys.executable, "-c", TRIAL], capture_output=True, timeout=TRIAL_S).returncode:
        pytest.skip("OpenGL does not draw here")
    code = (
        "import sys\nfrom pathlib import Path\nfrom test_body_page import view_of\n"
        "view_of([False, True]).show(Path(sys.argv[1])); view_of([]).show(Path(sys.argv[2]))"
    )
    pictures = [tmp_path / "touched.png", tmp_path / "untouched.png"]
    subprocess.run([sys.executable, "-c", code, *map(str, pictures)], check=True, cwd=Path(__file__).parent)
    from PIL import Image

    counts = []
    for picture in pictures:
        seen = np.asarray(Image.open(picture).convert("RGB")).astype(int)
        red, green, blue = seen.transpose(2, 0, 1)
        counts.append(
            [int(chosen.sum()) for chosen in ((red - blue > 60) & (green > 80), blue - red > 60, (red - green > 40))]
        )
    (slips, blues, _), (none, markers, reds) = counts
    assert slips > 500 > none
    assert blues > markers + 500
    assert min(markers, reds) > 50
