"""The Gymnasium environment by Gymnasium's own checker; ROS 2 messages by its definitions and serialisation."""

import warnings
from dataclasses import MISSING, fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import twin
from twin.errors import InputError
from twin.parts.camera import Camera
from twin.study.environment import Observation
from twin.study.live import QUICK
from twin.study.ros import ros_messages


@pytest.mark.slow
def test_it_is_an_environment_that_feels_what_is_done() -> None:
    check_env = pytest.importorskip("gymnasium.utils.env_checker").check_env
    from twin.study.gym import TactileEnv

    scene = twin.load_scene("kamiyama_pillar", QUICK | {"press.friction": 1.2})
    env = TactileEnv(scene, reward=lambda seen: float(seen.total_force_n[2]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its advice on unbounded spaces and on rendering
        check_env(env, skip_render_check=True)
    env.reset()
    seen, reward, terminated, truncated, info = env.step(np.array([2.0, 1.0, 2.0, 0.2, 0.0, 0.0]))
    assert (terminated, truncated) == (False, False)
    assert seen["total_force_n"] == pytest.approx([0.2, 0.0, 2.0], abs=0.12)
    assert reward == pytest.approx(2.0, abs=0.12)
    assert info["true_total_force_n"] == pytest.approx([0.2, 0.0, 2.0], abs=1e-5)
    slipping = env.action_space.high.copy()
    slipping[2] = 0.1
    _, reward, _, truncated, info = env.step(slipping)
    assert (reward, truncated) == (0.0, False)
    assert "sideways" in info["problem"] or "edge" in info["problem"] or "miss" in info["problem"], info["problem"]


@pytest.mark.slow
def test_a_frictionless_probe_is_not_pushed_sideways() -> None:
    pytest.importorskip("gymnasium")
    from twin.study.gym import TactileEnv

    env = TactileEnv(twin.load_scene("kamiyama_pillar", QUICK))
    assert not env.action_space.high[3:].any()
    env.reset()
    _, reward, _, _, info = env.step(np.array([0.0, 0.0, 2.0, 0.2, 0.0, 0.0]))
    assert reward == 0.0
    assert "frictionless" in info["problem"]


CAMERA = Camera(width_px=4, height_px=3, focal_px=100, aspect=1.1, principal_px=(1.0, 2.0), pupil_mm=(0, 0, 100))


@pytest.fixture(scope="module")
def seen() -> Observation:
    site = np.array([[1.0, 2.0, 0.0], [3.0, 4.0, 0.5]])
    truth: Any = SimpleNamespace(
        marker_displacement_mm=np.zeros((1, 3)), marker_shift_px=np.zeros((1, 2)), displacement_error=0.0,
        force_n=np.zeros((2, 3)), total_force_n=np.array([0.0, 0.0, 2.0]), total_torque_nmm=np.zeros(3), state=None,
    )  # fmt: skip
    return Observation(
        picture=np.arange(36, dtype=np.uint8).reshape(3, 4, 3), marker_shift_px=np.zeros((1, 2)), site_mm=site,
        force_n=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]), total_force_n=np.array([0.5, 0.7, 0.9]),
        total_torque_nmm=np.array([10.0, 20.0, -30.0]), sd_force_n=np.zeros((2, 3)), sd_total_n=np.zeros(3),
        sd_torque_nmm=np.zeros(3), truth=truth, error={}, exposure=1,
    )  # fmt: skip


def test_units_are_those_of_ros(seen: Observation) -> None:
    messages = ros_messages(seen, CAMERA, stamp_ns=3_000_000_005, frame_id="tip")
    _, wrench = messages["wrench"]
    assert wrench["header"] == {"stamp": {"sec": 3, "nanosec": 5}, "frame_id": "tip"}
    assert wrench["wrench"]["force"] == {"x": 0.5, "y": 0.7, "z": 0.9}
    assert wrench["wrench"]["torque"] == pytest.approx({"x": 0.01, "y": 0.02, "z": -0.03})
    assert messages["wrench_true"][1]["wrench"]["force"]["z"] == 2.0
    _, image = messages["image"]
    assert image["header"]["frame_id"] == "tip_optical"
    assert image["data"].reshape(3, 4, 3)[2, 1, 0] == seen.picture[2, 1, 0]
    _, cloud = messages["force_field"]
    rows = np.frombuffer(cloud["data"].tobytes(), "<f4").reshape(2, 6)
    np.testing.assert_allclose(rows[1], [0.003, 0.004, 0.0005, 0.4, 0.5, 0.6], rtol=1e-6)


def built(types: dict[str, Any], kind: str, table: dict[str, Any]) -> Any:
    """Return a message of its definition; every field given, none too many."""
    own = types[kind]
    wanted = {field.name for field in fields(own) if field.default is MISSING}  # the others are constants
    assert set(table) == wanted, kind
    values = {}
    for name, value in table.items():
        inner = {
            "header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time",
            "wrench": "geometry_msgs/msg/Wrench",
            "force": "geometry_msgs/msg/Vector3", "torque": "geometry_msgs/msg/Vector3",
            "roi": "sensor_msgs/msg/RegionOfInterest", "fields": "sensor_msgs/msg/PointField",
        }.get(name)  # fmt: skip
        if isinstance(value, dict):
            value = built(types, inner, value)
        elif isinstance(value, list):
            value = [built(types, inner, part) for part in value]
        values[name] = value
    return own(**values)


def test_they_are_ros_messages_and_survive_its_serialisation(seen: Observation) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for kind, table in ros_messages(seen, CAMERA, stamp_ns=7).values():
        message = built(store.types, kind, table)
        back = store.deserialize_cdr(store.serialize_cdr(message, kind), kind)
        assert back.header.frame_id == table["header"]["frame_id"]
        for name in ("data", "d", "k", "p"):
            if name in table:
                np.testing.assert_array_equal(np.asarray(getattr(back, name)), table[name])
        if kind.endswith("WrenchStamped"):
            assert back.wrench.force.x == table["wrench"]["force"]["x"]


def test_a_lens_comes_under_ros_s_own_names(seen: Observation) -> None:
    def camera_info(camera: Camera) -> dict[str, Any]:
        return ros_messages(seen, camera)["camera_info"][1]

    sato = twin.load_scene("sato_press").camera
    assert camera_info(sato)["distortion_model"] == "equidistant"
    bent = camera_info(CAMERA.model_copy(update={"distortion": (0.1, 0.2, 0.01, 0.02)}))
    assert (bent["distortion_model"], bent["d"].tolist()) == ("plumb_bob", [0.1, 0.2, 0.01, 0.02, 0.0])
    assert bent["k"].tolist() == pytest.approx([100, 0, 1, 0, 110, 2, 0, 0, 1])
    assert len(camera_info(CAMERA.model_copy(update={"distortion": (0.0,) * 8}))["d"]) == 8


def test_what_ros_has_no_word_for_is_refused(seen: Observation) -> None:
    with pytest.raises(InputError, match="stamp_ns = -1"):
        ros_messages(seen, CAMERA, stamp_ns=-1)
    with pytest.raises(InputError, match="lens"):
        ros_messages(seen, CAMERA.model_copy(update={"lens": "stereographic"}))
