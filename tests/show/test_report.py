"""The report page: whole, self-contained, true to the numbers, the right way up, and visible."""

import base64
import io
import re
import shutil
import subprocess
from cProfile import Profile
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from twin.results import Estimate, RunResult, Truth
from twin.show import html_page
from twin.show.html_page import digits
from twin.show.report import report

SCENE = 'title = "Flat sensor, 5 mm pillar"\nseed = 1\n\n[press]\nat_mm = [4, -3]\n'
SCALE = 0.05  # mm per px
VOID = {"meta", "img", "br", "link", "input", "hr"}


def grid(columns: int, rows: int, pitch: float, z: float) -> np.ndarray:
    x, y = (pitch * (np.arange(n) - (n - 1) / 2) for n in (columns, rows))
    xx, yy = np.meshgrid(x, y)
    return np.column_stack([xx.ravel(), yy.ravel(), np.full(xx.size, z)])


def to_px(points: np.ndarray) -> np.ndarray:
    return np.column_stack([319.5 + points[:, 0] / SCALE, 239.5 - points[:, 1] / SCALE])


def pressed(points: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Half-space displacement (Boussinesq and Cerruti at nu = 0.5) under a point force at (4, -3), E = 1."""
    r = points - [4.0, -3.0, 0.0]
    d = np.linalg.norm(r, axis=1, keepdims=True)
    return 1.5 / (4 * np.pi) * (force / d + r * (r @ force)[:, None] / d**3) * 2


def camera_picture(rng: np.random.Generator, px: np.ndarray, layer: np.ndarray) -> np.ndarray:
    light = np.full((480, 640, 3), 12.0)
    row, column = np.mgrid[:480, :640]
    for (c, r), name in zip(px, layer, strict=True):
        if np.isfinite(c):
            window = np.s_[max(0, int(r) - 9) : int(r) + 10, max(0, int(c) - 9) : int(c) + 10]
            cover = np.clip(5.5 - np.hypot(column[window] - c, row[window] - r), 0, 1)[..., None]
            colour = np.array([185.0, 30, 25]) if name == "red" else np.array([22.0, 40, 185])
            light[window] = cover * colour + (1 - cover) * light[window]
    return np.clip(light + rng.normal(0, 1.2, light.shape), 0, 255).round().astype(np.uint8)


@pytest.fixture(scope="module")
def full() -> RunResult:
    """A run like that of the flat sensor, with plausible errors at every stage."""
    rng = np.random.default_rng(7)
    rest = np.vstack([grid(21, 16, 1.5, 6.0), grid(20, 15, 1.5, 3.0)])
    layer = np.array(["red"] * 336 + ["blue"] * 300)
    total = np.array([0.4, 0.1, 2.0])
    moved = pressed(rest, total)
    rest_px, pressed_px = to_px(rest), to_px(rest + moved)
    patches = grid(16, 16, 0.3, 0.0)
    patches = patches[np.hypot(*patches[:, :2].T) < 2.4]
    share = np.sqrt(1.0001 - (np.hypot(*patches[:, :2].T) / 2.4) ** 2)[:, None]
    patches += np.array([4.0, -3.0, 0.0])
    truth = Truth(
        marker_rest_mm=rest, marker_displacement_mm=moved, marker_layer=layer, marker_rest_px=rest_px,
        marker_pressed_px=pressed_px, marker_outline_rest_px=rest_px, marker_outline_pressed_px=pressed_px,
        marker_visible=np.ones(len(rest), bool), surface_mm=patches, surface_force_n=share / share.sum() * total,
        total_force_n=total, total_torque_nmm=np.array([-6.0, -8.0, 1.6]),
    )  # fmt: skip
    shift = pressed_px - rest_px + rng.normal(0, 0.015, rest_px.shape)
    shift[[10, 40, 400]] = np.nan
    sites = grid(15, 12, 2.0, 0.0)
    blurred = np.exp(-((sites - [4.1, -3.1, 0.0]) ** 2).sum(axis=1) / 2 / 1.6**2)[:, None]
    force = blurred / blurred.sum() * total * 1.02 + rng.normal(0, 0.01, sites.shape)
    estimate = Estimate(
        marker_rest_px=rest_px, marker_shift_px=shift, site_mm=sites, force_n=force,
        marker_sd_px=np.full(len(shift), 0.015), marker_state=np.where(np.isnan(shift[:, 0]), "missing", "seen"),
        total_force_n=total * 1.013, total_torque_nmm=np.array([-6.2, -8.1, 1.5]),
        sd_force_n=np.full(sites.shape, 0.02), sd_total_n=np.array([0.011, 0.012, 0.023]),
        sd_torque_nmm=np.full(3, 0.15),
    )  # fmt: skip
    return RunResult(
        scene_toml=SCENE, truth=truth, estimate=estimate, rest=camera_picture(rng, rest_px, layer),
        pressed=camera_picture(rng, pressed_px, layer),
        score={
            "elastic": {"displacement_error": 0.00312},
            "tracking": {"bias_axes_px": [0.0011, -0.0008], "sd_px": 0.01523, "matched": 0.9953, "gross": 0,
                         "occluded": {"sd_px": None, "count": 0}},
            "force": {"field_error": 0.4321, "total_force_error": 0.01313, "torque_error": None,
                      "centre_error_mm": 0.0642},
            "reasons": {"force.torque_error": "the torque is below the noise",
                        "tracking.occluded": "no marker is hidden"},
        },
        facts={"contact": {"contact_radius_mm": 2.4, "force_n": total, "indentation_mm": 0.2213},
               "calibration": "compliance",
               "shared": ["shape of the body", "number, order and pitch of the markers"],
               "validity": {"mean_strain": 0.11, "warnings": ("the contact radius is 0.48 of the probe's",)}},
        timings={"mesh": 0.41, "solve": 1.9, "contact": 0.31, "picture": 0.19, "tracking": 0.002, "forces": 0.011},
    )  # fmt: skip


@pytest.fixture(scope="module")
def page(full: RunResult) -> str:
    return report(full)


class Checker(HTMLParser):
    """Fails on tags that aren't closed in order; collects tags, attributes and text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        assert len(dict(attrs)) == len(attrs), f"<{tag}> repeats an attribute"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def headings(page: str) -> list[str]:
    return re.findall(r"<h2>(.*?)</h2>", page)


def without(arrays: Truth | Estimate, *prefixes: str) -> dict[str, np.ndarray]:
    return {f.name: getattr(arrays, f.name)[:0] for f in fields(arrays) if f.name.startswith(prefixes)}


def path_arrows(svg: str, style: str) -> np.ndarray:
    """Return (n, 4) tail and tip of the arrows of one class, view units, down."""
    found = re.search(rf'<path class="{style}" d="([^"]*)"', svg)
    assert found
    number = r"(-?[\d.]+)"
    return np.array(re.findall(rf"M{number} {number}L{number} {number}m", found[1]), float)


def test_page_is_whole_and_self_contained(page: str) -> None:
    checker = Checker(page)
    links = [v for _, a in checker.tags for k, v in a.items() if k in {"src", "href", "srcset", "data", "action"}]
    assert links
    assert all(str(v).startswith("data:image/png;base64,") for v in links)
    assert not re.search(r"https?:|file:|url\(|@import|<script|<link", page)
    assert all(a.get("alt") for t, a in checker.tags if t == "img")
    assert all(a.get("role") == "img" and a.get("aria-label") for t, a in checker.tags if t == "svg")
    assert len(page.encode()) < 3e6
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower().replace("resonan", "")


def test_page_is_quick(full: RunResult) -> None:
    """By the functions that it calls, which do not depend on what else the machine does."""
    with Profile() as calls:
        report(full)
    assert sum(entry.callcount for entry in calls.getstats()) < 60_000  # 26,000 the first time


HEADINGS = ["The press", "Pictures", "Marker motion", "Forces", "Errors by stage", "Time", "Facts"]


def test_full_run_has_every_part(page: str) -> None:
    assert headings(page) == HEADINGS
    assert page.count("<img") == 3  # at rest, pressed, their difference
    assert page.count("<svg") == 6  # two layers, tracking errors, two force fields, one profile
    assert '<p class="alarm">The contact radius is 0.48' in page


def test_verdict_says_the_four_figures(full: RunResult) -> None:
    (sentence,) = re.findall(r'<p class="verdict">(.*?)</p>', report(full))
    assert sentence.count(".") == 1 + 4  # one full stop and four decimal points
    for figure in ("0.0152 px", "1.31 %", "0.0642 mm", "43.2 %"):
        assert figure in sentence


def test_what_a_torque_error_is_over_and_both_totals(full: RunResult) -> None:
    """A torque of zero has no size of its own; under bounds the sites don't sum to the total."""
    score = {**full.score, "force": {**full.score["force"], "torque_error": 0.03}}
    page = report(replace(full, score=score))
    assert "the force times 1 mm" in page
    assert ">sum of the sites<" in page
    assert "There are two estimates of the total" in page


def test_table_holds_the_scores_numbers(page: str) -> None:
    table = re.search(r"<h2>Errors by stage</h2>(.*?)</section>", page, re.S)
    assert table
    told = [float(v) for v in re.findall(r'<data value="([^"]*)"', table[1])]
    assert told == [0.00312, 0.0011, -0.0008, 0.01523, 0.9953, 0, 0, 0.4321, 0.01313, 0.0642]
    shown = [re.sub("<[^>]*>", "", c) for c in re.findall(r'<td class="figure">(.*?)</td>', table[1])]
    assert shown == ["0.312 %", "(0.0011, −0.0008) px", "0.0152 px", "99.5 %", "0", "—", "0",
                     "43.2 %", "1.31 %", "—", "0.0642 mm"]  # fmt: skip
    assert "the torque is below the noise" in table[1]
    assert "no marker is hidden" in table[1]


def test_rest_only_and_displacement_only(full: RunResult) -> None:
    truth = full.truth
    assert headings(report(RunResult(scene_toml=""))) == []
    bare = replace(truth, **without(truth, "marker_rest_px", "marker_pressed", "marker_outline", "marker_visible"))
    page = report(RunResult(scene_toml=SCENE, truth=bare))
    assert headings(page) == ["The press", "Marker motion"]
    assert "x (mm)" in page
    assert "column (px)" not in page
    largest = np.linalg.norm(truth.marker_displacement_mm, axis=1).max()
    assert f"The markers move by up to {largest:.3g} mm under 2.04 N." in page
    no_markers = replace(bare, **without(bare, "marker", "surface", "total"))
    assert headings(report(RunResult(scene_toml=SCENE, truth=no_markers, timings={"mesh": 1.0}))) == ["Time"]
    at_rest = replace(bare, marker_displacement_mm=np.zeros_like(bare.marker_displacement_mm), **without(bare, "total"))
    assert "no marker moves" in report(RunResult(scene_toml=SCENE, truth=at_rest))


def test_any_part_may_be_absent(full: RunResult) -> None:
    truth, estimate = full.truth, full.estimate
    tracked_only = replace(estimate, **without(estimate, "site", "force", "total"))
    centres_only = replace(truth, **without(truth, "marker_outline", "marker_visible"))
    all_lost = replace(estimate, marker_shift_px=np.full_like(estimate.marker_shift_px, np.nan))
    for change in (
        {"truth": None}, {"estimate": None}, {"rest": None}, {"pressed": None}, {"rest": None, "pressed": None},
        {"score": None}, {"score": {"force": None, "reasons": {"force": "no sites"}}}, {"facts": {}}, {"timings": {}},
        {"estimate": tracked_only}, {"truth": centres_only}, {"estimate": all_lost}, {"truth": None, "score": {}},
        {"scene_toml": "not [ toml"}, {"facts": {"a": None, "b": {"c_mm": 1.0}, "d": float("nan"), "warnings": []}},
    ):  # fmt: skip
        Checker(report(replace(full, **change)))
    centres = report(replace(full, truth=centres_only))
    assert len(path_arrows(centres, "truth red")) == len(path_arrows(report(full), "truth red")) > 300
    assert "no sites" in report(replace(full, score={"force": None, "reasons": {"force": "no sites"}}))
    assert "Forces" not in headings(report(replace(full, truth=None, estimate=tracked_only)))


def test_texts_of_a_recipe_are_escaped(full: RunResult) -> None:
    truth = full.truth
    evil = "<script>alert(1)</script>"
    renamed = replace(truth, marker_layer=np.array([evil] * 336 + ['"><img src=x>'] * 300))
    page = report(
        replace(
            full, scene_toml=f"title = '{evil}'\n", truth=renamed, facts={evil: evil, "warnings": [evil], "l": [evil]},
            timings={evil: 1.0}, score={evil: {evil: None}, "reasons": {f"{evil}.{evil}": evil}},
        )
    )  # fmt: skip
    checker = Checker(page)
    assert "<script" not in page
    assert {t for t, _ in checker.tags if t == "script"} == set()
    assert sum(t == "img" for t, _ in checker.tags) == 3
    assert evil in "".join(checker.text)


@pytest.mark.parametrize("camera", [True, False])
def test_a_shift_along_y_points_up(full: RunResult, camera: bool) -> None:
    truth = full.truth
    moved = np.tile([0.0, 0.1, 0.0], (len(truth.marker_rest_mm), 1))
    shifted = replace(
        truth, marker_displacement_mm=moved, marker_outline_pressed_px=to_px(truth.marker_rest_mm + moved)
    )
    if not camera:
        shifted = replace(shifted, **without(shifted, "marker_rest_px", "marker_pressed", "marker_outline"))
    x0, y0, x1, y1 = path_arrows(
        report(replace(full, truth=shifted, estimate=None)), "truth red" if camera else "tracked red"
    ).T
    assert np.all(y1 < y0 - 5)
    np.testing.assert_allclose(x0, x1, atol=0.11)
    # the first marker of the layer stands at the lowest x and y: lower left
    assert x0[0] == x0.min()
    assert y0[0] == y0.max()


def test_a_force_along_y_points_up_and_x_right(full: RunResult) -> None:
    estimate = full.estimate
    force = np.zeros_like(estimate.site_mm)
    for axis, sign in ((0, 1), (1, -1)):
        pushed = force.copy()
        pushed[:, axis] = 0.1
        tips = path_arrows(report(replace(full, truth=None, estimate=replace(estimate, force_n=pushed))), "force")
        assert np.all(sign * (tips[:, 2 + axis] - tips[:, axis]) > 5)


def test_arrows_have_the_stated_length(full: RunResult, page: str) -> None:
    truth = full.truth
    said = re.search(r"drawn ([\d.]+) times as long as they are; the longest is ([\d.]+) px", page)
    assert said
    shift = np.hypot(*(truth.marker_outline_pressed_px - truth.marker_outline_rest_px).T)
    assert float(said[2]) == pytest.approx(shift.max(), rel=5e-3)
    drawn = np.concatenate([path_arrows(page, f"truth {c}") for c in ("red", "blue")])
    length = np.hypot(*(drawn[:, 2:] - drawn[:, :2]).T)
    # the markers reach from column 19.5 to 619.5; their margin would leave the picture, whose width is 640
    per_px = (html_page.VIEW - html_page.LEFT - html_page.RIGHT) / 640
    assert length.max() == pytest.approx(float(said[1]) * shift.max() * per_px, abs=0.15)


def test_tracking_errors_are_tracked_minus_true(full: RunResult) -> None:
    truth, estimate = full.truth, full.estimate
    true = truth.marker_outline_pressed_px - truth.marker_outline_rest_px
    off = true + [0.0, 0.1]  # noqa: RUF005  one row too low
    off[5] += 3.0
    page = report(replace(full, estimate=replace(estimate, marker_shift_px=off)))
    said = re.search(r"Tracking error .*? drawn ([\d.]+) times .*? square ([\d.]+) px per axis; 1 above 1 px", page)
    assert said
    assert float(said[2]) == pytest.approx(0.1 / np.sqrt(2), abs=1e-4)
    drawing = re.findall(r"<svg.*?</svg>", page, re.S)[2]
    drawn = path_arrows(drawing, "tracked red")
    assert len(drawn) == 335
    per_px = (html_page.VIEW - html_page.LEFT - html_page.RIGHT) / 640
    np.testing.assert_allclose(drawn[:, 3] - drawn[:, 1], 0.1 * float(said[1]) * per_px, atol=0.11)
    np.testing.assert_allclose(drawn[:, 2], drawn[:, 0], atol=0.11)


def test_lost_markers_are_crossed(page: str) -> None:
    assert "2 not tracked (×)" in page
    assert "1 not tracked (×)" in page
    crosses = re.findall(r'<path class="lost" d="([^"]*)"', page)
    assert [c.count("M") for c in crosses] == [2, 1]


def at_nearest_sites(result: RunResult) -> np.ndarray:
    summed = np.zeros_like(result.estimate.site_mm)
    for point, force in zip(result.truth.surface_mm, result.truth.surface_force_n, strict=True):
        summed[np.argmin(np.linalg.norm(result.estimate.site_mm - point, axis=1))] += force
    return summed


def test_truth_is_summed_into_the_nearest_site(full: RunResult) -> None:
    push = at_nearest_sites(full)[:, 2]
    peak = digits(float(push[np.argmax(np.abs(push))]))
    assert f"Force field, truth: largest force along z {peak} N at" in report(full)


def test_force_colours_share_one_scale(full: RunResult) -> None:
    half = replace(full.estimate, force_n=at_nearest_sites(full) * [1, 1, -0.5])
    maps = re.findall(r"<svg.*?</svg>", report(replace(full, estimate=half)), re.S)[3:5]
    first, second = ([float(o) for o in re.findall(r'fill-opacity="([\d.]+)"', m)] for m in maps)
    assert max(first) == 1.0
    assert max(second) == pytest.approx(0.5, abs=0.006)
    assert 'class="push"' in maps[0]
    assert 'class="pull"' not in maps[0]
    assert 'class="pull"' in maps[1]


def pictures(page: str) -> list[np.ndarray]:
    found = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(text)))) for text in found]


def test_pictures_are_lossless_and_bounded(full: RunResult, page: str) -> None:
    np.testing.assert_array_equal(pictures(page)[0], full.rest)
    noise = np.random.default_rng(1).integers(0, 256, (1000, 1400, 3), dtype=np.uint8)
    page = report(replace(full, rest=noise))
    (uri, *_) = re.findall(r'src="(data:image/png;base64,[^"]*)"', page)
    assert len(uri) < 1.4e6
    assert re.search(r"At rest, 1400 × 1000 px, shown at \d+\.?\d* % of its size", page)


def test_the_difference_of_the_pictures_is_grey_where_nothing_moved(full: RunResult) -> None:
    rest = np.full((40, 60, 3), 30, np.uint8)
    pressed = rest.copy()
    pressed[10:20, 10:20] = 60
    pressed[10:20, 30:40] = 0
    page = report(replace(full, rest=rest, pressed=pressed))
    shown = pictures(page)[2]
    assert shown.shape == (20, 30)
    assert shown[5:10, 5:10].min() > 250
    assert shown[5:10, 15:20].max() < 5
    assert set(shown[12:].ravel()) == {128}
    assert len(pictures(report(replace(full, rest=rest, pressed=rest)))) == 2


def test_dark_pictures_are_shown_brighter_by_a_stated_factor(full: RunResult) -> None:
    dark = np.full((40, 60, 3), 30, np.uint8)
    page = report(replace(full, rest=dark, pressed=dark))
    assert page.count("filter:brightness(8)") == 2
    assert "8 times as bright as it is" in page
    light = np.full((40, 60, 3), 170, np.uint8)
    assert "brightness(" not in report(replace(full, rest=light, pressed=light))


def test_one_layer_is_named_as_the_cause_of_an_uncertain_push(full: RunResult) -> None:
    assert "is uncertain" not in report(full)
    page = report(replace(full, facts={**full.facts, "one_layer": "one layer of dots"}))
    assert page.count("is uncertain: one layer of dots.") == 1
    assert page.count("one layer of dots") == 1


def test_ticks_are_round_and_inside() -> None:
    svg = html_page.Axes(left=-0.5, right=639.5, bottom=479.5, top=-0.5, height=300).drawing("", "x", "y", "")
    across, up = (re.findall(rf'text-anchor="{a}">([\d.-]+)<', svg) for a in ("middle", "end"))
    assert across == ["0", "100", "200", "300", "400", "500", "600"]
    assert up == ["0", "100", "200", "300", "400"]
    svg = html_page.Axes(left=0, right=1, bottom=-0.013, top=0.021, height=300).drawing("", "x", "y", "")
    assert re.findall(r'text-anchor="end">([\d.-]+)<', svg) == ["-0.01", "0", "0.01", "0.02"]


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 500])
def test_a_browser_shows_it(page: str, tmp_path: Path, width: int) -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert browser, "this check needs Chromium or Chrome on PATH"
    (tmp_path / "report.html").write_text(page)
    subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={tmp_path / 'shot.png'}",
         f"--window-size={width},3000", (tmp_path / "report.html").as_uri()],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    with Image.open(tmp_path / "shot.png") as image:
        shot = np.asarray(image.convert("RGB")).astype(int)
    assert shot.shape[1] == width
    paper = shot[2, 2]
    inked = np.abs(shot - paper).sum(axis=2) > 60
    assert 0.02 < inked.mean() < 0.8
    # text, pictures, drawings: ink in every tenth of the first 1500 rows, none beyond the right margin
    assert all(part.any() for part in np.array_split(inked[:1500], 10))
    assert not inked[:, -8:].any()


@pytest.mark.parametrize(("friction", "words"), [(0.5, "blue sticks (25 % of the area)"), (0.0, "all of them slide")])
def test_what_is_under_the_probe_is_drawn(full: RunResult, friction: float, words: str) -> None:
    places = grid(4, 4, 0.5, 0.0)[:, :2]
    away = np.hypot(*places.T)
    under = RunResult.Touch(
        probe="sphere", place_mm=places, half_mm=np.full((16, 2), 0.25), pressure_mpa=1.5 - away,
        shear_mpa=np.tile([0.1, 0.0], (16, 1)), slip=(away > 0.5) | (friction == 0), friction=friction,
        expected=np.column_stack([np.linspace(0, 1.2, 20), np.linspace(1.5, 0, 20)]), expected_name="Hertz",
    )  # fmt: skip
    page = report(replace(full, touches=(under,)))
    Checker(page)
    assert "Under the probe" in headings(page)
    assert words in page
    assert "Hertz, same force" in page
    section = page[page.index("Under the probe") : page.index("<h2>Forces")]
    assert section.count("<rect") == 16
    assert section.count('class="dot blue"') == (4 if friction else 0)


def test_the_force_is_drawn_against_time_where_a_press_takes_any(full: RunResult) -> None:
    assert "force along z (N)" not in page_part(report(full), "The press")
    course = {"time_s": [0.0, 1.0, 3.0], "z_n": [0.0, 0.4, 0.3]}
    drawn = page_part(report(replace(full, facts=full.facts | {"course": course})), "The press")
    assert "time (s)" in drawn
    assert "at most 0.4 N" in drawn


def test_ratios_are_in_percent_and_what_round_off_leaves_of_one_is_nothing(full: RunResult) -> None:
    ratios = {"contact_over_probe_radius": 0.5, "largest_strain": 0.02, "contact_residual": 1e-9}
    score = {
        "elastic": {"force_error": 6.7e-16, "indentation_error": 1e-4, **ratios},
        "force": {"field_stated": 0.3, "field_error_normal": 0.25, "total_force_error_axes": [0.01, -0.02, 0.3]},
    }
    facts = {"contact": {"error": {"force": 0.01, "patches": {"force": 0.02, "indentation": 0.03}}}}
    page = report(replace(full, score=score, facts=facts))
    said = re.sub("<[^>]*>", "", page_part(page, "Facts"))
    assert "error (force: 1 %, patches (force: 2 %, indentation: 3 %))" in said
    shown = page_part(page, "Errors by stage")
    cells = re.findall(r'<td class="figure">(.*?)</td>', shown)
    assert all(cell.endswith("%") or cell.endswith(" %</data>") for cell in cells), "ratios have one unit"
    assert [re.sub("<[^>]*>", "", cell) for cell in cells][-2:] == ["25 %", "(1, −2, 30) %"]
    assert ">0 %<" in shown
    assert ">0.01 %<" in shown


def page_part(page: str, title: str) -> str:
    """Return what stands under a heading."""
    return page.split(f">{title}<")[1].split("<h2")[0]


def test_long_numbers_beside_a_drawing_do_not_touch_the_axis_name() -> None:
    def room(top: float) -> tuple[float, float]:
        """Return where the drawing begins and where the axis's name stands, in view units."""
        svg = html_page.Axes(left=0, right=1, bottom=0, top=top, height=100).drawing("", "x", "y", "")
        (begin,), (name,) = re.findall(r'viewBox="(-?\d+) ', svg), re.findall(r'x="(-?\d+)"[^>]*rotate', svg)
        return float(begin), float(name)

    assert room(10.0) == (0.0, 14.0)
    for top in (1.0, 0.01):  # ticks such as 0.2, which touch it on a phone, and 0.002
        begin, name = room(top)
        assert name - begin == 14.0
        assert name < 14.0
