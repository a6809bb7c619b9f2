"""The SB3 VecEnv of many cells, thin over the task."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from mjris.config import Config, ConfigError, preset
from mjris.envs.gym_env import spaces
from mjris.envs.worker_pool import SpreadTask, infos_of
from mjris.simulation.checks import checked
from mjris.simulation.streams import CellId, first_cells


class OfficeVecEnv(VecEnv):
    """E cells stepped together, with the same numbers as E single environments of the same seed.

    `config` is the office preset by default. A number of cells stands for the first ones of a run with the config's
    seed; see `Simulator`. They are spread over `processes`, of which this is one. Raises `ConfigError` for fewer cells
    than processes.
    """

    def __init__(self, cells: int | Sequence[CellId], config: Config | None = None, processes: int = 1):
        self.config = config or preset("office")
        cells = first_cells(self.config, cells) if isinstance(cells, int) else cells
        if not 1 <= processes <= len(cells):
            raise ConfigError(f"processes: {processes} is not allowed: there are {len(cells)} cells")
        self._task = SpreadTask(self.config, cells, processes)
        self._slot = 0
        self._actions = np.zeros((len(cells), self._task.action_size))
        self._new_seeds: Sequence[int] | None = None
        self.render_mode = None
        super().__init__(len(cells), *spaces(self._task.observation_size, self._task.action_size))

    def seed(self, seed: int | Sequence[int] | None = None) -> Sequence[int | None]:
        """Seed the streams of all cells from the next reset on, with one seed for all or one for each.

        Cells with the same seed tell themselves apart by their numbers.
        """
        self._new_seeds = [seed] * self.num_envs if isinstance(seed, int) else seed
        return self._new_seeds or [None] * self.num_envs

    def reset(self) -> VecEnvObs:
        """Begin an episode in every cell: observations [E, D]."""
        self._slot = 0
        observation = self._task.reset(self._new_seeds)
        self._new_seeds = None
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions [E, A] of the next slot. Raises `ValueError` for other shapes and numbers not finite."""
        self._actions = checked("action", actions, (self.num_envs, self._task.action_size))

    def step_wait(self) -> VecEnvStepReturn:
        """Play one slot; all cells end their episodes together, and begin the next at once."""
        parts = self._task.step(self._actions)
        self._slot += 1
        done = self._slot >= self.config.task.slots
        infos = [info for part in parts for info in infos_of(part.columns)]
        observation = np.concatenate([part.observation for part in parts])
        reward = np.concatenate([part.reward for part in parts])
        if done:
            for info, last in zip(infos, observation, strict=True):
                info["terminal_observation"] = last
                info["TimeLimit.truncated"] = self.config.task.end == "time_limit"
            observation = self.reset()
        return observation, reward.astype(np.float32), np.full(self.num_envs, done), infos

    def close(self) -> None:
        """End the worker processes."""
        self._task.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute, once for each of the cells asked for."""
        return [getattr(self, attr_name)] * len(self._get_indices_list(indices))

    # Stable-Baselines3 asks for what follows; cells of one simulator have no attributes or methods of their own.
    # ruff: noqa: ARG002
    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raises `AttributeError`: cells have no attributes of their own."""
        raise AttributeError(f"{attr_name}: the cells of an OfficeVecEnv are configured together, by its config")

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raises `AttributeError`: cells have no methods of their own."""
        raise AttributeError(f"{method_name}: the cells of an OfficeVecEnv have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """False for every cell."""
        return [False] * len(self._get_indices_list(indices))

    def _get_indices_list(self, indices: VecEnvIndices) -> list[int]:
        return list(self._get_indices(indices))


def make_vec(num_cells: int, config: Config | None = None, processes: int = 1) -> OfficeVecEnv:
    """E cells as one SB3 VecEnv, stepped in this process and others; the config is the office preset by default."""
    return OfficeVecEnv(num_cells, config, processes)
