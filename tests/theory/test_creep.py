"""Relaxation and creep are inverse to each other, in time and in frequency."""

import numpy as np
import pytest

from twin.theory.relaxation import Hereditary, Relaxation

RUBBER = Relaxation(np.array([0.2, 0.1, 0.3]), np.array([0.1, 1.0, 30.0]))


def test_a_stress_that_creeps_under_it_is_held():
    """The convolution of the relaxation function with the creep function is a step."""
    edges = np.linspace(0.0, 5.0, 20001)
    middles = (edges[1:] + edges[:-1]) / 2
    held = RUBBER.modulus(5.0) + RUBBER.modulus(5.0 - middles) @ np.diff(RUBBER.creep(edges))
    assert held == pytest.approx(1.0, abs=1e-8)


def test_a_ramp_creeps_by_the_mean_of_its_steps():
    steps = np.linspace(0.0, 3.0, 6001)
    mean = RUBBER.creep(4.5 - (steps[1:] + steps[:-1]) / 2).mean()
    assert RUBBER.ramp_creep(1.5, 3.0) == pytest.approx(mean, rel=1e-7)
    assert RUBBER.ramp_creep(1.5, 0.0) == pytest.approx(float(RUBBER.creep(1.5)), rel=1e-13)


def relaxed(at, elastic):
    """Forces at (m,) times from the (m,) elastic ones."""
    history = Hereditary(RUBBER)
    steps = np.diff(at, prepend=at[0])
    return np.array([history.after(step, np.array([one]))[0] for step, one in zip(steps, elastic, strict=True)])


UNEVEN = np.concatenate([[0.0, 0.01], np.geomspace(0.02, 400.0, 30)])


def test_a_shape_that_is_held_relaxes():
    assert relaxed(UNEVEN, np.full(len(UNEVEN), 3.0)) == pytest.approx(3.0 * RUBBER.modulus(UNEVEN), rel=1e-13)


def test_a_shape_that_moves_linearly_is_exact_however_seldom_it_is_seen():
    """f = rate int_0^t G(s) ds, and G - 1 + sum g integrates to sum g tau (1 - exp(-t/tau))."""
    at = np.array([0.0, 0.7, 5.0, 40.0])
    late = (RUBBER.share * RUBBER.time_s) @ -np.expm1(-at / RUBBER.time_s[:, None])
    wanted = 2.0 * ((1.0 - RUBBER.share.sum()) * at + late)
    assert relaxed(at, 2.0 * at) == pytest.approx(wanted, rel=1e-13)


def test_a_force_that_is_held_and_let_go_is_found_from_the_creep():
    """Rubber creeps while the force is held, and creeps back after that: the force is none at once."""
    held, after = np.linspace(0.0, 3.0, 1501), np.linspace(0.0, 5.0, 2501)
    elastic = np.concatenate([RUBBER.creep(held), RUBBER.creep(3.0 + after) - RUBBER.creep(after)])
    assert elastic[1500] > 1.4
    assert elastic[1501] > 0.4, "what elastic rubber would show at once after the release"
    found = relaxed(np.concatenate([held, 3.0 + after]), elastic)
    assert found == pytest.approx(np.repeat([1.0, 0.0], [1501, 2501]), abs=2e-5)


def test_a_shape_that_swings_is_ahead_by_the_loss_angle():
    frequency = 1.7
    at = np.linspace(0.0, 400.0, 20001)
    found = relaxed(at, np.sin(frequency * at))[-1000:]
    modulus = 1.0 - (RUBBER.share / (1.0 + 1j * frequency * RUBBER.time_s)).sum()
    wanted = abs(modulus) * np.sin(frequency * at[-1000:] + np.angle(modulus))
    assert np.angle(modulus) > 0.1
    assert found == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("at", [0.0, 0.5, 1.0])
def test_what_a_sudden_change_between_two_pictures_does_lies_within_what_is_stated(at):
    """Seen every second, but lifted at once in between: all of it at the end is the worst, and is stated exactly."""
    seldom, true = Hereditary(RUBBER), Hereditary(RUBBER)
    for history in (seldom, true):
        history.after(0.0, np.ones(1))
    assert seldom.off[0] == 0.0, "at once"
    true.after(at, np.ones(1))
    true.after(0.0, np.zeros(1))
    true.after(1.0 - at, np.zeros(1))
    late = [(seldom.after(1.0, np.zeros(1))[0], true.after(0.0, np.zeros(1))[0], seldom.off[0])]
    late += [(seldom.after(1.0, np.zeros(1))[0], true.after(1.0, np.zeros(1))[0], seldom.off[0]) for _ in range(3)]
    error = np.array([abs(found - wanted) for found, wanted, _ in late])
    stated = np.array([off for *_, off in late])
    assert np.all(error <= stated * (1 + 1e-9))
    assert np.all(np.diff(stated) < 0.0)
    if at == 1.0:
        assert error == pytest.approx(stated, rel=1e-9)
