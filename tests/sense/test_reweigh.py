"""Lost and noisy markers without a factorisation of their own: the answers are those of one."""

import dataclasses

import numpy as np
import pytest
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.sense.bump import camera_bump
from twin.sense.problem import problem_of
from twin.sense.reconstruct import reconstruct
from twin.sense.single import single_contact

FINGER, FLAT = finger_sensor(), flat_sensor(8, 6)


def sequence_and_alone(sensor, lost=4, noisy=3, seed=0):
    """A picture as part of a sequence (its rest picture's noise known), and the same weighed by itself."""
    markers, seen, calibration = sensor
    random = np.random.default_rng(seed)
    points, forces = disk((1.0, -0.5), 3.0, (0.3, 0.1, 1.5))
    usual = random.choice([0.02, 0.04, 0.08], len(markers))
    odd = random.choice(len(markers), lost + noisy, replace=False)
    sd = usual.copy()
    sd[odd[lost:]] = 8.0 * usual[odd[lost:]]
    found = as_found(shifts(markers, seen, points, forces), calibration)
    shift = found.shift_px + random.normal(0, 1, (len(sd), 2)) * sd[:, None]
    shift[odd[:lost]] = np.nan
    sd[odd[:lost]] = np.nan
    alone = dataclasses.replace(found, shift_px=shift, sd_px=sd, state=None)
    return dataclasses.replace(alone, usual_sd_px=usual), alone, calibration


@pytest.mark.parametrize("sensor", [FINGER, FLAT])
@pytest.mark.parametrize("weight", [1e-12, 1e-6, 1e-2, 1.0, 1e12])
def test_a_given_weight_gives_the_same_answer(sensor, weight):
    """Against a factorisation with the very weights: equal but for how the noise's mean is taken in classes."""
    in_sequence, alone, calibration = sequence_and_alone(sensor)
    problem, own = (problem_of(found, calibration, "smooth") for found in (in_sequence, alone))
    assert problem.known.sum() == own.known.sum() + 4
    whitened = weight / problem.omega
    h = problem.base.transfer / problem.size_px
    w, d = problem.share, problem.whiten(in_sequence.shift_px)
    precision = h.T @ (w[:, None] * h) + whitened * problem.base.penalty
    exact = np.linalg.solve(precision, h.T @ (w * d))
    field = reconstruct(in_sequence, calibration, "smooth", weight)
    size = np.abs(exact).max()
    assert field.force_n.ravel() == pytest.approx(exact, abs=1e-5 * size)
    covariance = np.linalg.inv(precision)
    some = np.zeros((3, h.shape[1]))
    for axis in range(3):
        some[axis, axis::3] = 1.0
    assert problem.reweighed.covariance(whitened, some) == pytest.approx(some @ covariance @ some.T, rel=1e-4, abs=1e-9)
    assert problem.reweighed.site_variance(whitened) == pytest.approx(np.diag(covariance), rel=1e-4)
    residual = d - h @ exact
    evidence = (w * d) @ residual / (w > 0).sum()
    assert problem.reweighed.noise_scale(d, whitened) ** 2 == pytest.approx(evidence, rel=1e-4)


@pytest.mark.parametrize(
    ("sensor", "options"),
    [*((s, o) for s in (FINGER, FLAT) for o in ({}, {"push_only": True}, {"friction": 0.6})), (FLAT, {"robust": True})],
)
def test_the_automatic_answer_hardly_differs_from_one_factorised_for_itself(sensor, options):
    """The forces differ by less than a third of their own standard deviation, and so do the totals."""
    for seed in range(3):
        in_sequence, alone, calibration = sequence_and_alone(sensor, seed=seed)
        field, own = (reconstruct(found, calibration, **options) for found in (in_sequence, alone))
        off = np.abs(field.force_n - own.force_n) / own.sd_force_n
        assert np.sqrt(np.mean(off**2)) < 0.3
        assert np.all(np.abs(field.total_force_n - own.total_force_n) < 0.35 * own.sd_total_n)
        assert field.sd_total_n == pytest.approx(own.sd_total_n, rel=0.25)
        assert field.used.tolist() == own.used.tolist()
        assert field.kkt < 1e-9


def test_a_sequence_has_one_factorisation():
    bases = set()
    for lost in (0, 1, 5, 9):
        for noisy in (0, 3):
            in_sequence, _, calibration = sequence_and_alone(FLAT, lost, noisy)
            in_sequence = dataclasses.replace(in_sequence, usual_sd_px=np.full(len(in_sequence.sd_px), 0.03))
            bases.add(id(problem_of(in_sequence, calibration, "smooth").base))
    assert len(bases) == 1


def test_too_many_lost_markers_have_their_own():
    in_sequence, alone, calibration = sequence_and_alone(FINGER, lost=20, noisy=0)
    assert problem_of(in_sequence, calibration, "smooth").known.sum() == 41
    ours, own = (reconstruct(found, calibration) for found in (in_sequence, alone))
    assert ours.force_n == pytest.approx(own.force_n)


def test_bump_and_single_contact_weigh_alike():
    in_sequence, alone, calibration = sequence_and_alone(FINGER)
    moved = [dataclasses.replace(f, shift_px=f.shift_px + np.array([3.0, -1.0])) for f in (in_sequence, alone)]
    bumps = [camera_bump(found, calibration) for found in moved]
    assert bumps[0].shift_px == pytest.approx(bumps[1].shift_px, abs=bumps[1].sd_px)
    assert bumps[0].sd_px == pytest.approx(bumps[1].sd_px, rel=0.3)
    contacts = [single_contact(found, calibration, radius_mm=1.5) for found in (in_sequence, alone)]
    assert contacts[0].place_mm == pytest.approx(contacts[1].place_mm, abs=0.3 * contacts[1].sd_place_mm)
    assert np.all(np.abs(contacts[0].force_n - contacts[1].force_n) < 0.3 * contacts[1].sd_force_n)
