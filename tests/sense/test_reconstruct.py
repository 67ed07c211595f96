import dataclasses

import numpy as np
import pytest
from half_space_sensor import as_found, disk, finger_sensor, flat_sensor, shifts

from twin.errors import InputError
from twin.judge.score import force_score
from twin.sense.problem import penalty, problem_of
from twin.sense.reconstruct import reconstruct
from twin.sense.weigh import cross_validated_weight, factorise, most_likely_weight

FLAT = flat_sensor()
FINGER = finger_sensor()


def scored(field, points, forces):
    torque = np.cross(points, forces).sum(axis=0)
    return force_score(
        site_mm=field.site_mm, force_n=field.force_n, total_force_n=field.total_force_n,
        total_torque_nmm=field.total_torque_nmm, surface_mm=points, surface_force_n=forces,
        true_force_n=forces.sum(axis=0), true_torque_nmm=torque,
    )  # fmt: skip


def test_noise_free_field_is_recovered():
    """Own cells, no noise: smooth and norm recover the field, and the automatic weight goes to almost nothing."""
    _, _, calibration = FINGER
    force = np.random.default_rng(1).normal(0, 0.1, (25, 3))
    clean = (calibration.transfer @ force.ravel()).reshape(-1, 2)
    for method in ("smooth", "norm", "pinv"):
        field = reconstruct(as_found(clean, calibration), calibration, method)
        assert field.force_n == pytest.approx(force, abs=1e-6)
        assert field.total_force_n == pytest.approx(force.sum(axis=0), abs=1e-6)
        torque = np.cross(calibration.site_mm, force).sum(axis=0)
        assert field.total_torque_nmm == pytest.approx(torque, abs=1e-5)


@pytest.mark.parametrize("noise", [0.02, 0.04])
def test_pillar_on_the_flat_sensor(noise):
    """The 5 mm pillar, other footprint than the sites, several exposures: totals and centre of pressure."""
    markers, seen, calibration = FLAT
    for centre, force in (((0, 0), (0, 0, 3.0)), ((4.3, -3.1), (0, 0, 3.0)), ((2, 1), (1.0, 0.5, 2.0))):
        points, forces = disk(centre, 5.0, force)
        clean = shifts(markers, seen, points, forces)
        results = [
            scored(reconstruct(as_found(clean, calibration, noise, seed), calibration), points, forces)
            for seed in range(8)
        ]
        figures = ("total_force_error", "centre_error_mm", "field_error")
        rms = {key: np.sqrt(np.mean([r[key] ** 2 for r in results])) for key in figures}
        assert rms["total_force_error"] < 0.03
        assert rms["centre_error_mm"] < 0.3
        assert rms["field_error"] < 0.45


def test_totals_are_unbiased():
    """Mean error of the totals over exposures: regularisation must not shrink them."""
    markers, seen, calibration = FLAT
    points, forces = disk((1.0, 2.0), 5.0, (0.6, -0.4, 2.0))
    clean = shifts(markers, seen, points, forces)
    fields = [reconstruct(as_found(clean, calibration, 0.03, seed), calibration) for seed in range(20)]
    totals = np.array([field.total_force_n for field in fields])
    assert np.abs(totals.mean(axis=0) - forces.sum(axis=0)).max() < 0.015 * np.linalg.norm(forces.sum(axis=0))
    stated = np.mean([field.sd_total_n for field in fields], axis=0)
    assert (totals.std(axis=0) < 1.3 * stated).all()
    assert (totals.std(axis=0) > 0.3 * stated).all()


def test_finger_sensor_within_observability():
    markers, seen, calibration = FINGER
    for centre, diameter, force, limit in (
        ((0, 0), 2.0, (0, 0, 1.0), 0.04), ((1.3, 1.1), 2.0, (0.3, -0.2, 1.0), 0.05), ((0, 0), 8.0, (0, 0, 2.0), 0.02)
    ):  # fmt: skip
        points, forces = disk(centre, diameter, force)
        clean = shifts(markers, seen, points, forces)
        results = [
            scored(reconstruct(as_found(clean, calibration, 0.03, seed), calibration), points, forces)
            for seed in range(8)
        ]
        assert np.sqrt(np.mean([r["total_force_error"] ** 2 for r in results])) < limit
        assert max(r["centre_error_mm"] for r in results) < 0.5


def test_signs():
    """A push is +z; a torque turning x towards y is positive about z, and tilts have the moment's sign."""
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 8.0, (0, 0, 0.0))
    forces = 0.02 * np.column_stack([-points[:, 1], points[:, 0], np.zeros(len(points))])
    torque = np.cross(points, forces).sum(axis=0)
    assert torque[2] > 0
    field = reconstruct(as_found(shifts(markers, seen, points, forces), calibration, 0.02, 1), calibration)
    assert field.total_torque_nmm[2] == pytest.approx(torque[2], rel=0.08)
    points, forces = disk((3.0, -2.0), 3.0, (0, 0, 1.0))
    field = reconstruct(as_found(shifts(markers, seen, points, forces), calibration, 0.02, 1), calibration)
    assert field.total_force_n[2] == pytest.approx(1.0, rel=0.06)
    assert field.total_torque_nmm[:2] == pytest.approx([-2.0, -3.0], abs=0.8)


def test_automatic_weight_is_near_the_best():
    markers, seen, calibration = FLAT
    for noise, diameter in ((0.02, 5.0), (0.05, 5.0), (0.05, 3.0)):
        points, forces = disk((1.0, 0.5), diameter, (0.3, 0.0, 2.0))
        found = as_found(shifts(markers, seen, points, forces), calibration, noise, 3)
        for method in ("smooth", "norm"):
            auto = reconstruct(found, calibration, method)
            error = {
                weight: scored(reconstruct(found, calibration, method, weight), points, forces)["field_error"]
                for weight in auto.weight * 10.0 ** np.linspace(-3, 3, 19)
            }
            assert scored(auto, points, forces)["field_error"] < 1.25 * min(error.values())


def test_pseudo_inverse_diverges_as_the_paper_says():
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (0, 0, 3.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.05, 1)
    plain = scored(reconstruct(found, calibration, "pinv"), points, forces)["field_error"]
    assert plain > 5.0
    assert scored(reconstruct(found, calibration, "smooth"), points, forces)["field_error"] < 0.6


def test_lost_markers_are_left_out():
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (0, 0, 3.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.02, 1)
    shift = found.shift_px.copy()
    shift[::9] = np.nan
    some = reconstruct(dataclasses.replace(found, shift_px=shift), calibration)
    assert some.used.sum() == np.isfinite(shift[:, 0]).sum()
    assert some.total_force_n[2] == pytest.approx(3.0, rel=0.06)
    with pytest.raises(InputError, match="at least 2"):
        reconstruct(dataclasses.replace(found, shift_px=np.full_like(shift, np.nan)), calibration)
    with pytest.raises(InputError, match="calibration's"):
        reconstruct(dataclasses.replace(found, layer=found.layer[::-1]), calibration)


def test_noisy_markers_weigh_less():
    markers, seen, calibration = FLAT
    points, forces = disk((0, 0), 5.0, (0, 0, 3.0))
    clean = shifts(markers, seen, points, forces)
    found = as_found(clean, calibration, 0.02, 1)
    random = np.random.default_rng(5)
    bad = random.random(len(clean)) < 0.2
    shift = found.shift_px + bad[:, None] * random.normal(0, 1.0, clean.shape)
    told = dataclasses.replace(found, shift_px=shift, sd_px=np.where(bad, 1.0, 0.02))
    untold = dataclasses.replace(found, shift_px=shift)
    errors = [scored(reconstruct(f, calibration), points, forces)["field_error"] for f in (told, untold)]
    assert errors[0] < 0.7 * errors[1]


def test_kept_factorisation_serves_other_noise():
    """Even noise only scales: force and weight must not depend on its stated size, nor on what was solved before."""
    markers, seen, calibration = finger_sensor()
    points, forces = disk((0, 0), 3.0, (0.2, 0, 1.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.03, 1)
    first = reconstruct(found, calibration)
    louder = reconstruct(dataclasses.replace(found, sd_px=3 * found.sd_px), calibration)
    fresh = reconstruct(found, dataclasses.replace(calibration))
    for other in (louder, fresh):
        assert other.force_n == pytest.approx(first.force_n, rel=1e-6, abs=1e-9)
        assert other.weight == pytest.approx(first.weight, rel=1e-6)
        assert other.noise_px == pytest.approx(first.noise_px, rel=1e-6)
        assert other.sd_total_n == pytest.approx(first.sd_total_n, rel=1e-6)


def test_noise_in_classes_shares_a_factorisation():
    """Noise estimated a little differently in every picture must not cost a factorisation each."""
    markers, seen, calibration = finger_sensor()
    points, forces = disk((0, 0), 3.0, (0.2, 0, 1.0))
    found = as_found(shifts(markers, seen, points, forces), calibration, 0.03, 1)
    random = np.random.default_rng(5)
    sd = np.where(np.arange(len(found.sd_px)) % 7 == 0, 0.4, 0.03)
    bases = set()
    for _ in range(4):
        noisy = dataclasses.replace(found, sd_px=sd * random.uniform(0.9, 1.1, len(sd)))
        bases.add(id(problem_of(noisy, calibration, "smooth").base))
    assert len(bases) == 1
    exact = reconstruct(dataclasses.replace(found, sd_px=sd), calibration)
    assert reconstruct(noisy, calibration).force_n == pytest.approx(exact.force_n, rel=0.02, abs=2e-3)


def test_nothing_pressed_is_nothing_felt():
    _, _, calibration = FLAT
    still = np.zeros((len(calibration.layer), 2))
    assert np.all(reconstruct(as_found(still, calibration), calibration).force_n == 0)
    field = reconstruct(as_found(still, calibration, 0.03, 1), calibration)
    assert np.linalg.norm(field.total_force_n) < 0.1
    assert np.abs(field.force_n).max() < 0.05


def test_given_weight_solves_the_papers_equation():
    """F = (H^T H + w/2 Q)^-1 H^T M, written out."""
    markers, seen, calibration = FINGER
    points, forces = disk((0, 0), 3.0, (0.1, 0, 1.0))
    shift = shifts(markers, seen, points, forces)
    h, weight = calibration.transfer, 0.7
    expected = np.linalg.solve(h.T @ h + 0.5 * weight * np.eye(75), h.T @ shift.ravel())
    field = reconstruct(as_found(shift, calibration), calibration, "norm", weight)
    assert field.force_n.ravel() == pytest.approx(expected, abs=1e-10)
    assert field.weight == pytest.approx(weight)
    step = np.zeros((5, 5, 3))
    step[2, 3, 1] = 1.0
    padded = np.pad(step, ((1, 1), (1, 1), (0, 0)))
    roughness = sum((np.diff(padded, axis=a) ** 2).sum() for a in (0, 1))
    assert step.ravel() @ penalty(calibration, "smooth") @ step.ravel() == pytest.approx(roughness)


def test_marginal_likelihood_finds_a_drawn_weight():
    """Forces and noise drawn from the prior: the weight is their variance ratio."""
    random = np.random.default_rng(2)
    likely, validated = [], []
    for _ in range(20):
        h = random.normal(0, 1, (120, 40))
        data = h @ random.normal(0, 0.5, 40) + random.normal(0, 1.0, 120)
        likely.append(most_likely_weight(factorise(h, np.eye(40)), data))
        validated.append(cross_validated_weight(factorise(h, np.eye(40)), data))
    assert np.median(likely) == pytest.approx(4.0, rel=0.3)
    assert 2.0 < np.median(validated) < 20.0


def test_wrong_options():
    _, _, calibration = FINGER
    found = as_found(np.zeros((61, 2)), calibration)
    with pytest.raises(InputError, match="method"):
        reconstruct(found, calibration, "best")
    for weight in (-1.0, np.nan):
        with pytest.raises(InputError, match="weight"):
            reconstruct(found, calibration, "smooth", weight)
