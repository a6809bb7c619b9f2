"""Federated averaging: the mean of agents, the callback that exchanges them, and a cell's rounds of training."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from mjris.config import Config
from mjris.learn.agent import build_agent

State = Mapping[str, torch.Tensor]
"""Parameters and batch-norm statistics of actor, critic and both targets, by name."""

EnvFactory = Callable[[Config, int], gym.Env]
"""Builds the environment of a cell from the config and the cell's number."""

# Purposes of the random streams that follow from the run's seed.
_AGENT, _LEARN, _ENV = range(3)


def average(state_dicts: Sequence[State]) -> dict[str, torch.Tensor]:
    """The mean of state dicts with equal weights, ω_G = 1/U Σ ω_u (paper, section IV-B).

    Summed in float64 in the order given and cast back to each entry's type; integer entries (batch counters) become
    the rounded mean. Raises `ValueError` for an empty list and, naming the entry, where keys or shapes differ.
    """
    if not state_dicts:
        raise ValueError("average: needs at least one state dict")
    first = state_dicts[0]
    for other in state_dicts[1:]:
        if differing := first.keys() ^ other.keys():
            raise ValueError(f"average: {min(differing)} is not in every state dict")
        for key, tensor in first.items():
            if tensor.shape != other[key].shape:
                raise ValueError(f"average: {key} has shapes {tuple(tensor.shape)} and {tuple(other[key].shape)}")
    return {key: _mean([state[key] for state in state_dicts]) for key in first}


def _mean(tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    """The mean of equally shaped tensors, in the type of the first."""
    total = torch.zeros(tensors[0].shape, dtype=torch.float64)
    for tensor in tensors:
        total += tensor.double()
    mean = total / len(tensors)
    dtype = tensors[0].dtype
    return mean.to(dtype) if dtype.is_floating_point else mean.round().to(dtype)


class FederatedAveraging(BaseCallback):
    """Loads merged parameters when training starts and exports the agent's own when it ends.

    Only what `State` holds is exchanged: optimizers and replay memory stay as they are.
    """

    def __init__(self, merged: State | None):
        super().__init__()
        self._merged = merged
        self.exported: State = {}

    def _on_training_start(self) -> None:
        if self._merged is not None:
            self.model.policy.load_state_dict(self._merged)

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self.exported = {key: tensor.detach().clone() for key, tensor in self.model.policy.state_dict().items()}


@dataclass(frozen=True, kw_only=True)
class EpisodeMetrics:
    """One episode of one cell; a row of metrics.csv."""

    round: int
    """Counted from 1."""
    episode: int
    """Counted from 1 over the whole run."""
    cell: int
    """Counted from 0."""
    reward: float
    """Mean reward of a slot [Mb/s]."""
    sum_rate_mbps: float
    """Mean sum rate of a slot [Mb/s]."""
    qos_share: float
    """Share of slots in which every user meets QoS."""
    collisions: int
    """Penetrating contacts, all slots together."""
    clearance_m: float
    """Smallest clearance of the rover [m]."""


class EpisodeRecorder(BaseCallback):
    """Collects the metrics of every finished episode and hands them to the agent's logger."""

    def __init__(self, round_: int, first_episode: int, cell: int):
        super().__init__()
        self.episodes: list[EpisodeMetrics] = []
        self._round = round_
        self._first_episode = first_episode
        self._cell = cell
        self._rewards: list[float] = []
        self._infos: list[dict] = []

    def _on_step(self) -> bool:
        self._rewards.append(float(self.locals["rewards"][0]))
        self._infos.append(self.locals["infos"][0])
        if self.locals["dones"][0]:
            self._finish_episode()
        return True

    def _finish_episode(self) -> None:
        metrics = EpisodeMetrics(
            round=self._round,
            episode=self._first_episode + len(self.episodes),
            cell=self._cell,
            reward=float(np.mean(self._rewards)),
            sum_rate_mbps=float(np.mean([info["sum_rate_bps"] for info in self._infos])) / 1e6,
            qos_share=float(np.mean([np.all(info["qos_met"]) for info in self._infos])),
            collisions=int(sum(info["collisions"] for info in self._infos)),
            clearance_m=float(min(info["clearance_m"] for info in self._infos)),
        )
        self.episodes.append(metrics)
        for name in ("reward", "sum_rate_mbps", "qos_share", "collisions", "clearance_m"):
            self.logger.record(f"episode/{name}", getattr(metrics, name))
        self._rewards.clear()
        self._infos.clear()


class Cell:
    """One cell: its environment, its agent, and rounds of local training.

    With `log_dir`, TensorBoard scalars are written there, one point an episode.
    """

    def __init__(self, config: Config, index: int, make_env: EnvFactory, log_dir: Path | None = None):
        self._config = config
        self._index = index
        self._agent = build_agent(config, make_env(config, index), np.random.default_rng(self._seed(_AGENT, index)))
        if log_dir is not None:
            self._agent.set_logger(configure(str(log_dir), ["tensorboard"]))
        self._started = 0
        self._finished = 0
        self._result: tuple[State, list[EpisodeMetrics]] = ({}, [])

    def train(self, round_: int, params: State | None) -> tuple[State, list[EpisodeMetrics]]:
        """Train round `round_` (from 1) starting from `params`, or from where the agent is if None.

        Returns the local parameters and the metrics of the round's episodes. The round just finished may be asked
        for again and is not trained again. Raises `ValueError` for any other round that is not the next.
        """
        if round_ == self._finished:
            return self._result
        if round_ != self._started + 1:
            raise ValueError(f"cell {self._index}: round {round_} is out of order after round {self._started}")
        # A round that fails half-way stays started, so that it cannot be taken up again from a half-trained agent.
        self._started = round_
        self._result = self._train(round_, params)
        self._finished = round_
        return self._result

    def _train(self, round_: int, params: State | None) -> tuple[State, list[EpisodeMetrics]]:
        federation = self._config.federation
        first = (round_ - 1) * federation.round_episodes
        episodes = min(federation.round_episodes, federation.episodes - first)
        self._seed_round(round_)
        exchange = FederatedAveraging(params)
        recorder = EpisodeRecorder(round_, first + 1, self._index)
        self._agent.learn(
            episodes * self._config.task.slots,
            callback=[exchange, recorder],
            log_interval=1,
            reset_num_timesteps=False,
        )
        return exchange.exported, recorder.episodes

    def _seed_round(self, round_: int) -> None:
        """Seed all that the round draws from, so that it does not depend on who else runs in this process."""
        env = self._agent.get_env()
        assert env is not None
        self._agent.set_random_seed(_word(self._seed(_LEARN, self._index, round_)))
        # The same for every cell: what cells share (fading) must stay shared, and each adds its own number to it.
        env.seed(_word(self._seed(_ENV, round_)))
        self._agent.set_env(env)  # makes `learn` reset the environment, which is when it takes the seed

    def _seed(self, *key: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._config.seed, spawn_key=key)

    def save(self, path: Path, params: State | None) -> None:
        """Write the agent without its replay memory as an SB3 zip, after loading `params` unless None."""
        if params is not None:
            self._agent.policy.load_state_dict(params)
        self._agent.save(path)

    def close(self) -> None:
        """Release the environment and the TensorBoard file."""
        self._agent.logger.close()
        env = self._agent.get_env()
        assert env is not None
        env.close()


def num_rounds(config: Config) -> int:
    """Rounds of a run; the last may be shorter than the others."""
    return -(-config.federation.episodes // config.federation.round_episodes)


def _word(seed: np.random.SeedSequence) -> int:
    """A 32-bit seed for generators that take no sequence."""
    return int(seed.generate_state(1)[0])
