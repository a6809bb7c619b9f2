"""The Gymnasium environment of one cell, thin over the task."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, preset
from mjris.envs.worker_pool import info_columns, infos_of
from mjris.simulation.checks import checked
from mjris.simulation.streams import CellId, seeded
from mjris.simulation.task import Task


class OfficeEnv(gym.Env[NDArray[Any], NDArray[Any]]):
    """One cell; an episode is `task.slots` slots and ends as `task.end` says: by termination or by truncation.

    All randomness follows from the seed of `reset` (at first from the config's, or a fresh one) and the cell's number:
    cells with the same seed share what cells share, and differ in the rest.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, config: Config | None = None, cell: int = 0):
        self.config = config or preset("office")
        self.task = Task(self.config, [CellId(seeded(self.config).named_seed, cell)])
        self.observation_space, self.action_space = spaces(self.task.observation_size, self.task.action_size)
        self._slot = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode: observation [D] and an empty info."""
        super().reset(seed=seed, options=options)
        self._slot = 0
        return self.task.reset(seed)[0], {}

    def step(self, action: NDArray[Any]) -> tuple[NDArray[Any], float, bool, bool, dict[str, Any]]:
        """Play one slot with an action [A]. Raises `ValueError` for any other shape and for numbers not finite."""
        outcome = self.task.step(checked("action", action, (self.task.action_size,))[None])
        self._slot += 1
        over, terminal = self._slot >= self.config.task.slots, self.config.task.end == "terminal"
        return (
            outcome.observation[0],
            float(outcome.reward[0]),
            over and terminal,
            over and not terminal,
            infos_of(info_columns(outcome.slot))[0],
        )


def spaces(observation_size: int, action_size: int) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Observation and action space of one cell."""
    observation = gym.spaces.Box(-np.inf, np.inf, (observation_size,), np.float32)
    return observation, gym.spaces.Box(-1.0, 1.0, (action_size,), np.float32)
