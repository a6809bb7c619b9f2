"""The replay memories of agents that learn in lockstep."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from stable_baselines3.common.buffers import ReplayBuffer
from torch import Tensor

FloatArray = NDArray[np.floating]


class Batch(NamedTuple):
    """Minibatches of A agents, B transitions each; no episode of mjris ends but by truncation."""

    observations: Tensor
    """[A, B, D]"""
    actions: Tensor
    """[A, B, n]"""
    rewards: Tensor
    """[A, B, 1]"""
    next_observations: Tensor
    """[A, B, D]"""


class ReplayMemory:
    """The last transitions of every agent, one ring of float32 rows [A, capacity, ...].

    The ring is as long as the agents' own buffers, or as the run where that is shorter.
    """

    def __init__(self, agents: Sequence[DDPG], run_slots: int, device: str):
        first = agents[0]
        observations, actions = (
            int(np.prod(space.shape or ())) for space in (first.observation_space, first.action_space)
        )
        self.capacity = min(first.buffer_size, run_slots)
        self._widths = [observations, actions, 1, observations]
        rows = np.zeros((len(agents), self.capacity, sum(self._widths)), np.float32)
        self._rows = torch.from_numpy(rows).to(device)
        self._ends = np.zeros(self.capacity, np.bool_)
        self._offsets = torch.arange(len(agents), device=device)[:, None] * self.capacity
        self._added = 0

    def add(
        self, observations: FloatArray, actions: FloatArray, rewards: FloatArray, following: FloatArray, last: bool
    ) -> None:
        """Remember one slot of every agent: [A, D], [A, n], [A], [A, D]; `last` is the end of an episode."""
        place = self._added % self.capacity
        row = np.concatenate([observations, actions, rewards[:, None], following], 1)
        self._rows[:, place] = torch.from_numpy(row).to(self._rows.device)
        self._ends[place] = last
        self._added += 1

    def batch(self, places: NDArray[np.int64]) -> Batch:
        """The transitions at `places` [A, B] of each agent's ring."""
        flat = torch.from_numpy(places).to(self._rows.device) + self._offsets
        picked = self._rows.flatten(0, 1).index_select(0, flat.flatten())
        return Batch(*picked.view(*places.shape, -1).split(self._widths, -1))

    def store(self, index: int, buffer: ReplayBuffer) -> None:
        """Write what an agent remembers to an empty SB3 buffer."""
        filled = min(self._added, self.capacity)
        parts = self._rows[index, :filled].cpu().split(self._widths, -1)
        names = ("observations", "actions", "rewards", "next_observations")
        for name, part in zip(names, parts, strict=True):
            getattr(buffer, name)[:filled] = part.numpy().reshape(getattr(buffer, name)[:filled].shape)
        # Episodes end by truncation only.
        buffer.dones[:filled, 0] = buffer.timeouts[:filled, 0] = self._ends[:filled]
        buffer.pos, buffer.full = self._added % buffer.buffer_size, self._added >= buffer.buffer_size
