"""Relaxation and creep are inverse to each other, in time and in frequency."""

import numpy as np
import pytest

from twin.theory.relaxation import Relaxation

RUBBER = Relaxation(np.array([0.2, 0.1, 0.3]), np.array([0.1, 1.0, 30.0]))


def test_one_term_creeps_as_the_standard_linear_solid():
    share, time_s = 0.25, 2.0
    found = Relaxation(np.array([share]), np.array([time_s]))
    at = np.array([0.0, 0.5, 3.0, 1e6])
    late = time_s / (1.0 - share)
    wanted = 1.0 + share / (1.0 - share) * (1.0 - np.exp(-at / late))
    assert found.creep(at) == pytest.approx(wanted, rel=1e-13)


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


def test_a_stress_that_swings_loses_what_the_loss_modulus_tells():
    """Of a unit stress the loop of stress and strain holds pi J'' = pi G''/|G|^2."""
    frequency = 1.7
    period = 2.0 * np.pi / frequency
    time_s = np.linspace(0.0, 40 * period, 40 * 200 + 1)
    stress = np.sin(frequency * time_s)
    last = time_s[-201:]
    growth = np.diff(stress)
    middles = (time_s[1:] + time_s[:-1]) / 2
    strain = [RUBBER.creep(now - middles[middles < now]) @ growth[middles < now] for now in last]
    lost = np.sum((stress[-201:-1] + stress[-200:]) / 2 * np.diff(strain))
    modulus = RUBBER.dynamic_modulus(frequency)
    assert lost == pytest.approx(np.pi * modulus.imag / abs(modulus) ** 2, rel=1e-3)
