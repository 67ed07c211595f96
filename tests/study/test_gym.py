"""The Gymnasium environment passes Gymnasium's own checker."""

import warnings

import numpy as np
import pytest

import twin
from twin.study.live import QUICK

pytest.importorskip("gymnasium")


@pytest.mark.slow
def test_it_is_an_environment_that_feels_what_is_done() -> None:
    from gymnasium.utils.env_checker import check_env

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
    from twin.study.gym import TactileEnv

    env = TactileEnv(twin.load_scene("kamiyama_pillar", QUICK))
    assert not env.action_space.high[3:].any()
    env.reset()
    _, reward, _, _, info = env.step(np.array([0.0, 0.0, 2.0, 0.2, 0.0, 0.0]))
    assert reward == 0.0
    assert "frictionless" in info["problem"]
