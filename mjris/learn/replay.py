"""The replay memories of agents that learn in lockstep."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from stable_baselines3.common.buffers import ReplayBuffer
from torch import Tensor

from mjris.compiled import compiled

FloatArray = NDArray[np.floating]


class Batch(NamedTuple):
    """Minibatches of A agents, B transitions each; no episode of mjris ends but by truncation."""

    pairs: Tensor
    """Observations and actions [A, B, D + n]."""
    rewards: Tensor
    """[A, B, 1]"""
    next_pairs: Tensor
    """Next observations, and room for actions [A, B, D + n]."""
    width: int
    """Of the observations, D."""

    @property
    def observations(self) -> Tensor:
        """[A, B, D]"""
        return self.pairs[..., : self.width]

    @property
    def actions(self) -> Tensor:
        """[A, B, n]"""
        return self.pairs[..., self.width :]

    @property
    def next_observations(self) -> Tensor:
        """[A, B, D]"""
        return self.next_pairs[..., : self.width]

    @property
    def next_actions(self) -> Tensor:
        """[A, B, n]"""
        return self.next_pairs[..., self.width :]


class ReplayMemory:
    """The last transitions of every agent, one ring of float32 rows: observation, action and reward.

    The next observation is that of the following row, so that an episode takes one row more than it has slots. The
    ring is for as many transitions as the agents' own buffers, or the run where that is shorter.
    """

    def __init__(self, agents: Sequence[DDPG], run_slots: int, episode_slots: int, device: str):
        first = agents[0]
        self._width, actions = (
            int(np.prod(space.shape or ())) for space in (first.observation_space, first.action_space)
        )
        self.capacity = min(first.buffer_size, run_slots)
        self._length = self.capacity + self.capacity // episode_slots + 2
        # Zeros of this kind take no memory until they are written over.
        rows = np.zeros((len(agents), self._length, self._width + actions + 1), np.float32)
        self._rows = torch.from_numpy(rows).to(device)
        self._places = np.zeros(self.capacity, np.int64)
        """Row of each transition; transitions are numbered as in SB3's buffer."""
        self._ends = np.zeros(self.capacity, np.bool_)
        self._added = self._row = 0

    def add(
        self, observations: FloatArray, actions: FloatArray, rewards: FloatArray, following: FloatArray, last: bool
    ) -> None:
        """Remember one slot of every agent: [A, D], [A, n], [A], [A, D]; `last` is the end of an episode."""
        number, after = self._added % self.capacity, (self._row + 1) % self._length
        row = np.concatenate([observations, actions, rewards[:, None]], 1)
        self._rows[:, self._row] = torch.from_numpy(row).to(self._rows.device)
        self._rows[:, after, : self._width] = torch.from_numpy(following).to(self._rows.device)
        self._places[number], self._ends[number] = self._row, last
        self._row = (after + last) % self._length
        self._added += 1

    def batch(self, numbers: NDArray[np.int64]) -> Batch:
        """Each agent's transitions of these numbers [A, B]."""
        places = self._places[numbers]
        following = (places + 1) % self._length
        if self._rows.device.type == "cpu":
            pairs, rewards, next_pairs = map(torch.from_numpy, _picked(self._rows.numpy(), places, following))
        else:
            pairs, rewards, next_pairs = picked_together(self._rows, places, following)
        return Batch(pairs, rewards, next_pairs, self._width)

    def store(self, index: int, buffer: ReplayBuffer) -> None:
        """Write what an agent remembers to an empty SB3 buffer."""
        filled = min(self._added, self.capacity)
        own, places = self._rows[index].cpu().numpy(), self._places[:filled]
        observations, actions, rewards = np.split(own[places], [self._width, own.shape[1] - 1], 1)
        following = own[(places + 1) % self._length, : self._width]
        names = ("observations", "actions", "rewards", "next_observations")
        for name, values in zip(names, (observations, actions, rewards, following), strict=True):
            getattr(buffer, name)[:filled] = values.reshape(getattr(buffer, name)[:filled].shape)
        # Episodes end by truncation only.
        buffer.dones[:filled, 0] = buffer.timeouts[:filled, 0] = self._ends[:filled]
        buffer.pos, buffer.full = self._added % buffer.buffer_size, self._added >= buffer.buffer_size


def picked_together(
    rows: Tensor, places: NDArray[np.int64], following: NDArray[np.int64]
) -> tuple[Tensor, Tensor, Tensor]:
    """Pairs and rewards at these places [A, B] of rows [A, L, D + n + 1], and the pairs of the following ones."""
    agents = torch.arange(len(rows), device=rows.device)[:, None]
    own, next_ = (rows[agents, torch.from_numpy(each).to(rows.device)] for each in (places, following))
    return own[..., :-1], own[..., -1:], next_[..., :-1]


@compiled
def _picked(
    rows: NDArray[np.float32], places: NDArray[np.int64], following: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """`picked_together`, row by row."""
    agents, size = places.shape
    width = rows.shape[2] - 1
    pairs, rewards = np.empty((agents, size, width), np.float32), np.empty((agents, size, 1), np.float32)
    next_pairs = np.empty((agents, size, width), np.float32)
    for agent in range(agents):
        for sample in range(size):
            row, next_row = rows[agent, places[agent, sample]], rows[agent, following[agent, sample]]
            pair, next_pair = pairs[agent, sample], next_pairs[agent, sample]
            for i in range(width):
                pair[i], next_pair[i] = row[i], next_row[i]
            rewards[agent, sample, 0] = row[width]
    return pairs, rewards, next_pairs
