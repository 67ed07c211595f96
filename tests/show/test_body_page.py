"""The page of a deformed body: what it holds, and that a browser paints it."""

import base64
import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
import trimesh

import twin
from twin.show.body_view import BodyView
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
    # x, y and z on the screen make no mirror image; all of the body is in it
    axes = "onto([1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 0, 0, 0], 0), zero = onto([0, 0, 0], [0, 0, 0], 0)"
    see = f"const by = {axes}, [x, y, z] = [0, 3, 6].map(k => [0, 1, 2].map(j => by[k + j] - zero[j]));"
    seen = "const at = onto(corner, corner, 0), across = at.filter((_, i) => i % 3 == 0);"
    shown = "document.querySelectorAll('form > :not([hidden])').length"
    facts = f"[dot(cross(x, y), z) > 0, Math.min(...across) >= 0, Math.max(...across) <= canvas.clientWidth, {shown}]"
    click = f"<script>{see}{seen} document.body.dataset.facts = {facts}; "
    click += "pick(canvas.clientWidth / 2, canvas.clientHeight / 2)</script></body>"
    page.write_text(surface_view(tmp_path / "pad.stl").page().replace("</body>", click))
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--window-size=500,700", "--dump-dom"]
    shown = subprocess.run([*browser, page.as_uri()], capture_output=True, text=True, check=True).stdout
    assert 'data-facts="true,true,true,1"' in shown
    line = re.search(r"sensing\.plane = \{.*?\}", shown)[0]
    plane = tomllib.loads(line)["sensing"]["plane"]
    assert plane["normal"] == [0, 0, -1]
    assert plane["point_mm"][2] == 0
    assert f"Blue: {100 * 320 / (2 * (320 + 100 + 80)):.1f} %" in shown
