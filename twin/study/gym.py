"""The sensor as a Gymnasium environment (`pip install gymnasium`).

An action moves the probe as the hand does on the live page (`twin.study.live`). Only this module
imports gymnasium; `twin.Environment` works without it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from twin.arrays import Floats
from twin.errors import InputError, MissingCapability, TwinError
from twin.parts.scene import Scene
from twin.study.environment import Observation
from twin.study.live import Hand, LivePress

try:
    import gymnasium
except ImportError:
    raise MissingCapability("gymnasium is not installed: pip install gymnasium") from None

ACTION = ("x_mm", "y_mm", "push_n", "side_x", "side_y", "twist")
"""What an action holds, in order; the last three are forces on a flat body, motions on a curved
one."""


class TactileEnv(gymnasium.Env[dict[str, np.ndarray], Floats]):  # type: ignore[misc]
    """Press the scene's probe, see and feel what the sensor does.

    Parameters
    ----------
    scene
        With camera, reconstruction and a press.
    reward
        What an observation is worth; 0 for every one if not given.

    Notes
    -----
    An action is `ACTION`, within the ranges of the live page's sliders; on a scene whose press has
    no friction the last three can only be 0. Observations are the
    ``picture``, the ``marker_shift_px`` (0 where lost), the recovered ``force_n`` at the sites and
    the ``total_force_n``; ``info`` holds the truth of both forces and the ``error``. A press
    without equilibrium (one whose side force slips) changes nothing and is worth 0;
    ``info["problem"]`` has the reason. Noise follows the scene's seed and the number of the step
    since the reset, whatever the seed of `reset`.
    """

    def __init__(self, scene: Scene, reward: Callable[[Observation], float] | None = None) -> None:
        self._live = LivePress(scene)
        self._reward = reward
        self._last = self._live.rest
        ranges = self._live.facts()["range"]
        low, high = np.array([ranges[key] for key in ACTION]).T
        if self._live.moved.friction == 0.0:
            low[3:] = 0.0
            high[3:] = 0.0
        spaces = gymnasium.spaces
        self.action_space = spaces.Box(low, high, dtype=np.float64)
        seen = _arrays(self._last)
        self.observation_space = spaces.Dict(
            {
                key: spaces.Box(0, np.iinfo(value.dtype).max, value.shape, value.dtype.type)
                if key == "picture"
                else spaces.Box(-np.inf, np.inf, value.shape, np.float64)
                for key, value in seen.items()
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Lift the probe; see `gymnasium.Env.reset`."""
        super().reset(seed=seed, options=options)
        self._last = self._live.environment.reset()
        return _arrays(self._last), _told(self._last)

    def step(
        self, action: Floats
    ) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Press; see `gymnasium.Env.step`."""
        given = np.asarray(action)
        if given.shape != (len(ACTION),) or given.dtype.kind not in "fiu":
            raise InputError(
                f"the action must be {len(ACTION)} numbers ({', '.join(ACTION)}), got "
                f"{action!r:.60}"
            )
        begin = self._live.start()
        question = {**begin.question(), **dict(zip(ACTION, map(float, given), strict=True))}
        worth, more = 0.0, {}
        try:
            press = Hand.of(question, by_motion=begin.by_motion).press(self._live.moved)
            self._last = self._live.environment.step(press)
        except TwinError as problem:
            more = {"problem": str(problem)}
        else:
            worth = 0.0 if self._reward is None else float(self._reward(self._last))
        return _arrays(self._last), worth, False, False, _told(self._last) | more


def _arrays(seen: Observation) -> dict[str, np.ndarray]:
    return {
        "picture": seen.picture.copy(),
        "marker_shift_px": np.nan_to_num(seen.marker_shift_px),
        "force_n": np.array(seen.force_n),
        "total_force_n": np.array(seen.total_force_n),
    }


def _told(seen: Observation) -> dict[str, Any]:
    """Return what a learner must not see."""
    truth = seen.truth
    return {
        "true_force_n": np.array(truth.force_n),
        "true_total_force_n": np.array(truth.total_force_n),
        "error": dict(seen.error),
    }
