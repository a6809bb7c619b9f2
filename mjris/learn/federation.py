"""Federated averaging: the mean of agents, the callback that exchanges them, and a cell's rounds of training."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, configure

from mjris.config import Config
from mjris.learn.agent import build_agent, weights_seed
from mjris.learn.divergence import DivergenceCheck, non_finite
from mjris.simulation.streams import Purpose, generator, word

P = TypeVar("P")
R = TypeVar("R")

State = Mapping[str, torch.Tensor]
"""Parameters and batch-norm statistics of actor, critic and both targets, by name."""

EnvFactory = Callable[[Config, int], gym.Env]
"""Builds the environment of a cell from the config and the cell's number."""


def average(state_dicts: Sequence[State]) -> dict[str, torch.Tensor]:
    """The mean of state dicts with equal weights, ω_G = 1/U Σ ω_u (paper, section IV-B).

    Summed in float64 in the order given and cast back to each entry's type; integer entries (batch counters) become
    the rounded mean. Raises `ValueError` for an empty list and, naming the entry, where keys or shapes differ, or a
    number is not finite.
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
    for number, state in enumerate(state_dicts):
        if (key := non_finite(state)) is not None:
            raise ValueError(f"average: {key} of state dict {number} has numbers that are not finite")
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
    bare_rate_mbps: float
    """What the same slots give without RIS, under closed-form powers [Mb/s]."""
    qos_share: float
    """Share of slots in which every user meets QoS."""
    collisions: int
    """Penetrating contacts, all slots together."""
    clearance_m: float
    """Smallest clearance of the rover [m]."""

    @property
    def gain_percent(self) -> float:
        """By how much the sum rate exceeds that without RIS in the same slots [%]; NaN where that is zero."""
        return 100 * (self.sum_rate_mbps / self.bare_rate_mbps - 1) if self.bare_rate_mbps else math.nan


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
        episode = self._first_episode + len(self.episodes)
        metrics = episode_metrics(self._round, episode, self._cell, self._rewards, self._infos)
        self.episodes.append(metrics)
        record_episode(self.logger, metrics)
        self._rewards.clear()
        self._infos.clear()


def episode_metrics(
    round_: int, episode: int, cell: int, rewards: Sequence[float], infos: Sequence[Mapping[str, Any]]
) -> EpisodeMetrics:
    """The metrics of an episode from the reward and the info of each of its slots."""
    return EpisodeMetrics(
        round=round_,
        episode=episode,
        cell=cell,
        reward=float(np.mean(rewards)),
        sum_rate_mbps=float(np.mean([info["sum_rate_bps"] for info in infos])) / 1e6,
        bare_rate_mbps=float(np.mean([info["bare_sum_rate_bps"] for info in infos])) / 1e6,
        qos_share=float(np.mean([np.all(info["qos_met"]) for info in infos])),
        collisions=int(sum(info["collisions"] for info in infos)),
        clearance_m=float(min(info["clearance_m"] for info in infos)),
    )


def record_episode(logger: Logger, metrics: EpisodeMetrics) -> None:
    """Hand the metrics of an episode to a logger."""
    for name in ("reward", "sum_rate_mbps", "bare_rate_mbps", "gain_percent", "qos_share", "collisions", "clearance_m"):
        logger.record(f"episode/{name}", getattr(metrics, name))


class InOrder(Generic[P, R]):
    """Rounds of training, `train(round, params)`, one after the other; `name` is who trains.

    A call for the round just finished gives its result again and trains nothing. Raises `ValueError` for any other
    round that is not the next.
    """

    def __init__(self, train: Callable[[int, P], R], name: str):
        self._train = train
        self._name = name
        self._started = 0
        self._finished = 0
        self._result: R

    def __call__(self, round_: int, params: P) -> R:
        """The result of round `round_`, counted from 1."""
        if round_ == self._finished and round_ > 0:
            return self._result
        if round_ != self._started + 1:
            raise ValueError(f"{self._name}: round {round_} is out of order after round {self._started}")
        # A round that fails half-way stays started, so that it cannot be taken up again from a half-trained agent.
        self._started = round_
        self._result = self._train(round_, params)
        self._finished = round_
        return self._result


class Cell:
    """One cell: its environment, its agent, and rounds of local training.

    With `log_dir`, TensorBoard scalars are written there, one point an episode.
    """

    def __init__(self, config: Config, index: int, make_env: EnvFactory, log_dir: Path | None = None):
        self._config = config
        self._index = index
        self._agent = untrained_agent(config, index, make_env(config, index))
        if log_dir is not None:
            self._agent.set_logger(configure(str(log_dir), ["tensorboard"]))
        self._rounds = InOrder(self._train, f"cell {index}")

    def train(self, round_: int, params: State | None) -> tuple[State, list[EpisodeMetrics]]:
        """Train round `round_` (from 1) starting from `params`, or from where the agent is if None.

        Returns the local parameters and the metrics of the round's episodes. The round just finished may be asked
        for again and is not trained again. Raises `ValueError` for any other round that is not the next, and `Diverged`
        where losses or parameters are not finite any more.
        """
        return self._rounds(round_, params)

    def _train(self, round_: int, params: State | None) -> tuple[State, list[EpisodeMetrics]]:
        episodes = episodes_of(self._config, round_)
        self._seed_round(round_)
        exchange = FederatedAveraging(params)
        recorder = EpisodeRecorder(round_, episodes.start, self._index)
        self._agent.learn(
            len(episodes) * self._config.task.slots,
            callback=[exchange, recorder, DivergenceCheck(self._config, self._index, episodes.start)],
            log_interval=1,
            reset_num_timesteps=False,
        )
        return exchange.exported, recorder.episodes

    def _seed_round(self, round_: int) -> None:
        """Seed all that the round draws from, so that it does not depend on who else runs in this process."""
        env = self._agent.get_env()
        assert env is not None
        self._agent.set_random_seed(learning_seed(self._config, self._index, round_))
        env.seed(environment_seed(self._config, round_))
        self._agent.set_env(env)  # makes `learn` reset the environment, which is when it takes the seed

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


def episodes_of(config: Config, round_: int) -> range:
    """The episodes of a round, both counted from 1."""
    federation = config.federation
    first = (round_ - 1) * federation.round_episodes + 1
    return range(first, min(first + federation.round_episodes, federation.episodes + 1))


def untrained_agent(config: Config, cell: int, env: gym.Env) -> DDPG:
    """A cell's agent at the start: noise of its own, and first weights as `federation.first_weights` has them."""
    common = config.federation.first_weights == "common"
    first_weights = weights_seed(_agent_generator(config, 0)) if common else None
    return build_agent(config, env, _agent_generator(config, cell), first_weights)


def _agent_generator(config: Config, cell: int) -> np.random.Generator:
    return generator(config.named_seed, Purpose.AGENT, cell)


def learning_seed(config: Config, cell: int, round_: int) -> int:
    """Seed of a cell's minibatches and warm-up actions in a round."""
    return word(config.named_seed, Purpose.LEARNING, cell, round_)


def environment_seed(config: Config, round_: int) -> int:
    """Seed of the environments in a round.

    The same for every cell: what cells share (fading) must stay shared, and each adds its own number to it.
    """
    return word(config.named_seed, Purpose.EPISODES, round_)
