"""What recipes can add to light and camera: each effect against arithmetic, and none that is off costs anything."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_scenes import SPLAT, beads, block, changed, mitsuba, rest_of

from twin.errors import RecipeError
from twin.parts.camera import Camera, Ccd, Light
from twin.parts.part import identity
from twin.world.picture.ccd import Pattern, expose
from twin.world.picture.lamps import Lamps
from twin.world.picture.render import Renderer
from twin.world.picture.stock_scene import surfaces


def light_of(scene, variant=SPLAT):
    """Return a rest picture's light, and that without the exposure."""
    renderer = Renderer(scene, rest_of(scene), variant)
    light = renderer.radiance(rest_of(scene))
    return light, light / renderer.exposure


def test_what_is_off_changes_no_description():
    table = block().model_dump(mode="json")
    assert set(identity(table["light"])) == {"positions_mm", "exponent", "profile", "radius_mm", "ambient"}
    assert "dust" not in identity(table["camera"])
    assert "gloss" not in identity(table["markers"]["red"])
    assert not [key for key in identity(table["ccd"]) if "pixels" in key or "row" in key or "column" in key]


# LEDs of a colour and a power

ONE, TWO, DARK = (0.8, 0.1, 0.0), (0.0, 0.3, 2.0), (0.0, 0.0, 0.0)


def lit(*colours, **light):
    return changed(block(), light={"ambient": 0.0, "radius_mm": 2.0, **light, "colours": colours})


@pytest.mark.parametrize("make", [lambda: SPLAT, mitsuba])
def test_light_of_coloured_leds_adds_up(make):
    together = light_of(lit(ONE, TWO, TWO, ONE), make())[1]
    apart = light_of(lit(ONE, DARK, DARK, ONE), make())[1] + light_of(lit(DARK, TWO, TWO, DARK), make())[1]
    assert_allclose(together, apart, rtol=1e-4, atol=1e-6 * together.max())
    assert (together.max(axis=(0, 1)) > 0).all()


def test_red_leds_light_the_red_channel_only_and_white_ones_power_is_taken_up_by_the_exposure():
    plain, per_power = light_of(block())
    _, red = light_of(lit(*[(0.5, 0.0, 0.0)] * 4, ambient=0.2, radius_mm=0.0))  # even light has their colour
    assert_allclose(red[:, :, 0], 0.5 * per_power[:, :, 0], rtol=1e-4)
    assert_array_equal(red[:, :, 1:], 0)
    light, strong = light_of(lit(*[(3.0, 3.0, 3.0)] * 4, ambient=0.2, radius_mm=0.0))
    assert_allclose(light, plain, rtol=1e-5)
    assert_allclose(strong, 3 * per_power, rtol=1e-5)


def test_paths_meet_coloured_leds_too():
    scene = lit(ONE, TWO, TWO, ONE)
    path = changed(scene, accuracy={"paths": 64}).model_copy(update={"renderer": "path"})
    theirs, ours = light_of(path, mitsuba())[0].mean(axis=(0, 1)), light_of(scene)[0].mean(axis=(0, 1))
    assert_allclose(theirs / theirs.sum(), ours / ours.sum(), atol=0.01)


def test_leds_without_a_colour_each_are_refused():
    with pytest.raises(RecipeError, match="colours: 1 for 2 LEDs"):
        Light(positions_mm=((0, 0, 50), (1, 0, 50)), colours=(ONE,))
    with pytest.raises(RecipeError, match="every LED is dark"):
        Light(positions_mm=((0, 0, 50),), colours=(DARK,))


# Dust on the window


def dusty(**keys):
    return changed(block(), camera={"dust": Camera.Dust(count=4000, size_mm=0.2, **keys)}, light={"ambient": 0.0})


def test_black_dust_hides_discs_where_a_pinhole_sees_it():
    """Similar triangles: the outer face is 58.85 mm before the pupil."""
    per_mm = 1814.8 / 58.85
    scene = dusty(albedo=0.0)
    share = 1 - light_of(scene)[1] / light_of(changed(scene, camera={"dust": None}))[1]
    specks = scene.camera.dust.places((-50, -45), (50, 45)) * [per_mm, -per_mm] + [59.5, 44.5]
    whole = specks[((specks > 5) & (specks < (114, 84))).all(axis=1)]
    assert len(whole) == 2
    for column, row in whole:
        at = np.s_[int(row) - 5 : int(row) + 6, int(column) - 5 : int(column) + 6]
        rows, columns = np.mgrid[at]
        part = share[at][:, :, 1]
        assert part.sum() == pytest.approx(np.pi * (0.1 * per_mm) ** 2, rel=0.02)
        assert_allclose([(part * columns).sum(), (part * rows).sum()] / part.sum(), (column, row), atol=0.02)


def test_white_dust_is_as_bright_as_the_leds_light_it():
    scene = dusty(albedo=0.5)
    light = light_of(scene)[1]
    (x, y), *_ = [p for p in scene.camera.dust.places((-50, -45), (50, 45)) if abs(p[0]) < 1.5 and abs(p[1]) < 1.1]
    per_mm = 1814.8 / 58.85
    way = np.array(scene.light.positions_mm) - [x, y, 50]
    lit = np.sum(way[:, 2] ** 2 / np.sum(way**2, axis=1) ** 2)  # cosine there and here over the square
    # Light from paper under irradiance 1 in the body passes the window twice and spreads in air.
    passed = (1 - (0.08 / 2.9) ** 2) * (1 - (0.49 / 2.49) ** 2)
    seen = light[round(44.5 - y * per_mm), round(59.5 + x * per_mm)]
    assert_allclose(seen, 0.5 * lit * (1.41 / passed) ** 2, rtol=1e-3)


def test_paths_see_the_same_dust():
    scene = dusty(albedo=0.5)
    path = changed(scene, accuracy={"paths": 16}).model_copy(update={"renderer": "path"})
    theirs, ours = light_of(path, mitsuba())[1], light_of(scene)[1]
    specks = ours > 0.99 * ours.max()
    assert specks.sum() > 20
    assert_allclose(theirs[specks], ours[specks], rtol=0.01)


# Pixels that fail, and noise of rows and columns


def exposed(light, number, **keys):
    """Return a grey picture of a CCD of 20 000 electrons, 100 to the count, with no noise but what is asked."""
    ccd = Ccd(preset="ideal", noise=True, full_well_e=25500, crosstalk=0.0, **keys)
    pattern = Pattern.drawn(ccd, (200, 300), np.random.default_rng(1))
    return expose(np.full((200, 300, 3), light, np.float32), ccd, np.random.default_rng(number), pattern)


@pytest.mark.parametrize("mosaic", ["none", "rggb"])
def test_hot_pixels_are_full_and_dead_ones_dark_in_every_picture(mosaic):
    keys = {"hot_pixels": 40, "dead_pixels": 25, "bayer": mosaic}
    one, two = exposed(0.5, 1, **keys), exposed(0.5, 2, **keys)
    if mosaic == "none":
        assert (one == 255).sum() == 40
        assert (one < 5).sum() == 25
    assert_array_equal(one == 255, two == 255)
    assert_array_equal(one < 5, two < 5)
    assert (one == 255).any()
    assert (one < 5).any()


def test_rows_differ_from_picture_to_picture_and_columns_do_not():
    keys = {"row_noise_e": 300.0, "column_noise_e": 200.0}
    pictures = [exposed(0.5, number, **keys) for number in (1, 2)]
    rows = [picture.mean(axis=(1, 2)) for picture in pictures]
    columns = [picture.mean(axis=(0, 2)) for picture in pictures]
    for picture in range(2):
        assert rows[picture].std() == pytest.approx(3, rel=0.15)  # 300 electrons are 3 counts; 200 rows
        assert columns[picture].std() == pytest.approx(2, rel=0.15)
    assert abs(np.corrcoef(rows)[0, 1]) < 0.3
    assert np.corrcoef(columns)[0, 1] > 0.99
    assert exposed(0.5, 1).std() == pytest.approx(np.sqrt(12750) / 100, rel=0.1)


# Gloss


def test_a_glossy_ball_sends_as_much_light_to_the_camera_as_a_mirror_does():
    """A mirror ball spreads light evenly, R E r^2 / 4 to every side, R at half the angle between light and camera; a
    white one sends (2 / 3 pi) E r^2 (sin a + (pi - a) cos a)."""
    scene = changed(block().model_copy(update={"cover": None}), light={"ambient": 0.0}, accuracy={"paths": 256})
    white = beads([(0, 0, 6)], colour=(1.0, 1.0, 1.0))
    black = replace(beads([(0, 0, 6)], colour=(0.0, 0.0, 0.0)), gloss=np.array([[2.5, 0.05]]))
    path = scene.model_copy(update={"renderer": "path"})
    renderers = [Renderer(scene, white, SPLAT), Renderer(path, black, mitsuba())]
    matt, gloss = ((r.radiance(m) / r.exposure).sum() for r, m in zip(renderers, (white, black), strict=True))
    towards = Lamps.at(white.centres, scene).place[0, 0] - white.centres[0]
    angle = np.arccos(towards[2] / np.linalg.norm(towards))
    one, two = 1.41 * np.cos(angle / 2), 2.5 * np.sqrt(1 - (1.41 / 2.5 * np.sin(angle / 2)) ** 2)
    across = (one - two) / (one + two)
    one, two = 1.41 / np.cos(angle / 2), 2.5**2 / two
    along = (two - one) / (two + one)
    mirrored = (across**2 + along**2) / 2 / 4
    lambert = 2 / (3 * np.pi) * (np.sin(angle) + (np.pi - angle) * np.cos(angle))
    assert gloss / matt == pytest.approx(mirrored / lambert, rel=0.05)


def test_a_lost_marker_of_a_shade_of_its_own_is_no_glossy_surface():
    lost = np.full(3, np.nan)
    markers = replace(beads([(0, 0, 6), lost]), colour=np.array([[0.5] * 3, [0.4] * 3]), gloss=np.full((2, 2), 1.6))
    (only,) = surfaces(block(), markers, None, None).values()
    assert_array_equal(only.colours, 0.5)


def test_gloss_is_refused_where_it_is_not_drawn():
    red = block().markers["red"].model_copy(update={"gloss": (1.59, 0.1)})
    scene = block().model_copy(update={"markers": {"red": red}})
    dense = changed(scene, material={"refractive_index": 1.6})
    for renderer, one in (("splat", scene), ("auto", scene), ("path", dense)):
        with pytest.raises(RecipeError, match=r"markers.red.gloss = \(1.59, 0.1\): needs renderer = 'path'"):
            Renderer.method(one.model_copy(update={"renderer": renderer}))
