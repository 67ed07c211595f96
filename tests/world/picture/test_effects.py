"""What recipes can add to light and camera: each effect against arithmetic, and none that is off costs anything."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import KDTree
from scipy.special import ndtr
from small_scenes import SPLAT, beads, block, changed, faced, measured, mitsuba, rest_of, scene_of, seen_at

import twin
from twin.errors import AccuracyWarning, RecipeError
from twin.parts.camera import Camera, Ccd
from twin.parts.markers import MarkerSet
from twin.parts.material import Cover
from twin.parts.part import identity
from twin.world.picture.ccd import Pattern, expose
from twin.world.picture.cover import CoverMotion
from twin.world.picture.ellipsoids import Ellipsoids
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
    assert "abbe_number" not in identity(table["material"])
    assert "dust" not in identity(table["camera"])
    assert not {"gloss", "texture"} & set(identity(table["markers"]["red"]))
    assert not {"transmittance", "shadows"} & set(identity(table["cover"]))
    new = ("pixels", "row", "column", "haze", "ghost", "smear", "flicker", "auto", "balance", "adc", "bits")
    assert not [key for key in identity(table["ccd"]) if any(part in key for part in new)]


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


# LEDs that take turns


def test_light_of_groups_adds_up_under_one_exposure_that_suits_the_brightest():
    scene = block().model_copy(update={"renderer": "splat"})
    scene = changed(scene, light={"ambient": 0.0, "colours": ((3.0, 1.0, 1.0), *[(1.0, 1.0, 1.0)] * 3)})
    switched = twin.Sensor(
        changed(scene, light={"lit": ((0, 3), (1,), (2,))}, tolerance={"preset": "none"}, ccd={"noise": False})
    )
    views = switched.renderers
    assert len({view.exposure for view in views}) == 1
    apart = [view.radiance(rest_of(scene)) for view in views]
    together, per_power = light_of(scene)
    assert_allclose(sum(apart) / views[0].exposure, per_power, rtol=1e-3, atol=1e-5 * per_power.max())
    assert apart[0].max() == pytest.approx(together.max(), rel=0.1)
    assert switched.renderer_of(5) is views[2]
    assert_array_equal(switched.picture(None, 0, 4), switched.rest_pictures[1])
    assert identity(scene.model_dump(mode="json"))["light"].keys().isdisjoint({"lit"})


# Dust on the window


def dusty(**keys):
    return changed(block(), camera={"dust": Camera.Marks(count=4000, size_mm=0.2, **keys)}, light={"ambient": 0.0})


def test_black_dust_hides_discs_where_a_pinhole_sees_it():
    """Similar triangles: the outer face is 58.85 mm before the pupil."""
    per_mm = 1814.8 / 58.85
    scene = dusty(albedo=0.0)
    share = 1 - light_of(scene)[1] / light_of(changed(scene, camera={"dust": None}))[1]
    specks = scene.camera.dust.lines((-50, -45), (50, 45)).mean(axis=1) * [per_mm, -per_mm] + [59.5, 44.5]
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
    (x, y), *_ = [
        p for p in scene.camera.dust.lines((-50, -45), (50, 45)).mean(axis=1) if abs(p[0]) < 1.5 and abs(p[1]) < 1.1
    ]
    per_mm = 1814.8 / 58.85
    way = np.array(scene.light.positions_mm) - [x, y, 50]
    lit = np.sum(way[:, 2] ** 2 / np.sum(way**2, axis=1) ** 2)  # cosine there and here over the square
    # Light from paper under irradiance 1 in the body passes the window twice and spreads in air.
    passed = (1 - (0.08 / 2.9) ** 2) * (1 - (0.49 / 2.49) ** 2)
    seen = light[round(44.5 - y * per_mm), round(59.5 + x * per_mm)]
    assert_allclose(seen, 0.5 * lit * (1.41 / passed) ** 2, rtol=1e-3)


def test_scratches_and_bubbles_cover_stadiums_and_rings():
    per_mm = 1814.8 / 58.85
    scratches = Camera.Marks(count=1, size_mm=0.1, length_mm=2.0, albedo=0.0, seed=5)
    ends = scratches.lines((-50, -45), (50, 45))[0]
    bubbles = Camera.Marks(count=1, size_mm=0.8, hollow=0.7, albedo=0.0, seed=5)
    scene = changed(block(), light={"ambient": 0.0})
    there = (*ends.mean(axis=0), scene.camera.pupil_mm[2])  # the only mark before the camera
    scene = changed(scene, camera={"pupil_mm": there, "layers": scene.camera.layers})
    for name, marks, area in (
        ("scratches", scratches, 2.0 * 0.1 + np.pi * 0.05**2),
        ("bubbles", bubbles, np.pi * 0.4**2 * (1 - 0.7**2)),
    ):
        plain, marked = (light_of(changed(scene, camera={name: each}))[1] for each in (None, marks))
        clear = 1 - marked[..., 1] / plain[..., 1]
        assert clear.sum() == pytest.approx(area * per_mm**2, rel=0.03)
        column, row, mean = spot(clear)
        assert_allclose((column, row), (59.5, 44.5), atol=0.03)
        if name == "scratches":
            rows, columns = np.nonzero(clear > 0.5)
            axis = np.linalg.eigh(np.cov(columns, rows))[1][:, 1]
            way = (ends[1] - ends[0]) / 2.0
            assert abs(axis @ (way * [1, -1])) == pytest.approx(1, abs=1e-3)
        else:
            assert mean == pytest.approx(2 / 3 * 0.4 * per_mm * (1 - 0.7**3) / (1 - 0.7**2), rel=0.02)
            assert clear[43:47, 58:62].max() == 0


@pytest.mark.parametrize("aperture_mm", [0.0, 4.0])
def test_paths_see_the_same_dust(aperture_mm):
    """Through a wide pupil as blurred, and the picture is no darker at its border."""
    scene = changed(dusty(albedo=0.5), camera={"aperture_mm": aperture_mm, "focus_z_mm": 6.0})
    path = changed(scene, accuracy={"paths": 16}).model_copy(update={"renderer": "path"})
    theirs, ours = light_of(path, mitsuba())[1], light_of(scene)[1]
    specks = ours > 0.99 * ours.max()
    if aperture_mm == 0:
        assert specks.sum() > 20
    assert_allclose(theirs[specks], ours[specks], rtol=0.02)
    assert np.corrcoef(theirs.ravel(), ours.ravel())[0, 1] > 0.99
    border = np.s_[[0, -1], :]
    assert theirs[border].mean() == pytest.approx(ours[border].mean(), rel=0.03)


# An index that depends on the wavelength


def test_dispersion_moves_colours_apart_as_snells_law_does():
    """Cauchy's law through the Abbe number's lines, by hand: red is 600 nm, blue 460."""
    plain = changed(block().model_copy(update={"cover": None}), light={"ambient": 0.0})
    layers = tuple(layer.model_copy(update={"abbe_number": 30.0}) for layer in plain.camera.layers)
    scene = changed(plain, material={"abbe_number": 20.0}, camera={"layers": layers})
    white = beads([(1.2, 0.8, 6)], colour=(0.9, 0.9, 0.9))
    light, still = (Renderer(each, white, SPLAT, subpixels=6).radiance(white) for each in (scene, plain))
    places = []
    for channel, nm in ((0, 600), (1, 530), (2, 460)):
        step = (nm**-2 - 587.6**-2) / (486.1**-2 - 656.3**-2)
        glass = [la.model_copy(update={"index": la.index + (la.index - 1) / 30 * step}) for la in plain.camera.layers]
        seen = changed(plain, material={"refractive_index": 1.41 + 0.41 / 20 * step}, camera={"layers": tuple(glass)})
        place = seen_at(white.centres, seen)
        centroid = measured(light, place, channel, half=12)[0] - measured(still, place, channel, half=12)[0]
        assert_allclose(centroid, place - seen_at(white.centres, plain), atol=0.004)
        places.append(place[0])
    assert np.linalg.norm(places[0] - places[2]) > 0.1
    with pytest.raises(RecipeError, match="abbe_number: renderer = 'path' takes one index"):
        Renderer.method(scene.model_copy(update={"renderer": "path"}))


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


# What lens, LEDs and the camera's automatics do to the light


def counts_of(light, number=1, **keys):
    """Return the counts of an ideal CCD, of which each is 1/255 of the light."""
    return expose(np.asarray(light, np.float32), ideal(**keys), np.random.default_rng(number)).astype(float)


def ideal(**keys):
    return Ccd(**{"preset": "ideal", "crosstalk": 0.0, **keys})


def patch(rows, columns, size=(120, 160)):
    light = np.zeros((*size, 3))
    light[rows, columns] = 0.8
    return light


def test_haze_lays_the_same_light_over_in_a_gaussian():
    counts = counts_of(patch(np.s_[:], np.s_[80:]), haze=0.4, haze_px=12.0)
    edge = np.arange(160) - 79.5
    inner = np.abs(edge) < 40  # the picture's border is farther off than four deviations
    expected = 255 * 0.8 * (0.6 * (edge > 0) + 0.4 * ndtr(edge / 12))
    assert_allclose(counts[60, inner, 0], expected[inner], atol=0.6)
    down = counts_of(patch(np.s_[60:], np.s_[:]), haze=0.4, haze_px=12.0)[20:100, 5, 1]
    assert_allclose(down, expected[40:120], atol=0.6)
    assert_allclose(counts_of(np.full((60, 80, 3), 0.5), haze=0.4), 127.5, atol=0.5)


def test_a_ghost_is_the_picture_moved_aside():
    counts = counts_of(patch(np.s_[40:50], np.s_[60:70]), ghost=0.25, ghost_px=(20.5, -15.0))
    assert (counts[40:50, 60:70] == 204).all()
    assert (counts[25:35, 81:90] == 51).all()
    assert_allclose(counts[25:35, [80, 90]], 25.5, atol=0.51)
    assert (counts > 0).sum() == 3 * (100 + 110)
    assert_array_equal(counts_of(patch(np.s_[40:50], np.s_[:]), ghost=0.25, ghost_px=(-1000.0, 0.0))[45], 204)


def test_smear_gives_a_column_a_share_of_its_mean():
    counts = counts_of(patch(np.s_[:12], np.s_[30:40]), smear=0.5)
    assert (counts[60, 30:40] == round(255 * 0.8 / 10 * 0.5)).all()
    assert (counts[60, 50:] == 0).all()


@pytest.mark.parametrize(("exposure_ms", "share"), [(2.5, np.sinc(0.25)), (10.0, 0.0)])
def test_flicker_makes_bands_under_a_rolling_shutter_unless_an_exposure_is_a_whole_period(exposure_ms, share):
    keys = {"noise": True, "full_well_e": 1e12, "exposure_ms": exposure_ms, "flicker": 0.3}
    rolling = {"frames_per_second": 30.0, "readout_ms": 20.0}
    light = np.full((401, 40, 3), 0.5)
    for number in (1, 2):
        rows = counts_of(light, number, **keys, **rolling).mean(axis=(1, 2)) / 127.5 - 1
        turn = 2 * np.pi * np.arange(401) / 200  # two periods of 10 ms in 20 ms
        waves = np.column_stack([np.sin(turn), np.cos(turn), np.ones(401)])
        found = np.linalg.lstsq(waves, rows, rcond=None)[0]
        assert np.hypot(*found[:2]) == pytest.approx(0.3 * share, abs=0.002)
        assert_allclose(rows, waves @ found, atol=0.005)
    assert np.ptp(counts_of(light, **keys)) < 2


@pytest.mark.parametrize("key", ["auto_exposure", "auto_gain"])
def test_automatics_bring_a_quantile_to_white_in_every_picture(key):
    ramp = np.linspace(0.001, 0.1, 200)[:, None, None] * np.ones((200, 60, 3))
    pictures = [counts_of(ramp * brighter, **{key: 0.8}) for brighter in (1, 4)]
    assert_allclose(*pictures, atol=1)
    assert (pictures[0] > 200.5).all(axis=2).mean() == pytest.approx(0.2, abs=0.01)
    assert counts_of(ramp * 1e-4, **{key: 0.8}).max() == round(255 * 1e-5 * 100)  # a factor of 100 at most


def test_a_gain_makes_noise_larger_than_a_longer_exposure_does():
    """Shot noise of 10 000 electrons at full wells; a level of 0.02 is brought to 200 counts."""
    noise = {"noise": True, "full_well_e": 10_000}
    light = np.full((200, 200, 3), [0.0, 0.02, 0.0])
    longer, louder = (counts_of(light, **noise, **{key: 0.5})[..., 1].std() for key in ("auto_exposure", "auto_gain"))
    assert longer == pytest.approx(255 * np.sqrt(200 / 255 / 10_000), rel=0.05)
    assert louder == pytest.approx(200 * np.sqrt(1 / 200), rel=0.05)


def test_white_balance_makes_grey_of_an_even_colour():
    light = np.full((40, 50, 3), [0.6, 0.4, 0.2])
    assert_allclose(counts_of(light, white_balance="grey"), 102)
    assert_allclose(counts_of(light, white_balance=(0.5, 1.0, 2.0))[0, 0], [76, 102, 102], atol=1)
    assert_allclose(counts_of(light, white_balance="grey", bayer="rggb"), 102)


def test_few_bits_before_gamma_leave_gaps_after_it():
    ramp = np.linspace(0, 1, 4096)[None, :, None] * np.ones((4, 1, 3))
    assert len(np.unique(counts_of(ramp, adc_bits=6, gamma=2.2))) == 64
    assert np.unique(counts_of(ramp, adc_bits=8, gamma=2.2))[1] == round(255 * (1 / 255) ** (1 / 2.2))
    assert_allclose(counts_of(ramp, adc_bits=12), counts_of(ramp), atol=1)


@pytest.mark.parametrize("bits", [10, 12])
def test_more_bits_are_stretched_to_16(bits):
    ramp = np.linspace(0, 1, 4096)[None, :, None] * np.ones((4, 1, 3))
    counts = expose(ramp.astype(np.float32), ideal(bits=bits, black_dn=51.0), np.random.default_rng(1))
    levels = np.rint(ramp * (2**bits - 1) * 0.8 + (2**bits - 1) * 0.2)
    assert counts.dtype == np.uint16
    assert (np.abs(counts / 65535 * (2**bits - 1) - levels) < 0.5).mean() > 0.999  # but where they are at a half
    assert_array_equal(counts >> (16 - bits), np.rint(counts / 65535 * (2**bits - 1)))
    with pytest.raises(RecipeError, match=f"bits = {bits}: JPEG has 8"):
        Ccd(preset="sato_60fps", bits=bits)


# Gloss


def skinned(markers, index, roughness):
    return replace(markers, gloss=np.tile([index, roughness], (len(markers), 1)))


def bare_path(scene, paths):
    """Return a scene without cover and even light, and the same to be drawn by paths."""
    bare = changed(scene.model_copy(update={"cover": None}), light={"ambient": 0.0}, accuracy={"paths": paths})
    return bare, bare.model_copy(update={"renderer": "path"})


def without_exposure(scene, markers, variant):
    renderer = Renderer(scene, markers, variant)
    return renderer.radiance(markers) / renderer.exposure


@pytest.mark.parametrize("by_path", [False, True])
def test_a_glossy_ball_sends_as_much_light_to_the_camera_as_a_mirror_does(by_path):
    """A mirror ball spreads light evenly, R E r^2 / 4 to every side, R at half the angle between light and camera; a
    white one sends (2 / 3 pi) E r^2 (sin a + (pi - a) cos a)."""
    scene, path = bare_path(block(), 256)
    white = beads([(0, 0, 6)], colour=(1.0, 1.0, 1.0))
    black = skinned(beads([(0, 0, 6)], colour=(0.0, 0.0, 0.0)), 2.5, 0.05)
    matt = without_exposure(scene, white, SPLAT).sum()
    gloss = without_exposure(*((path, black, mitsuba()) if by_path else (scene, black, SPLAT))).sum()
    towards = Lamps.at(white.centres, scene).place[0, 0] - white.centres[0]
    angle = np.arccos(towards[2] / np.linalg.norm(towards))
    one, two = 1.41 * np.cos(angle / 2), 2.5 * np.sqrt(1 - (1.41 / 2.5 * np.sin(angle / 2)) ** 2)
    across = (one - two) / (one + two)
    one, two = 1.41 / np.cos(angle / 2), 2.5**2 / two
    along = (two - one) / (two + one)
    mirrored = (across**2 + along**2) / 2 / 4
    lambert = 2 / (3 * np.pi) * (np.sin(angle) + (np.pi - angle) * np.cos(angle))
    assert gloss / matt == pytest.approx(mirrored / lambert, rel=0.05 if by_path else 0.01)


@pytest.mark.parametrize("roughness", [0.05, 0.3])
def test_a_skin_takes_no_light_off_what_is_below(roughness):
    """Mitsuba's `roughplastic` is 5 % darker than a matt bead at a roughness of 0.1 and 21 % at 0.3."""
    scene, path = bare_path(block(), 256)
    matt = beads([(-0.5, 0, 6), (0.5, 0, 6)], radius_mm=0.4, colour=(0.9, 0.5, 0.2))
    matt = replace(matt, colour=matt.colour * [[1.0], [0.7]])
    skin = skinned(matt, 1.59, roughness)
    gained = [
        without_exposure(drawn, skin, way).sum(axis=(0, 1)) / without_exposure(drawn, matt, way).sum(axis=(0, 1))
        for drawn, way in ((scene, SPLAT), (path, mitsuba()))
    ]
    assert_allclose(*gained, rtol=0.005)


@pytest.mark.parametrize("roughness", [0.05, 0.3])
def test_highlights_are_where_paths_find_them_and_as_bright_and_as_wide(roughness):
    """A strained bead, and one under coloured LEDs; widths by the light's mean distance."""
    scene, path = bare_path(lit((1.0, 0.2, 0.1), DARK, TWO, DARK, radius_mm=0.0), 1024)
    stretch = np.diag([1.4, 0.8, 0.9])
    round_one = skinned(beads([(0.8, 0.5, 6)], radius_mm=0.4, colour=(0.0, 0.0, 0.0)), 2.5, roughness)
    ball = replace(round_one, axes=round_one.axes @ stretch)
    for channel in (0, 2):
        fast, theirs = (
            without_exposure(s, ball, v)[:, :, channel].astype(float) for s, v in ((scene, SPLAT), (path, mitsuba()))
        )
        assert fast.sum() == pytest.approx(theirs.sum(), rel=0.03)
        (*centre, width), (*expected, wide) = (spot(picture) for picture in (fast, theirs))
        assert_allclose(centre, expected, atol=0.08)
        assert width == pytest.approx(wide, rel=0.1)


def spot(picture):
    """Return column and row of the light's centre, and its mean distance from there, px."""
    rows, columns = np.indices(picture.shape)
    column, row = (np.average(each, weights=picture) for each in (columns, rows))
    return column, row, np.average(np.hypot(columns - column, rows - row), weights=picture)


def test_a_highlight_is_hidden_by_a_marker_before_the_led_or_the_camera():
    scene, _ = bare_path(lit(ONE, DARK, DARK, DARK, radius_mm=0.0), 1)
    black = {"radius_mm": 0.4, "colour": (0.0, 0.0, 0.0)}
    shiny = skinned(beads([(0, 0, 6)], **black), 2.5, 0.05)
    towards = Lamps.at(shiny.centres, scene).place[0, 0] - shiny.centres[0]
    towards /= np.linalg.norm(towards)
    alone = without_exposure(scene, shiny, SPLAT).sum()
    for aside, expected in ((towards, 0), ([0.0, 0.0, 1.0], 0), (-towards, alone)):
        pair = beads([(0, 0, 6), np.add((0, 0, 6), 1.2 * np.array(aside))], **black)
        pair = replace(pair, gloss=np.array([[2.5, 0.05], [0.0, 0.0]]))
        assert without_exposure(scene, pair, SPLAT).sum() == pytest.approx(expected, rel=1e-3)


def test_a_lost_marker_of_a_gloss_of_its_own_is_no_surface():
    lost = np.full(3, np.nan)
    markers = replace(beads([(0, 0, 6), lost]), gloss=np.array([[1.6, 0.1], [1.7, 0.1]]))
    (only,) = surfaces(block(), markers, None, None).values()
    assert only.gloss == (1.6, 0.1)


def test_a_skin_of_a_smaller_index_than_the_rubber_is_refused():
    red = block().markers["red"].model_copy(update={"gloss": (1.59, 0.1)})
    dense = changed(block().model_copy(update={"markers": {"red": red}}), material={"refractive_index": 1.6})
    with pytest.raises(
        RecipeError, match=r"markers.red.gloss = \(1.59, 0.1\): the skin's index must be above .* = 1.6"
    ):
        Renderer.method(dense)


# Texture of prints


def textured(spread, grain, **keys):
    """Return a scene of six white prints of 60 px, and its markers with and without texture, moved by whole pixels."""
    scene = bare_block(light={"ambient": 1.0})
    grid = {"pitch_mm": 1.4, "diameter_mm": 1.2, "columns": 3, "rows": 2, "offset_mm": (0.0, 0.0), **keys}
    layers = {
        name: scene.markers["red"].model_copy(
            update={"kind": "print", "colour": (1.0,) * 3, "texture": texture, **grid}
        )
        for name, texture in (("even", None), ("rough", (spread, grain)))
    }
    return scene.model_copy(update={"markers": layers}), layers


def rough_share(scene, layers, move_mm, make=SPLAT, seed=1, least=0.99):
    """Return the texture's factor in each pixel, NaN beside the prints."""
    pictures = []
    for layer in layers.values():
        prints = {"red": layer}
        at = MarkerSet.place(scene.body, prints)
        shapes = Ellipsoids.of(at, prints, np.tile(move_mm, (len(at), 1)), seed=seed)
        one = scene.model_copy(update={"markers": prints})
        pictures.append(without_exposure(one, shapes, make)[:, :, 1])
    even, rough = pictures
    return np.where(even > least * even.max(), rough / np.maximum(even, 1e-9), np.nan)


def test_a_texture_has_its_spread_and_grain_and_moves_with_the_marker():
    scene, layers = textured(0.2, 0.15)
    shares = [rough_share(scene, layers, (0.0, 0.0, 0.0), seed=seed) for seed in range(1, 9)]
    assert np.nanmean(shares) == pytest.approx(1, abs=0.02)
    assert np.nanstd(shares) == pytest.approx(0.2, rel=0.1)
    per_mm = np.diff(seen_at(np.array([[0.0, 0, 6.0], [1.0, 0, 6.0]]), scene)[:, 0])[0]
    for seed, share in enumerate(shares[:2], 1):
        aside = round(0.3 * per_mm)
        moved = rough_share(scene, layers, (aside / per_mm, 0.0, 0.0), seed=seed)[:, aside:]
        both = np.isfinite(moved) & np.isfinite(share[:, :-aside])
        assert both.sum() > 2000
        assert np.abs(moved - share[:, :-aside])[both].max() < 0.02
    step = round(0.5 * 0.15 * 1.2 * per_mm)
    near, far = (
        np.nanmean([(share[:, n:] - 1) * (share[:, :-n] - 1) for share in shares]) / 0.04 for n in (step, 4 * step)
    )
    assert 0.3 < near < 0.8
    assert abs(far) < 0.3
    assert np.nanmax(np.abs(shares[0] - shares[1])) > 0.2


def test_paths_see_the_same_texture():
    scene, layers = textured(0.2, 0.3)
    scene = changed(scene, light={"ambient": 0.0}, accuracy={"paths": 64})
    path = scene.model_copy(update={"renderer": "path"})
    ours, theirs = (
        rough_share(one, layers, (0.0, 0.0, 0.0), make, least=0.8) for one, make in ((scene, SPLAT), (path, mitsuba()))
    )
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert both.sum() > 300
    assert np.corrcoef(ours[both], theirs[both])[0, 1] > 0.9


# What is seen behind the markers and in the rubber


def bare_block(**tables):
    """Return the block without a cover and even light, seen by a camera over its middle."""
    scene = block().model_copy(update={"cover": None})
    upright = {"pupil_mm": (0.0, 0.0, scene.camera.pupil_mm[2]), "tilt_deg": (0.0, 0.0, 0.0)}
    return changed(scene, **{"light": {"ambient": 0.0}, "camera": upright, **tables})


def specked(**keys):
    """Return the block with balls in the rubber, and their places."""
    scene = bare_block()
    marks = Camera.Marks(**{"count": 2000, "size_mm": 0.3, "depth_mm": 12.0, "albedo": 0.0, **keys})
    camera = scene.camera.model_copy(update={"bubbles": marks})
    scene = changed(scene.model_copy(update={"camera": camera}), light={"outside": (1.0, 1.0, 1.0), "ambient": 0.0})
    places = np.pad(marks.lines((-50, -45), (50, 45)).mean(axis=1), ((0, 0), (0, 1)), constant_values=marks.depth_mm)
    return scene, places[np.abs(places[:, :2]).max(axis=1) < 48]


@pytest.mark.parametrize("hollow", [0.0, 0.7])
def test_specks_in_the_rubber_are_carried_and_strained_by_it(hollow):
    scene, places = specked(hollow=hollow, seed=12)
    renderer = Renderer(scene, rest_of(scene), SPLAT, subpixels=6)
    none = beads([(0, 0, np.nan)])
    clear = Renderer(changed(scene, camera={"bubbles": None}), rest_of(scene), SPLAT).radiance(none)[:, :, 1]
    stretch = np.diag([0.2, 0.0, 0.0])

    def moved(points):
        return np.tile([0.3, -0.2, 0.1], (len(points), 1)), np.tile(stretch, (len(points), 1, 1))

    for at, motion, wide in (
        (places, None, 1.0),
        (places + np.array([0.3, -0.2, 0.1]), renderer.scenery(moved, ()), 1.2),
    ):
        share = 1 - renderer.radiance(none, motion)[:, :, 1] / clear
        pixels = seen_at(at, scene)
        alone = KDTree(pixels).query(pixels, 2)[0][:, 1] > 22
        inside = np.flatnonzero(((pixels > 12) & (pixels < (107, 77))).all(axis=1) & alone)
        assert len(inside) == 4
        for column, row in pixels[inside]:
            window = np.s_[round(row) - 9 : round(row) + 10, round(column) - 9 : round(column) + 10]
            rows, columns = np.mgrid[window]
            part = share[window]
            # px per mm at that depth, by the projection of two points around
            ends = seen_at(np.array([[0.0, 0.0, 12.0], [0.1, 0.0, 12.0]]), scene)
            radius = 0.15 * 10 * np.linalg.norm(ends[1] - ends[0])
            assert part.sum() == pytest.approx(np.pi * radius**2 * wide * (1 - hollow**2), rel=0.04)
            assert_allclose([(part * columns).sum(), (part * rows).sum()] / part.sum(), (column, row), atol=0.05)


@pytest.mark.parametrize(("depth_mm", "hidden"), [(2.0, True), (12.0, False)])
def test_markers_nearer_to_the_camera_hide_specks_and_others_do_not(depth_mm, hidden):
    scene, _ = specked(depth_mm=depth_mm, count=20000, albedo=0.9)
    white = changed(scene, light={"outside": (0.0, 0.0, 0.0)})
    plain = changed(white, camera={"bubbles": None})
    markers = rest_of(scene)
    with_specks, without = (Renderer(each, markers, SPLAT).radiance(markers)[:, :, 2] for each in (white, plain))
    red = seen_at(markers.centres[:6], scene)
    there = np.rint(red).astype(int)
    change = np.array([np.abs(with_specks - without)[r - 2 : r + 3, c - 2 : c + 3].max() for c, r in there])
    assert (np.abs(with_specks - without) > 0.05).mean() > 0.1
    assert (change < 1e-6).all() if hidden else (change > 0.05).any()


def behind(scene, *probes):
    """Return a picture of no marker with probes, without the exposure."""
    renderer = Renderer(scene, rest_of(scene), SPLAT)
    still = np.zeros((0, 3))
    cover = CoverMotion(displacement_mm=still, gradient=np.zeros((0, 3, 3)), probes=probes)
    return renderer.radiance(beads([(0, 0, np.nan)]), cover) / renderer.exposure


@pytest.mark.parametrize("z_mm", [0.5, -3.0])
def test_a_probe_is_seen_through_bare_rubber_where_snells_law_has_it(z_mm):
    """A face in the rubber is as deep as a bead there; one behind it adds a layer of air, by hand."""
    scene = bare_block()
    seen = behind(scene, faced(z_mm, 4.0))[:, :, 0]
    around = np.arange(360) * np.pi / 180
    rim = np.column_stack([0.1 + 2 * np.cos(around), 0.05 + 2 * np.sin(around), np.full(360, max(z_mm, 0.0))])
    if z_mm > 0:
        column, row = seen_at(rim, scene).T
    else:
        gap = scene.camera.pupil_mm[2] - scene.body.base_z_mm - sum(la.thickness_mm for la in scene.camera.layers)
        media = [(scene.body.base_z_mm, scene.material.refractive_index), (gap - z_mm, 1.0)]
        media += [(la.thickness_mm, la.index) for la in scene.camera.layers]
        radius = np.hypot(rim[:, 0], rim[:, 1])
        tangent = radius / sum(t / n for t, n in media)
        for _ in range(50):  # a fixed point of the tangent in air
            sine = tangent / np.sqrt(1 + tangent**2)
            tangent = tangent * radius / sum(t * sine / n / np.sqrt(1 - (sine / n) ** 2) for t, n in media)
        away = scene.camera.focal_px * tangent / radius
        column, row = scene.camera.centre_px[0] + away * rim[:, 0], scene.camera.centre_px[1] - away * rim[:, 1]
    area = 0.5 * np.abs(np.sum(column * np.roll(row, -1) - row * np.roll(column, -1)))
    assert (seen > 0).sum() == pytest.approx(area, rel=0.006)
    centre = spot(seen > 0)[:2]
    assert_allclose(centre, (column.mean(), row.mean()), atol=0.1)


def test_a_probe_is_as_bright_as_a_cover_in_its_place_and_brighter_by_the_index_squared_behind_a_gap():
    bare = bare_block()
    covered = bare.model_copy(update={"cover": Cover(thickness_mm=0.5, albedo=(0.4, 0.2, 0.1))})
    touching, expected = behind(bare, faced(0.5, 40.0)), behind(covered)
    assert_allclose(touching[40:50, 55:65], expected[40:50, 55:65], rtol=2e-3)
    close, mirrored = behind(bare, faced(-1e-6, 40.0)), (0.41 / 2.41) ** 2
    level = behind(bare, faced(1e-6, 40.0))
    # Light from a matt face fills the half-space of air, and the critical cone in the rubber.
    assert_allclose(close[40:50, 55:65], (1.41 * (1 - mirrored)) ** 2 * level[40:50, 55:65], rtol=2e-3)
    thin = Cover(thickness_mm=0.01, albedo=(0.0, 0.0, 0.0), transmittance=0.3)
    assert_allclose(
        behind(bare.model_copy(update={"cover": thin}), faced(1e-6, 40.0)), 0.09 * level, rtol=1e-4, atol=1e-9
    )


@pytest.mark.parametrize("ambient", [0.0, 0.3])
def test_paths_see_the_same_probe_and_specks(ambient):
    """Once, too, where a share of the light is even and drawn apart: they were laid over both shares."""
    scene, _ = specked(albedo=0.5)
    scene = changed(scene, light={"ambient": ambient})
    path = changed(scene, accuracy={"paths": 1}).model_copy(update={"renderer": "path"})
    ours = Renderer(scene, rest_of(scene), SPLAT), beads([(2.0, 1.5, 6)])
    theirs = Renderer(path, rest_of(scene), mitsuba()), ours[1]
    still = np.zeros_like(ours[0].background.moving)
    cover = CoverMotion(displacement_mm=still, gradient=np.zeros((len(still), 3, 3)), probes=(faced(0.5),))
    one, two = (renderer.radiance(markers, cover) for renderer, markers in (ours, theirs))
    away = np.ones(one.shape[:2], bool)
    column, row = np.rint(seen_at(ours[1].centres, scene)[0]).astype(int)
    away[row - 12 : row + 13, column - 12 : column + 13] = False
    assert_allclose(two[away], one[away], atol=1e-6 * one.max())
    assert one[away].std() > 0.05


def test_light_of_the_surroundings_comes_through_but_for_the_probe():
    scene = bare_block(light={"ambient": 0.0, "outside": (0.5, 0.3, 0.1)})
    light, dark = behind(scene), behind(bare_block())
    assert not dark.any()
    assert_allclose(light[44, 59] / light[44, 59, 0], [1, 0.6, 0.2], rtol=1e-5)
    # Against white paper there, whose irradiance is known relative to the brightest marker's.
    places, up = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    top = Lamps.brightest(rest_of(scene), scene)[0]
    share = (1 - (0.41 / 2.41) ** 2) * 0.5 * top / Lamps.at(places, scene).irradiance(places, up)[0]
    white = behind(bare_block(), faced(1e-6, 40.0, (1.0, 1.0, 1.0)))[44, 59, 0]
    shone = behind(scene)[44, 59, 0]
    assert shone == pytest.approx(share * white, rel=1e-3)
    hidden = behind(scene, faced(0.5, albedo=(0.0, 0.0, 0.0)))
    assert (hidden[42:46, 57:62] == 0).all()
    with pytest.raises(ValueError, match=r"light.outside: the cover hides it; set cover.transmittance"):
        scene_of("block", light={**scene_of("block").light.model_dump(), "outside": (1, 1, 1)})


def test_leds_that_the_window_mirrors_over_the_picture_are_said_to_darken_it():
    with pytest.warns(AccuracyWarning, match=r"mirrors the LEDs .* all else is 2\.1 times darker"):
        twin.Sensor(twin.load_scene("gelpad_press", {"light.radius_mm": 1})).picture(None)


# Shadows on the cover


@pytest.mark.parametrize("lift_mm", [0.0, 0.4])
def test_a_disc_has_a_shadow_on_the_cover_where_arithmetic_has_it(lift_mm):
    """Of an LED in the rubber, which no refraction moves: as far from it as similar triangles say."""
    led, disc, depth, radius = np.array([6.0, 2.0, 30.0]), np.array([0.2, -0.1, 4.0]), 0.2, 0.3
    plain = changed(
        block(),
        light={"positions_mm": (tuple(led),), "ambient": 0.0},
        cover={"albedo": (0.5, 0.5, 0.5), "deforms": True, "thickness_mm": depth},
    )
    marker = beads([disc], radius_mm=radius)
    marker = replace(marker, axes=marker.axes * [1, 1, 0.01])
    light = []
    for scene in (plain, changed(plain, cover={"shadows": True})):
        renderer = Renderer(scene, marker, SPLAT, subpixels=4)
        n = len(renderer.background.points)
        motion = CoverMotion(displacement_mm=np.tile([0, 0, lift_mm], (n, 1)), gradient=np.zeros((n, 3, 3)))
        light.append(renderer.radiance(marker, motion if lift_mm else None)[:, :, 1])
    lost = 1 - light[1] / light[0]
    grown = (led[2] - depth - lift_mm) / (led[2] - disc[2])
    centre = led + grown * (disc - led)
    place, beside, below = seen_at(centre + np.array([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)]), plain)
    area = np.pi * (grown * radius) ** 2 * abs(np.linalg.det([beside - place, below - place])) * 1e4
    assert lost.sum() == pytest.approx(area, rel=0.01)
    rows, columns = np.indices(lost.shape)
    assert_allclose([np.sum(lost * columns), np.sum(lost * rows)] / lost.sum(), place, atol=0.05)
    assert lost.max() == pytest.approx(1, abs=1e-3), "all light of the one LED is lost"


def test_paths_have_the_same_shadows_on_the_cover():
    scene = changed(block(), light={"ambient": 0.0}, cover={"albedo": (0.3, 0.3, 0.3)})
    some = beads([(-0.8, 0.3, 2.0), (0.1, -0.4, 4.0), (0.9, 0.5, 1.0)], colour=(0.01, 0.01, 0.01))
    path = changed(scene, accuracy={"paths": 1024}).model_copy(update={"renderer": "path"})
    theirs = Renderer(path, some, mitsuba()).radiance(some)
    without, ours = (
        Renderer(changed(scene, cover={"shadows": on}), some, SPLAT, subpixels=4).radiance(some) for on in (False, True)
    )
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)
    off, on = (np.sqrt(np.mean((each - theirs) ** 2)) / theirs.mean() for each in (without, ours))
    assert on < 0.25 * off
