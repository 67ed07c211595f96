"""A sensor under one load after another: what it feels is what a run of the same press reports."""

import numpy as np
import pytest

import twin
from twin.errors import ContactError, InputError, RecipeError, TwinError
from twin.parts.body import Body
from twin.world.contact.pressing import PathMemory
from twin.world.elasticity.cache import REMEMBERED
from twin.world.elasticity.discretise import tile

QUICK = {"accuracy.contact_patches": 8, "accuracy.centroid_px": 0.05}


@pytest.fixture(scope="module")
def environment() -> twin.Environment:
    return twin.Environment(twin.load_scene("kamiyama_pillar", QUICK))


def test_what_is_known_of_the_markers_outlives_many_contacts(environment, monkeypatch):
    environment.step(None)
    sensor = environment.sensor
    points = sensor.actual.markers.points
    load = tile(twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1)), sensor.compliance.body)
    located: list[np.ndarray] = []

    def noted(body: Body, points: np.ndarray) -> None:
        located.append(points)

    monkeypatch.setattr("twin.parts.shape.Body.require_inside", noted)
    for count in range(2 * REMEMBERED):  # more sets of points than are remembered
        sensor.compliance.displacement(points + 1e-6 * (count + 1), load)
    assert len(located) == 2 * REMEMBERED
    sensor.compliance.displacement(points, load)
    assert len(located) == 2 * REMEMBERED


def test_it_feels_the_force_of_a_load_where_it_is(environment: twin.Environment) -> None:
    load = twin.Traction.disk(centre_mm=(3, -2), radius_mm=2.5, force_n=(0.3, 0, 2.0))
    seen = environment.step(load)
    np.testing.assert_allclose(seen.truth.total_force_n, [0.3, 0, 2.0], rtol=1e-9, atol=1e-9)
    assert seen.error["total_force_error"] < 0.06
    assert seen.error["centre_error_mm"] < 0.2
    push = np.clip(seen.force_n[:, 2], 0, None)
    assert np.linalg.norm(seen.site_mm[push.argmax(), :2] - [3, -2]) < 2.1
    assert seen.truth.force_n.sum(axis=0) == pytest.approx([0.3, 0, 2.0])
    assert seen.truth.state is None


def test_a_press_tells_its_contact_and_the_picture_shows_the_motion(environment: twin.Environment) -> None:
    press = twin.Press(probe=twin.Sphere(diameter_mm=6), at_mm=(0, 0), force_n=(0, 0, 1.5))
    seen = environment.step(press)
    assert seen.truth.state.force_n == pytest.approx([0, 0, 1.5], abs=1e-6)
    known = np.isfinite(seen.marker_shift_px).all(axis=1)
    assert known.mean() > 0.99
    off = (seen.marker_shift_px - seen.truth.marker_shift_px)[known]
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.abs(seen.truth.marker_shift_px).max() > 0.5


def test_steps_don_t_depend_on_those_before_but_on_their_number(environment: twin.Environment) -> None:
    load = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
    environment.reset()
    first = environment.step(load)
    environment.reset()
    again = environment.step(load)
    environment.step(twin.Traction.disk(centre_mm=(5, 5), radius_mm=2, force_n=(0, 0, 2)))
    later = environment.step(load)
    assert np.array_equal(first.picture, again.picture)
    np.testing.assert_allclose(first.force_n, again.force_n, atol=1e-12)
    assert not np.array_equal(first.picture, later.picture), "every exposure has noise of its own"
    np.testing.assert_allclose(first.truth.marker_displacement_mm, later.truth.marker_displacement_mm, atol=1e-12)
    np.testing.assert_allclose(first.total_force_n, later.total_force_n, atol=0.12)


def test_it_agrees_with_a_run_of_the_same_press() -> None:
    allowed = {"accuracy.displacement": 0.01}  # so few patches leave 6e-3
    overrides = {**QUICK, **allowed, "tolerance.preset": "none", "press.force_n": (None, None, 2.0)}
    scene = twin.load_scene("kamiyama_pillar", overrides)
    result = twin.run(scene, {"displacement", "forces"})
    environment = twin.Environment(scene)
    seen = environment.step(scene.press)
    np.testing.assert_allclose(seen.truth.marker_displacement_mm, result.truth.marker_displacement_mm, atol=1e-3 * 0.2)
    np.testing.assert_allclose(seen.total_force_n, result.estimate.total_force_n, atol=0.02)
    np.testing.assert_allclose(seen.sd_total_n, result.estimate.sd_total_n, rtol=0.2)
    assert (seen.sd_total_n > 1e-4).all()


def test_under_no_load_it_feels_noise_alone(environment: twin.Environment) -> None:
    seen = environment.reset()
    assert np.abs(seen.total_force_n).max() < 0.05
    assert seen.error["total_force_error"] is None
    assert not seen.truth.force_n.any()


def test_what_can_t_be_is_refused(environment: twin.Environment) -> None:
    with pytest.raises(RecipeError, match="camera"):
        twin.Environment(twin.load_scene("block_bare"))
    with pytest.raises(TwinError):
        environment.step(twin.Traction.disk(centre_mm=(300, 0), radius_mm=2, force_n=(0, 0, 1)))
    slipping = twin.Step(force_n=(3.0, 0.0, 1.0))
    with pytest.raises(ContactError):
        environment.step(twin.Press(probe=twin.Sphere(diameter_mm=6), steps=(slipping,), friction=0.3))


def test_in_time_rubber_creeps_from_step_to_step() -> None:
    """Under given tractions markers move by the creep function times the elastic motion."""
    share, time_s = 0.2, 0.5
    late = time_s / (1.0 - share)
    rubber = {"material.relaxation": [{"share": share, "time_s": time_s}]}
    environment = twin.Environment(twin.load_scene("kamiyama_pillar", QUICK | rubber))
    load = twin.Traction.disk(centre_mm=(0, 0), radius_mm=2, force_n=(0, 0, 1))
    elastic = environment.step(load).truth.marker_displacement_mm
    size = np.abs(elastic).max()

    def creep(seconds: float) -> float:
        return 1.0 + share / (1.0 - share) * (1.0 - np.exp(-seconds / late))

    environment.step(load, 0.0)
    held = environment.step(load, 0.7)
    assert held.truth.marker_displacement_mm == pytest.approx(creep(0.7) * elastic, abs=1e-9 * size)
    assert held.truth.total_force_n[2] == pytest.approx(1.0)
    assert creep(0.7) > 1.15
    assert held.total_force_n == pytest.approx([0, 0, 1], abs=0.06), "the software knows how its rubber relaxes"
    lifted = environment.step(None, 0.0)
    assert lifted.total_force_n == pytest.approx([0, 0, 0], abs=0.06)
    gone = lifted.truth.marker_displacement_mm
    assert gone == pytest.approx((creep(0.7) - 1.0) * elastic, abs=1e-9 * size)
    environment.reset()
    pushed = environment.step(load, 0.7)
    assert pushed.total_force_n == pytest.approx([0, 0, 1], abs=0.06)
    ramp = pushed.truth.marker_displacement_mm
    mean = np.mean([creep(0.7 * (i + 0.5) / 1000) for i in range(1000)])
    assert ramp == pytest.approx(mean * elastic, abs=1e-6 * size)
    # A press goes on where it was, and no other one follows it.
    press = twin.Press(probe=twin.Sphere(diameter_mm=6), steps=[twin.Step(move_mm={"z": 0.2})])
    stay = press.model_copy(update={"steps": (twin.Step(),)})
    with pytest.raises(InputError, match="reset"):
        environment.step(press, 0.0)
    for wrong in (-1.0, np.nan, "1"):
        with pytest.raises(InputError, match=f"seconds = {wrong!r}: give a number, 0 or more"):
            environment.step(press, wrong)
    environment.reset()
    first = environment.step(press, 0.0).truth.state
    later = environment.step(stay, 0.7).truth.state
    fallen = 1.0 - share * (1.0 - np.exp(-0.7 / time_s))
    assert later.force_n[2] == pytest.approx(fallen * first.force_n[2], rel=1e-6)
    with pytest.raises(InputError, match="reset"):
        environment.step(press.model_copy(update={"friction": 0.5}), 0.1)


def test_a_step_moves_the_probe_of_the_press_before_on(environment: twin.Environment) -> None:
    """Step by step the sensor feels what it feels after the whole path, slip and all."""
    down = twin.Press(probe=twin.Sphere(diameter_mm=6), friction=0.4, indentation_mm=0.3)
    aside = [twin.Step(move_mm={"x": 0.1}), twin.Step(move_mm={"x": -0.05})]
    environment.reset()
    environment.step(down)
    for step in aside:
        seen = environment.step(step)
    path = (twin.Step(move_mm={"z": 0.3}), *aside)
    whole = environment.step(twin.Press(probe=down.probe, friction=0.4, steps=path))
    assert seen.truth.total_force_n == pytest.approx(whole.truth.total_force_n, rel=1e-9, abs=1e-12)
    from_rest = environment.step(twin.Press(probe=down.probe, friction=0.4, steps=(path[0], path[1])))
    assert abs(seen.truth.total_force_n[0] - from_rest.truth.total_force_n[0]) > 0.02
    outside = twin.Traction.disk(centre_mm=(900, 0), radius_mm=2, force_n=(0, 0, 1))
    environment.step(down)
    environment.step(aside[0])
    for wrong, problem in ((outside, "surface"), ("press", "load")):
        with pytest.raises(InputError, match=problem):
            environment.step(wrong)
    again = environment.step(aside[1])
    assert again.truth.total_force_n == pytest.approx(seen.truth.total_force_n), "as if nothing wrong had come"
    environment.step(None)
    with pytest.raises(InputError, match="follows a press"):
        environment.step(aside[0])


BALL = twin.Sphere(diameter_mm=6)


NEO_HOOKEAN = {"material.law": "neo_hookean"}


def move(seconds: float = 0.0, **move_mm: float) -> twin.Step:
    return twin.Step(move_mm=move_mm, seconds=seconds)


def push(**force_n: float) -> twin.Step:
    return twin.Step(force_n=force_n)


@pytest.mark.parametrize(
    ("overrides", "friction", "steps"),
    [
        ({}, 0.4, [move(z=0.3), move(x=0.1), move(x=-0.05, z=-0.1), push(z=0.0), move(z=0.1)]),
        (
            {"material.relaxation": [{"share": 0.2, "time_s": 0.5}]},
            0.4,
            [move(0.2, z=0.3), twin.Step(seconds=0.5), move(0.1, x=0.1), move(0.3, z=-0.2)],
        ),
        (NEO_HOOKEAN, 0.0, [push(z=0.8), push(z=0.5)]),
        pytest.param(NEO_HOOKEAN, 0.5, [push(z=1.0), push(z=1.0, x=0.2), push(z=1.0, x=0.1)], marks=pytest.mark.slow),
    ],
)
def test_a_path_that_goes_on_is_solved_from_where_it_ended(overrides, friction, steps):
    sensor = twin.Sensor(twin.load_scene("kamiyama_pillar", QUICK | overrides))
    points = sensor.actual.markers.points
    memory = PathMemory()
    path = twin.Press(probe=BALL, friction=friction, steps=steps[:1])
    before = sensor.press(path, memory)
    for step in steps[1:]:
        path = path.model_copy(update={"steps": (*path.steps, step)})
        state = sensor.press(path, memory)
        whole = sensor.press(path)
        assert state.force_n == pytest.approx(whole.force_n, rel=1e-9, abs=1e-12)
        assert state.dissipated_nmm == pytest.approx(whole.dissipated_nmm, rel=1e-9, abs=1e-12)
        assert len(state.path) == len(whole.path)
        if state.load.terms:
            moved, known = sensor.displacement(points, state.load), sensor.displacement(points, whole.load)
            assert moved == pytest.approx(known, abs=1e-9 * np.abs(known).max())
        if strained := state.load.strained:
            assert strained.error.markers == pytest.approx(whole.load.strained.error.markers, rel=1e-6)
        assert all(one is other for one, other in zip(before.path, state.path, strict=False)), "not solved again"
        before = state


def test_a_contact_that_outgrows_its_grid_is_solved_again_as_a_whole() -> None:
    sensor = twin.Sensor(twin.load_scene("kamiyama_pillar", QUICK))
    memory = PathMemory()
    path = twin.Press(probe=BALL, friction=0.4, steps=[twin.Step(move_mm={"z": 0.1})])
    before = sensor.press(path, memory)
    path = path.model_copy(update={"steps": (*path.steps, twin.Step(move_mm={"z": 0.3}))})
    state, whole = sensor.press(path, memory), sensor.press(path)
    assert state.force_n == pytest.approx(whole.force_n, rel=1e-9)
    assert len(state.path[0].pressure_mpa) != len(before.pressure_mpa), "other patches, from the first step on"
    other = path.model_copy(update={"at_mm": (2.0, 0.0)})
    assert sensor.press(other, memory).force_n == pytest.approx(sensor.press(other).force_n, rel=1e-12)
