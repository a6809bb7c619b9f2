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
IntArray = NDArray[np.int64]


class Batch(NamedTuple):
    """Minibatches of A agents, B transitions each, where the memory has them."""

    rows: Tensor
    """Observations, actions, reward, and 1 or 0 for whether the episode goes on [A, L, D + n + 2]."""
    places: IntArray
    """The rows of the transitions [A, B]."""
    following: IntArray
    """The rows of their next observations [A, B]."""
    width: int
    """Of the observations, D."""

    def picked(self) -> "Picked":
        """Copies of all, on the device of the memory."""
        device = self.rows.device
        agents = torch.arange(len(self.rows), device=device)[:, None]
        own, after = (self.rows[agents, torch.from_numpy(each).to(device)] for each in (self.places, self.following))
        return Picked(own[..., :-2], own[..., -2:-1], own[..., -1:], after[..., :-2], self.width)


class Picked(NamedTuple):
    """A `Batch` taken out of the memory."""

    pairs: Tensor
    """Observations and actions [A, B, D + n]."""
    rewards: Tensor
    """[A, B, 1]"""
    goes_on: Tensor
    """0 where the episode ended for good, and 1 elsewhere, at time limits too [A, B, 1]."""
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
    """The last transitions of every agent, one ring of float32 rows: observation, action, reward, and what ended.

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
        rows = np.zeros((len(agents), self._length, self._width + actions + 2), np.float32)
        self._rows = torch.from_numpy(rows).to(device)
        self._places = np.zeros(self.capacity, np.int64)
        """Row of each transition; transitions are numbered as in SB3's buffer."""
        self._ends = np.zeros(self.capacity, np.bool_)
        self._added = self._row = 0

    def add(
        self,
        observations: FloatArray,
        actions: FloatArray,
        rewards: FloatArray,
        terminated: NDArray[np.bool_],
        following: FloatArray,
        last: bool,
    ) -> None:
        """Remember one slot of every agent: [A, D], [A, n], [A], [A], [A, D].

        `last` is the end of an episode, by a time limit but where it is `terminated`.
        """
        number, after = self._added % self.capacity, (self._row + 1) % self._length
        self._write(self._row, np.column_stack([observations, actions, rewards, (~terminated).astype(np.float32)]))
        self._write(after, following)
        self._places[number], self._ends[number] = self._row, last
        self._row = (after + last) % self._length
        self._added += 1

    def batch(self, numbers: IntArray) -> Batch:
        """Each agent's transitions of these numbers [A, B]."""
        places = self._places[numbers]
        return Batch(self._rows, places, (places + 1) % self._length, self._width)

    def store(self, index: int, buffer: ReplayBuffer) -> None:
        """Write what an agent remembers to an empty SB3 buffer."""
        filled = min(self._added, self.capacity)
        own, places = self._rows[index].cpu().numpy(), self._places[:filled]
        sizes = [self._width, own.shape[1] - 2, own.shape[1] - 1]
        observations, actions, rewards, goes_on = np.split(own[places], sizes, 1)
        following = own[(places + 1) % self._length, : self._width]
        names = ("observations", "actions", "rewards", "next_observations")
        for name, values in zip(names, (observations, actions, rewards, following), strict=True):
            getattr(buffer, name)[:filled] = values.reshape(getattr(buffer, name)[:filled].shape)
        buffer.dones[:filled, 0] = self._ends[:filled]
        buffer.timeouts[:filled, 0] = self._ends[:filled] * goes_on[:, 0]
        buffer.pos, buffer.full = self._added % buffer.buffer_size, self._added >= buffer.buffer_size

    def _write(self, row: int, values: FloatArray) -> None:
        """Write the first numbers of a row of every agent [A, ≤ D + n + 2]."""
        if self._rows.device.type == "cpu":
            self._rows.numpy()[:, row, : values.shape[1]] = values  # a third of the time that torch takes
        else:
            self._rows[:, row, : values.shape[1]] = torch.from_numpy(values).to(self._rows.device)
