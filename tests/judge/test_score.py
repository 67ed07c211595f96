"""Scores as defined, and what counts as resolved."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.inverse import widths
from twin.errors import InputError
from twin.judge.score import dip, force_score, full_width, into_cells, score, tracking_score, two_point_distance
from twin.parts.load import Rectangles


def pushes(**changes):
    site = np.array([[x, y, 0.0] for x in (-2.0, 0.0, 2.0) for y in (-2.0, 0.0, 2.0)])
    surface = np.array([[0.3, 0.2, 0.0], [-0.3, 0.2, 0.0], [1.9, 0.1, 0.0]])
    force = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.2, 0.5]])
    cells = into_cells(site, surface, force)
    given = {
        "site_mm": site, "force_n": cells, "total_force_n": cells.sum(axis=0),
        "total_torque_nmm": np.cross(surface, force).sum(axis=0), "surface_mm": surface, "surface_force_n": force,
        "true_force_n": force.sum(axis=0), "true_torque_nmm": np.cross(surface, force).sum(axis=0),
        "sd_force_n": 0.1 * np.abs(cells), "sd_total_n": np.array([0.03, 0.0, 0.04]), "sd_torque_nmm": np.full(3, 0.2),
    }  # fmt: skip
    return given | changes


def scored(frames=None, **changes):
    given = pushes(**changes)
    field = SimpleNamespace(**given)
    names = ("surface_mm", "surface_force_n", "true_force_n", "true_torque_nmm")
    truth = dict(
        zip(("centre_mm", "force_n", "total_force_n", "total_torque_nmm"), (given[n] for n in names), strict=True)
    )
    return force_score(field, SimpleNamespace(**truth), frames)


def test_truth_scores_zero():
    given = pushes()
    result = scored()
    assert result["field_error"] == 0
    assert result["total_force_error"] == 0
    assert result["torque_error"] == 0
    centre = given["force_n"][:, 2] @ given["site_mm"][:, :2] / 2.5
    true = given["surface_force_n"][:, 2] @ given["surface_mm"][:, :2] / 2.5
    assert result["centre_error_mm"] == pytest.approx(np.linalg.norm(centre - true))
    assert result["reasons"] == {}


def test_errors_as_defined():
    given = pushes()
    force = given["force_n"]
    result = scored(force_n=1.1 * force)
    assert result["field_error"] == pytest.approx(0.1)
    assert result["field_stated"] == pytest.approx(0.1), "every site states a tenth of its true force"
    assert result["total_force_stated"] == pytest.approx(0.05 / np.linalg.norm(given["true_force_n"]))
    assert result["torque_stated_nmm"] == pytest.approx(0.2 * 3**0.5)
    total = given["true_force_n"] + [0.0, 0.3, 0.0]
    result = scored(total_force_n=total)
    assert result["total_force_error"] == pytest.approx(0.3 / np.linalg.norm(given["true_force_n"]))
    torque = given["true_torque_nmm"] + [0.0, 0.0, 0.5]
    scale = max(np.linalg.norm(given["true_torque_nmm"]), np.linalg.norm(given["true_force_n"]))
    assert scored(total_torque_nmm=torque)["torque_error"] == pytest.approx(0.5 / scale)


def test_sums_of_bounded_sites_and_absolute_torque():
    """Bounds change the sites' sum, not the total; without a torque to compare with there is its error in N mm."""
    given = pushes()
    result = scored(force_n=1.2 * given["force_n"])
    assert result["total_force_error"] == 0
    assert result["sites_force_error"] == pytest.approx(0.2)
    zero = {"true_torque_nmm": np.zeros(3), "total_torque_nmm": np.array([0.0, 0.0, 0.3])}
    assert scored(**zero)["torque_error_nmm"] == pytest.approx(0.3)


def test_force_nulls_have_reasons():
    nothing = np.zeros((3, 3))
    result = scored(surface_force_n=nothing, true_force_n=np.zeros(3), true_torque_nmm=np.zeros(3))
    for key in ("field_error", "total_force_error", "torque_error", "centre_error_mm"):
        assert result[key] is None
        assert result["reasons"][key]
    shear = np.array([[1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0.01]])
    result = scored(surface_force_n=shear, true_force_n=shear.sum(axis=0))
    assert result["centre_error_mm"] is None
    assert "hardly pushes" in result["reasons"]["centre_error_mm"]
    assert scored(force_n=np.full((9, 3), np.nan))["field_error"] is None


def test_errors_by_direction():
    given = pushes()
    force = given["force_n"].copy()
    force[:, 2] *= 1.2
    total = given["true_force_n"] + [0.0, 0.0, -0.1]
    result = scored(force_n=force, total_force_n=total)
    assert result["field_error_normal"] == pytest.approx(0.2)
    assert result["field_error_tangential"] == 0.0
    size = np.linalg.norm(given["true_force_n"])
    assert result["total_force_error_axes"] == pytest.approx([0.0, 0.0, -0.1 / size])
    sideways = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    turned = scored(force_n=force, frames=np.tile(sideways, (9, 1, 1)))
    assert turned["field_error_normal"] == 0.0
    pressed = np.array([[0.0, 0, 1.0]] * 3)
    only = scored(surface_force_n=pressed, true_force_n=pressed.sum(axis=0))
    assert only["field_error_tangential"] is None
    assert "field_error_tangential" in only["reasons"]
    slanted = np.array([[0.02, 0, 1.0]] * 3)
    hardly = scored(surface_force_n=slanted, true_force_n=slanted.sum(axis=0))
    assert hardly["reasons"]["field_error_tangential"] == "less than 3% of the true field is in its tangential part"


def test_tracking_numbers_and_hidden_markers():
    random = np.random.default_rng(3)
    true = random.normal(0, 2, (4000, 2))
    shift = true + random.normal([0.02, -0.01], 0.05, true.shape)
    shift[:40] = np.nan
    shift[40:45] += 30.0
    visible = np.ones(len(true), bool)
    visible[-400:] = False
    shift[-400:] += 0.5
    result = tracking_score(shift, true, visible)
    assert result["bias_px"] == pytest.approx(np.hypot(0.02, 0.01), abs=0.003)
    assert result["bias_axes_px"] == pytest.approx([0.02, -0.01], abs=0.003)
    assert result["sd_px"] == pytest.approx(0.05, rel=0.03)
    assert result["matched"] == pytest.approx(3560 / 3600)
    assert result["gross"] == 5
    assert result["occluded"]["bias_axes_px"][0] == pytest.approx(0.52, abs=0.01)
    assert result["sd_axes_px"] == pytest.approx([0.05, 0.05], rel=0.05)
    assert result["false_positives"] == 0
    assert result["over_bound"] is None
    assert "over_bound" in result["reasons"]
    gone = true.copy()
    gone[-3:] = np.nan
    result = tracking_score(shift, gone, visible, bound_px=np.full(len(true), 0.04))
    assert result["false_positives"] == 3
    assert result["over_bound"] == pytest.approx(1.25, rel=0.03)
    assert "over_bound" not in result["reasons"]
    without_contrast = tracking_score(shift, true, visible, bound_px=np.full(len(true), 1e200))
    assert without_contrast["bound_px"] == pytest.approx(1e200), "its square is beyond counting"


def test_score_gathers_reasons_and_is_plain_json():
    lost = tracking_score(np.full((5, 2), np.nan), np.zeros((5, 2)))
    assert lost["matched"] == 0.0
    assert lost["bias_px"] is None
    result = score(elastic={"displacement_error": 1e-3}, tracking=lost, force=None)
    assert result["force"] is None
    assert {"tracking.bias_px", "tracking.sd_px", "force"} <= set(result["reasons"])
    json.dumps(result, allow_nan=False)
    with pytest.raises(InputError, match="displacement_error"):
        score(elastic={"displacement_error": float("nan")})


def test_a_spread_takes_two_markers():
    shift = np.array([[0.1, 0.0], [0.3, 0.0]])
    one, two = (tracking_score(shift[:n], np.zeros((n, 2))) for n in (1, 2))
    assert one["sd_px"] is None
    assert "sd_px" in one["reasons"]
    assert two["sd_axes_px"] == pytest.approx([0.02**0.5, 0.0])


def test_a_field_is_scored_against_the_patches_that_press():
    given = pushes()
    centre_mm, force_n = np.array(given["surface_mm"]), np.array(given["surface_force_n"])
    frames, half_mm = np.broadcast_to(np.eye(3), (len(centre_mm), 3, 3)), np.ones((len(centre_mm), 2))
    patches = Rectangles(centre_mm=centre_mm, frames=frames, half_mm=half_mm, force_n=force_n)
    assert force_score(SimpleNamespace(**given), patches) == scored()


def test_shapes_are_checked():
    with pytest.raises(InputError, match="same marker order"):
        tracking_score(np.zeros((4, 2)), np.zeros((5, 2)))
    with pytest.raises(InputError, match="surface"):
        scored(surface_mm=np.zeros((2, 3)))


def test_a_piece_on_the_border_of_cells_is_shared() -> None:
    sites = np.array([[0.0, 0, 0], [2.0, 0, 0]])
    cells = into_cells(sites, np.array([[1.0, 0, 0], [0.5, 0, 0]]), np.array([[0.0, 0, 2.0], [0, 0, 3.0]]))
    assert cells[:, 2].tolist() == [4.0, 1.0]


def test_width_of_a_known_bell():
    x = np.linspace(-5, 5, 401)
    assert full_width(x, np.exp(-(x**2) / 2)) == pytest.approx(2 * np.sqrt(2 * np.log(2)), rel=1e-3)
    assert full_width(x, np.maximum(1 - np.abs(x - 0.6) / 2, 0)) == pytest.approx(2.0, rel=1e-6)
    coarse = np.array([0, 0.2, 0.8, 1, 0.8, 0.2, 0])
    assert full_width(np.arange(7.0), coarse) == pytest.approx(3.0), "the crossing nearest to the peak"
    assert np.isnan(full_width(x, x + 10))
    assert widths(np.ones(12), (4, 3), 1.0) == (np.inf, np.inf)
    s, t = np.meshgrid(0.1 * np.arange(60), 0.1 * np.arange(40), indexing="ij")
    bell = np.exp(-((s - 3) ** 2) / 2 / 0.5**2 - (t - 2) ** 2 / 2 / 0.3**2)
    assert widths(bell.ravel(), (60, 40), 0.1) == pytest.approx((0.5 * 2.3548, 0.3 * 2.3548), rel=0.01)


def test_the_dip_of_two_gaussians() -> None:
    x = np.linspace(-10, 10, 401)

    def two(apart: float) -> np.ndarray:
        return sum(np.exp(-((x - s * apart / 2) ** 2) / 2) for s in (-1, 1))

    assert dip(x, two(1.0), 1.0) == 0.0, "closer than their width, two pushes are one"
    between, peak = 2 * np.exp(-2.0), two(4.0).max()
    assert dip(x, two(4.0), 4.0) == pytest.approx(1 - between / peak, rel=1e-6)
    beside = np.where(np.abs(x) > 3.3, 9.0, two(4.0))
    assert dip(x, beside, 4.0) == dip(x, two(4.0), 4.0), "peaks are within a quarter of the distance"
    assert dip(np.array([-1.0, 1.0]), np.ones(2), 2.0) == 0.0, "nothing was sampled between them"
    for side in (-1, 1):
        assert dip(np.linspace(-1, 0.4, 15) * side, np.arange(15.0), 2.0) == 0.0, "one place was not sampled"


def test_the_least_distance_is_interpolated_and_never_optimistic() -> None:
    apart = np.array([1.0, 2.0, 3.0, 4.0])
    assert two_point_distance(apart, np.array([0.0, 0.1, 0.3, 0.5])) == pytest.approx(2.5)
    assert two_point_distance(apart, np.array([0.3, 0.1, 0.3, 0.5])) == pytest.approx(2.5), "a stray dip does not count"
    assert two_point_distance(apart, np.array([0.3, 0.4, 0.5, 0.6])) == 1.0
    assert two_point_distance(apart, np.zeros(4)) == np.inf


def test_a_width_that_is_wanted_at_least_is_never_missing():
    x = np.linspace(-4.0, 4.0, 9)
    assert full_width(x, np.maximum(0.0, 1.0 - np.abs(x) / 3.0), at_least=True) == pytest.approx(3.0)
    assert full_width(x, np.ones(9), at_least=True) == pytest.approx(8.0), "as wide as its samples"
    assert np.isnan(full_width(x, np.ones(9)))
