"""A small environment for the tests of learning: a point that should be moved to a goal."""

from typing import Any

import gymnasium as gym
import numpy as np

from mjris.config import Config, from_dict


class ToyEnv(gym.Env):
    """The observation is the way to the goal [2]; the action moves the point; the reward is best at the goal."""

    def __init__(self, config: Config, cell: int = 0):
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._slots = config.task.slots
        self._cell = cell
        self._rng = np.random.default_rng((config.named_seed, cell))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):  # noqa: ARG002
        if seed is not None:
            self._rng = np.random.default_rng((seed, self._cell))
        self._slot = 0
        self._way = self._rng.uniform(-1.0, 1.0, 2)
        return self._way.astype(np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self._slot += 1
        self._way = np.clip(self._way - 0.5 * action, -2.0, 2.0)
        distance = float(np.linalg.norm(self._way))
        info = {
            "sum_rate_bps": 1e6 * np.exp(-distance),
            "bare_sum_rate_bps": 1e6 * np.exp(-2 * distance),
            "qos_met": np.array([True, distance < 0.5]),
            "collisions": int(distance > 1.5),
            "clearance_m": distance,
        }
        return self._way.astype(np.float32), 1.0 - distance, False, self._slot == self._slots, info


class EndingToyEnv(ToyEnv):
    """Its episodes end for good and not by a time limit."""

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        observation, reward, _, over, info = super().step(action)
        return observation, reward, over, False, info


class BrokenToyEnv(ToyEnv):
    """Cell 1 fails in its second episode."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        self._resets = getattr(self, "_resets", 0) + 1
        if self._cell == 1 and self._resets == 2:
            raise ArithmeticError("the floor gave way")
        return super().reset(seed=seed, options=options)


def toy_config(*, seed: int = 0, agent: dict[str, Any] | None = None, **federation: Any) -> Config:
    """Small networks, episodes of 10 slots; two cells in this process, rounds of 2, 2 and 1 episodes."""
    small = {
        "network": "mlp",
        "hidden": (32,),
        "learning_rate": 1e-3,
        "batch_size": 32,
        "discount": 0.9,
        "target_rate": 0.02,
        "buffer_size": 5000,
        "warmup_slots": 10,
    }
    return from_dict(
        {
            "radio": {"num_antennas": 2, "panel_rows": 2, "panel_cols": 2},
            "task": {"slots": 10},
            "agent": small | (agent or {}),
            "federation": {"num_cells": 2, "episodes": 5, "round_episodes": 2, "workers": 1} | federation,
            "seed": seed,
        }
    )
