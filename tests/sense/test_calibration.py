import dataclasses
import json

import numpy as np
import pytest
from half_space_sensor import cell_compliance, finger_sensor

from twin.errors import InputError
from twin.parts.camera import Camera
from twin.parts.scene import Sites
from twin.sense.calibration import SINCE, Calibration, fill_between, from_compliance, from_presses, read_calibration

MARKERS, SEEN, CALIBRATION = finger_sensor()
CAMERA = Camera(focal_px=300, pupil_mm=(0, 0, 14))


def test_round_trip_on_disk(tmp_path):
    told = dataclasses.replace(
        CALIBRATION, noise_px=0.04, diameter_px=15.0, method="sato", provenance=json.dumps({"digest": "ab12"}),
        compliance=np.ones((183, 75)), marker_mm=MARKERS, condition=12.0, left_out=np.array([0.1, 0.2]),
        camera=json.dumps({"camera": CAMERA.model_dump(mode="json"), "body_index": 1.41, "base_z_mm": 10.0}),
    )  # fmt: skip
    path = tmp_path / "finger.npz"
    told.write(path)
    read = read_calibration(path)
    for field in dataclasses.fields(Calibration):
        assert np.array_equal(getattr(read, field.name), getattr(told, field.name)), field.name
    assert read.provenance == told.provenance
    assert list(read.layout) == ["red", "blue"]
    assert read.layout["blue"].shape == (36, 2)
    assert [file.name for file in tmp_path.iterdir()] == ["finger.npz"]
    with pytest.raises(ValueError, match="read-only"):
        read.transfer[0] = 0


@pytest.mark.parametrize("version", [1, 2])
def test_files_of_earlier_versions_are_read(tmp_path, version):
    path = tmp_path / "old.npz"
    arrays = {f.name: np.asarray(getattr(CALIBRATION, f.name)) for f in dataclasses.fields(Calibration)}
    then = {key: value for key, value in arrays.items() if SINCE.get(key, 1) <= version}
    np.savez(path, version=np.array(version), **then)
    read = read_calibration(path)
    assert np.array_equal(read.transfer, CALIBRATION.transfer)
    assert not read.has_camera
    assert np.isnan(read.condition)


def test_how_the_rubber_relaxes_is_read(tmp_path):
    assert CALIBRATION.relaxation is None
    told = dataclasses.replace(CALIBRATION, provenance=json.dumps({"relaxation": [[0.1, 0.3], [0.2, 5]]}))
    told.write(tmp_path / "finger.npz")
    read = read_calibration(tmp_path / "finger.npz").relaxation
    assert read is not None
    assert read.share.tolist() == [0.1, 0.2]
    assert read.time_s.tolist() == [0.3, 5]


@pytest.mark.parametrize("terms", [None, 3, "ab", [1, 2], [[0.5, 1], [0.5, 2]], [[-0.1, 1]], [[0.1, 0]], [[0.1]]])
def test_terms_of_no_rubber_are_refused(terms):
    with pytest.raises(InputError, match=r"calibration: relaxation = .* must be pairs of a share"):
        dataclasses.replace(CALIBRATION, provenance=json.dumps({"relaxation": terms}))


@pytest.mark.parametrize("name", ["scale_error", "mesh_error", "print_error", "read_error"])
@pytest.mark.parametrize("share", ["ab", None, -0.1, 1.0, float("nan")])
def test_a_share_beyond_the_whole_is_refused(name, share):
    with pytest.raises(InputError, match=rf"calibration: {name} = .* must lie from 0 to 1"):
        dataclasses.replace(
            CALIBRATION, provenance=json.dumps({name: [0, 0, share] if name == "read_error" else share})
        )


@pytest.mark.parametrize("size", [640, [640], [640, "480"], [0, 480], {"width": 640}])
def test_a_picture_size_that_is_none_is_refused_when_it_is_read(size):
    """An unknown one is none to compare with."""
    with pytest.raises(InputError, match=r"calibration: picture_px = .* must be a width and a height"):
        dataclasses.replace(CALIBRATION, provenance=json.dumps({"picture_px": size}))
    unknown = dataclasses.replace(CALIBRATION, provenance=json.dumps({"picture_px": None}))
    unknown.require_size(np.zeros((4, 5, 3), np.uint8))


def test_damaged_files(tmp_path):
    path = tmp_path / "c.npz"
    with pytest.raises(InputError, match="does not exist"):
        read_calibration(path)
    CALIBRATION.write(path)
    whole = path.read_bytes()
    for damaged in (b"", b"not a file", whole[: len(whole) // 2], whole[:200] + bytes(200) + whole[400:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError):
            read_calibration(path)
    arrays = {f.name: np.asarray(getattr(CALIBRATION, f.name)) for f in dataclasses.fields(Calibration)}
    for change, words in (
        ({"version": np.array(99)}, "version"),
        ({"transfer": arrays["transfer"][:-1]}, "transfer"),
        ({"site_mm": arrays["site_mm"] * np.nan}, "site_mm"),
        ({"grid": np.array([3, 3])}, "grid"),
        ({"provenance": np.array("{")}, "provenance"),
        ({"layer": np.arange(61)}, "layer"),
        ({"method": np.array(["a", "b"])}, "single"),
        ({"compliance": np.ones((183, 75)), "marker_mm": MARKERS}, "camera"),
        ({"compliance": np.ones((3, 3))}, "compliance"),
        ({"site_mm": np.array([{"no": "pickle"}] * 25, object)}, "pickle"),
    ):
        np.savez(path, **({"version": np.array(2)} | arrays | change))
        with pytest.raises(InputError, match=words):
            read_calibration(path)
    np.savez(path, transfer=arrays["transfer"])
    with pytest.raises(InputError, match="lacks"):
        read_calibration(path)


def test_compliance_through_the_camera():
    """Depth motion counts: du = scale (dX + X dz / (Zc - z)) (flat paper, section 2.5)."""
    motion = np.array([0.1, -0.2, 0.3])
    transfer = from_compliance(np.tile(motion[:, None], (len(SEEN), 3)).reshape(-1, 3), SEEN)
    near = 14.0 - MARKERS[:, 2]
    scale = 30.0 * 14.0 / near
    expected = scale * (0.1 + MARKERS[:, 0] * 0.3 / near)
    assert transfer.reshape(-1, 2, 3)[:, 0] == pytest.approx(np.tile(expected[:, None], 3))
    rows = scale * -(-0.2 + MARKERS[:, 1] * 0.3 / near)
    assert transfer.reshape(-1, 2, 3)[:, 1] == pytest.approx(np.tile(rows[:, None], 3))
    with pytest.raises(InputError, match="compliance"):
        from_compliance(np.zeros((5, 6)), SEEN)


def presses(seed=1):
    """Presses along z, then along x and y with z kept, and mixed by a probe that is not quite straight."""
    random = np.random.default_rng(seed)
    straight = np.array([[1.0, 0.0, 0.05], [0.05, 1.0, 0.0], [0.9, 1.0, 1.0]])
    forces = straight + random.normal(0, 0.05, (25, 3, 3))
    transfer = from_compliance(cell_compliance(MARKERS, CALIBRATION.site_mm, 2.5, 2), SEEN)
    by_site = transfer.reshape(-1, 25, 3)
    return forces, np.einsum("rkm,kmn->knr", by_site, forces), transfer


def test_presses_give_back_the_transfer_matrix():
    """A marker that was lost in one press of a site is not known there."""
    forces, shifts, transfer = presses()
    assert from_presses(forces, shifts) == pytest.approx(transfer, abs=1e-10)
    shifts[3, 1, 10:12] = np.nan
    alone = from_presses(forces, shifts)
    assert np.isnan(alone[10:12, 9:12]).all()
    assert np.isnan(alone).sum() == 6
    assert alone[np.isfinite(alone)] == pytest.approx(transfer[np.isfinite(alone)], abs=1e-10)


def test_presses_must_span_three_directions():
    forces, shifts, _ = presses()
    forces[4, :, 2] = forces[4, :, 1]
    with pytest.raises(InputError, match="site 4"):
        from_presses(forces, shifts)
    with pytest.raises(InputError, match="forces must be"):
        from_presses(forces[:, :2], shifts)


def test_the_nominal_response_is_corrected_between_the_presses():
    """What is measured stays where a site was pressed; a constant error of the nominal design is mended everywhere;
    rows that were not measured stay unmeasured."""
    presses, sites = Sites(columns=3, rows=4, pitch_mm=2.0), Sites(columns=5, rows=7, pitch_mm=1.0)
    there, here = presses.chart(), sites.chart()

    def response(chart):
        """A sharply peaked response of five readings to forces at places."""
        peak = 1 / (0.3 + (chart[:, 0] - np.linspace(-2, 2, 5)[:, None]) ** 2 + chart[:, 1] ** 2)
        return peak[:, :, None] * np.array([1.0, -0.5, 2.0])

    def filled(measured):
        parts = (part.reshape(5, -1) for part in (measured, response(there), response(here)))
        return fill_between(*parts, presses.axes(), here).reshape(5, -1, 3)

    offset = np.arange(5)[:, None, None] * 0.01
    assert filled(response(there) + offset) == pytest.approx(response(here) + offset, abs=1e-12)
    measured = response(there) * (1 + 0.1 * there[:, :1])
    site = np.linalg.norm(here[None] - there[:, None], axis=2).argmin(axis=1)
    assert filled(measured)[:, site] == pytest.approx(measured, abs=1e-12)
    measured[2] = np.nan
    assert np.isnan(filled(measured)).all(axis=(1, 2)).tolist() == [False, False, True, False, False]
    assert np.isnan(filled(measured)).sum() == 3 * len(here)
    with pytest.raises(InputError, match="same shape"):
        fill_between(np.zeros((4, 9)), np.zeros((4, 36)), np.zeros((4, 9)), presses.axes(), here)
