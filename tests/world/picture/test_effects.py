"""What recipes can add to light and camera: each effect against arithmetic, and none that is off costs anything."""

import pytest
from numpy.testing import assert_allclose, assert_array_equal
from small_scenes import SPLAT, block, changed, mitsuba, rest_of

from twin.errors import RecipeError
from twin.parts.camera import Light
from twin.parts.part import identity
from twin.world.picture.render import Renderer


def light_of(scene, variant=SPLAT):
    """Return a rest picture's light, and that without the exposure."""
    renderer = Renderer(scene, rest_of(scene), variant)
    light = renderer.radiance(rest_of(scene))
    return light, light / renderer.exposure


def test_what_is_off_changes_no_description():
    table = Light(positions_mm=((0, 0, 50),)).model_dump(mode="json")
    assert set(identity(table)) == {"positions_mm", "exponent", "profile", "radius_mm", "ambient"}


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


def test_red_leds_light_the_red_channel_only_and_even_light_has_their_colour():
    plain, red = light_of(block())[1], light_of(lit(*[(0.5, 0.0, 0.0)] * 4, ambient=0.2, radius_mm=0.0))[1]
    assert_allclose(red[:, :, 0], 0.5 * plain[:, :, 0], rtol=1e-4)
    assert_array_equal(red[:, :, 1:], 0)


def test_the_power_of_white_leds_is_taken_up_by_the_exposure():
    light, per_power = light_of(lit(*[(3.0, 3.0, 3.0)] * 4))
    plain, per_one = light_of(lit(*[(1.0, 1.0, 1.0)] * 4))
    assert_allclose(light, plain, rtol=1e-5)
    assert_allclose(per_power, 3 * per_one, rtol=1e-5)


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
