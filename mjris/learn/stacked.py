"""All cells of one or several runs learning in lockstep in this process, as one stack of agents."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from mjris.config import Config, ConfigError
from mjris.envs.gym_env import OfficeEnv
from mjris.envs.sb3_vec import OfficeVecEnv
from mjris.learn.agent import DecayingOUNoise
from mjris.learn.divergence import diverged
from mjris.learn.federation import (
    EnvFactory,
    EpisodeMetrics,
    InOrder,
    State,
    environment_seed,
    episode_metrics,
    episodes_of,
    learning_seed,
    record_episode,
    untrained_agent,
)
from mjris.learn.replay import ReplayMemory
from mjris.learn.stack import StackedDDPG
from mjris.simulation.streams import CellId

FloatArray = NDArray[np.floating]
Results = Sequence[tuple[State, list[EpisodeMetrics]]]
"""What `Cell.train` returns, of every cell."""

Member = tuple[int, int]
"""A run and a cell of it."""


class StackedRuns:
    """The cells of G runs of U cells each, or these `members` of them, as one stack of G·U agents.

    Runs that differ in nothing but the seed are simulated together.
    The configs may differ in the learning rate, and in whatever leaves the agents, the number of cells and the slots
    alike: in their seeds, for one. Every agent draws from the same generators as a `Cell` does, so that its numbers
    are those of a `Cell` but for rounding. With log directories, cell u of run g logs to cell_u in that of the run.
    Raises `ConfigError` where configs have no common stack, and `Diverged` in training.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        make_env: EnvFactory,
        log_dirs: Sequence[Path | None],
        device: str = "cpu",
        members: Sequence[Member] | None = None,
    ):
        torch.set_num_threads(1)  # networks of this size gain little from more
        self._configs, self._make_env = configs, make_env
        self._config = configs[0]
        _check_equal(configs)
        groups = _alike(configs, members_of(configs) if members is None else members)
        self._members = [member for group in groups for member in group]
        self._envs: list[OfficeVecEnv | _SingleEnvs] = []
        for group in groups:
            self._envs.append(_side_by_side([(configs[g], u) for g, u in group], make_env))
            _check_same_spaces(self._envs)
        ends = np.cumsum([len(group) for group in groups]).tolist()
        self._slices = [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]
        """Members in each environment."""
        self._agents = [untrained_agent(configs[g], u, _Outline(self._envs[0])) for g, u in self._members]
        for (g, u), agent in zip(self._members, self._agents, strict=True):
            if (log_dir := log_dirs[g]) is not None:
                agent.set_logger(configure(str(log_dir / f"cell_{u}"), ["tensorboard"]))
        self._policy = self._agents[0].policy
        self._learner = StackedDDPG(self._agents, device)
        slots = self._config.task.slots
        self._memory = ReplayMemory(self._agents, self._config.federation.episodes * slots, slots, device)
        self._slots = 0
        self._updates = 0
        self._observations: FloatArray
        self._rounds = InOrder(self._train, "cells")

    def train(self, round_: int, params: Sequence[State | None]) -> list[Results]:
        """Train a round starting from the parameters given for each run: `Cell.train` of every cell of every run."""
        return self._rounds(round_, params)

    def save(self, run: int, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell u of a run to cell_u.zip in `folder`, which must exist."""
        for index, (g, u) in enumerate(self._members):
            if g == run:
                self._store(index, self._agents[index], params)
                self._agents[index].save(folder / f"cell_{u}.zip")

    def agent(self, run: int, cell: int) -> DDPG:
        """A cell's agent by itself as it is now, with its replay memory and an environment of its own."""
        config, index = self._configs[run], self._members.index((run, cell))
        agent = untrained_agent(config, cell, self._make_env(config, cell))
        self._store(index, agent)
        agent.action_noise = copy.deepcopy(self._agents[index].action_noise)
        assert agent.replay_buffer is not None
        self._memory.store(index, agent.replay_buffer)
        return agent

    def close(self) -> None:
        """Release the environments and the TensorBoard files."""
        for agent in self._agents:
            agent.logger.close()
        for env in self._envs:
            env.close()

    def _store(self, index: int, agent: DDPG, params: State | None = None) -> None:
        self._learner.store(index, agent, params)
        agent.num_timesteps = self._slots
        agent._n_updates = self._updates
        agent._episode_num = self._slots // self._config.task.slots

    def _train(self, round_: int, params: Sequence[State | None]) -> list[Results]:
        for index, (g, _) in enumerate(self._members):
            if (state := params[g]) is not None:
                self._learner.load(index, state)
        seeds = [environment_seed(self._configs[g], round_) for g, _ in self._members]
        for env, members in zip(self._envs, self._slices, strict=True):
            env.seed(seeds[members])
        self._observations = np.concatenate([_array(env.reset()) for env in self._envs])
        generators = [
            _seed(agent, learning_seed(self._configs[g], u, round_))
            for agent, (g, u) in zip(self._agents, self._members, strict=True)
        ]
        episodes = [self._episode(round_, episode, generators) for episode in episodes_of(self._config, round_)]
        results: list[list[tuple[State, list[EpisodeMetrics]]]] = [[] for _ in self._configs]
        for index, (g, _) in enumerate(self._members):
            results[g].append((self._learner.state(index), [metrics[index] for metrics in episodes]))
        return list(results)

    def _episode(self, round_: int, episode: int, generators: Sequence[np.random.RandomState]) -> list[EpisodeMetrics]:
        """Play and learn one episode in every cell; its metrics, one of each agent."""
        slots = self._config.task.slots
        draws = self._draw(generators)
        rewards, infos = [], []
        for slot in range(slots):
            warm_up = slot < len(draws.actions)
            actions = draws.actions[slot] if warm_up else self._learner.act(self._observations)
            self._check_finite(np.all(np.isfinite(actions), axis=1), episode)
            reward, info = self._step(np.clip(actions + draws.noise[slot], -1, 1), last=slot + 1 == slots)
            rewards.append(reward)
            infos.append(info)
            # The updates are those of the last slots: there is none in the warm-up.
            update = len(draws.rows) - slots + slot
            if update >= 0:
                self._learner.update(self._memory.batch(draws.rows[update]))
        self._updates += len(draws.rows)
        metrics, losses = [], self._learner.losses() if len(draws.rows) > 0 else None
        if losses is not None:
            self._check_finite(np.all(np.isfinite(losses), axis=0) & self._learner.finite(), episode)
        for index, (agent, (_, u)) in enumerate(zip(self._agents, self._members, strict=True)):
            own = [float(reward[index]) for reward in rewards]
            metrics.append(episode_metrics(round_, episode, u, own, [info[index] for info in infos]))
            record_episode(agent.logger, metrics[-1])
            if losses is not None:
                agent.logger.record("train/actor_loss", losses[0][index].item())
                agent.logger.record("train/critic_loss", losses[1][index].item())
            agent.logger.dump(self._slots)
        return metrics

    def _check_finite(self, finite: NDArray[np.bool_], episode: int) -> None:
        """Raise `Diverged` for the first agent whose numbers are not finite [A]."""
        if not finite.all():
            g, u = self._members[finite.argmin()]
            raise diverged(self._configs[g], u, episode)

    def _draw(self, generators: Sequence[np.random.RandomState]) -> "_Draws":
        """What an episode needs of chance, of each agent from its own generators and in the order of SB3."""
        agents, before = self._agents, self._slots + np.arange(self._config.task.slots)
        warmup, size = self._config.agent.warmup_slots, self._config.agent.batch_size
        random = [np.stack([agent.action_space.sample() for agent in agents]) for _ in before[before < warmup]]
        filled = np.minimum(before[before + 1 > warmup] + 1, self._memory.capacity)
        noise = [_noise(agent, len(before)) for agent in agents]
        rows = [generator.randint(0, filled[:, None], (len(filled), size)) for generator in generators]
        return _Draws([self._policy.scale_action(each) for each in random], np.stack(noise, 1), np.stack(rows, 1))

    def _step(self, actions: FloatArray, last: bool) -> tuple[FloatArray, list[dict[str, Any]]]:
        """Play one slot in every cell, with actions scaled to [-1, 1], and remember it: rewards [A] and infos."""
        unscaled = self._policy.unscale_action(actions)
        steps = [env.step(unscaled[members]) for env, members in zip(self._envs, self._slices, strict=True)]
        observations, reward, done = (np.concatenate([_array(step[i]) for step in steps]) for i in range(3))
        infos = [info for step in steps for info in step[3]]
        if np.any(done != last):
            raise ValueError(f"cells: every episode of a stack must have {self._config.task.slots} slots")
        following = np.stack([info["terminal_observation"] for info in infos]) if last else observations
        terminated = np.array([last and not info.get("TimeLimit.truncated", False) for info in infos])
        self._memory.add(self._observations, actions, reward, terminated, following, last)
        self._observations = observations
        self._slots += 1
        return reward, infos


class _Draws(NamedTuple):
    """All that is random in one episode of T slots."""

    actions: list[FloatArray]
    """Of the slots that are warm-up, scaled to [-1, 1], each [A, n]."""
    noise: FloatArray
    """[T, A, n]"""
    rows: NDArray[np.int64]
    """Places in the replay memory of every minibatch [≤ T, A, B]."""


class _Outline(gym.Env):
    """The spaces of a cell, all that an agent must know to be built."""

    def __init__(self, env: VecEnv):
        # Copies, because a space has a generator, and agents draw their warm-up actions from their own.
        self.observation_space = copy.deepcopy(env.observation_space)
        self.action_space = copy.deepcopy(env.action_space)


class _SingleEnvs(DummyVecEnv):
    """Single environments one after the other, each with a seed of its own: the cells of a run share theirs."""

    def seed(self, seed: int | Sequence[int] | None = None) -> Sequence[int | None]:
        self._seeds = list(seed) if isinstance(seed, Sequence) else [seed] * self.num_envs
        return self._seeds


def members_of(configs: Sequence[Config]) -> list[Member]:
    """All cells of all runs."""
    return [(g, u) for g, config in enumerate(configs) for u in range(config.federation.num_cells)]


def _alike(configs: Sequence[Config], members: Sequence[Member]) -> list[list[Member]]:
    """The cells of runs that differ in nothing but the seed, which one simulator can step together."""
    groups: dict[Config, list[Member]] = {}
    for g, u in members:
        groups.setdefault(replace(configs[g], seed=0), []).append((g, u))
    return list(groups.values())


def _side_by_side(cells: Sequence[tuple[Config, int]], make_env: EnvFactory) -> OfficeVecEnv | _SingleEnvs:
    """Cells of like configs, each with its number: stepped together where they are offices."""
    if make_env is OfficeEnv:
        return OfficeVecEnv([CellId(config.named_seed, u) for config, u in cells], cells[0][0])
    return _SingleEnvs([partial(make_env, config, u) for config, u in cells])


def _check_equal(configs: Sequence[Config]) -> None:
    first = configs[0]
    for config in configs:
        agent = replace(config.agent, learning_rate=first.agent.learning_rate)
        if agent != first.agent or config.federation != first.federation:
            raise ConfigError(
                "configs: runs of one stack must have the same agent and federation sections, learning rates apart"
            )
        if config.task.slots != first.task.slots:
            raise ConfigError(
                f"task.slots: {config.task.slots} is not allowed: the stack's first run has {first.task.slots}"
            )


def _check_same_spaces(envs: Sequence[VecEnv]) -> None:
    shapes = {(env.observation_space.shape, env.action_space.shape) for env in envs}
    if len(shapes) > 1:
        for env in envs:
            env.close()
        raise ConfigError("configs: runs of one stack must have observations and actions of the same sizes")


def _seed(agent: DDPG, seed: int) -> np.random.RandomState:
    """Seed an agent's warm-up actions; the generator of its minibatches, the same as SB3's global one."""
    agent.action_space.seed(seed)
    return np.random.RandomState(seed)


def _noise(agent: DDPG, slots: int) -> FloatArray:
    """Exploration noise of the slots of an episode [T, n]."""
    assert isinstance(agent.action_noise, DecayingOUNoise)
    noise = agent.action_noise.ahead(slots)
    agent.action_noise.reset()
    return noise


def _array(values: Any) -> FloatArray:
    return np.asarray(values)
