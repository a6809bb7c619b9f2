"""All cells of one or several runs learning in lockstep in this process, as one stack of agents."""

import copy
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from mjris.config import Config, ConfigError
from mjris.env import OfficeEnv, OfficeVecEnv
from mjris.learn.agent import build_agent
from mjris.learn.federation import (
    EnvFactory,
    EpisodeMetrics,
    InOrder,
    State,
    agent_generator,
    environment_seed,
    episode_metrics,
    episodes_of,
    learning_seed,
    record_episode,
)
from mjris.learn.stack import Batch, StackedDDPG

FloatArray = NDArray[np.floating]
Results = list[tuple[State, list[EpisodeMetrics]]]
"""What `Cell.train` returns, of every cell."""


class StackedCells:
    """All cells of one run, in lockstep in this process."""

    def __init__(self, config: Config, make_env: EnvFactory, log_dir: Path | None):
        self._runs = StackedRuns([config], make_env, [log_dir])

    def train(self, round_: int, params: State | None) -> Results:
        """`Cell.train` of every cell."""
        return self._runs.train(round_, [params])[0]

    def save(self, folder: Path, params: State | None) -> None:
        """`Cell.save` of every cell."""
        self._runs.save(0, folder, params)

    def close(self) -> None:
        """`Cell.close` of every cell."""
        self._runs.close()


class StackedRuns:
    """The cells of G runs of U cells each as one stack of G·U agents.

    The configs may differ in whatever leaves the agents, the number of cells and the slots alike: in their seeds, for
    one. Every agent draws from the same generators as a `Cell` does, so that its numbers are those of a `Cell` but for
    rounding. With log directories, cell u of run g logs to cell_u in that of the run. Raises `ConfigError` where
    configs have no common stack.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        make_env: EnvFactory,
        log_dirs: Sequence[Path | None],
        device: str = "cpu",
    ):
        torch.set_num_threads(1)
        self._configs, self._make_env = configs, make_env
        self._config = configs[0]
        self._envs = [_side_by_side(config, make_env) for config in configs]
        _check_equal(configs, self._envs)
        self._members = [(g, u) for g in range(len(configs)) for u in range(self._config.federation.num_cells)]
        self._agents = [
            build_agent(configs[g], _Outline(self._envs[g]), agent_generator(configs[g], u)) for g, u in self._members
        ]
        for (g, u), agent in zip(self._members, self._agents, strict=True):
            if (log_dir := log_dirs[g]) is not None:
                agent.set_logger(configure(str(log_dir / f"cell_{u}"), ["tensorboard"]))
        self._learner = StackedDDPG(self._agents, device)
        self._memory = ReplayMemory(self._agents, self._config.federation.episodes * self._config.task.slots, device)
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
                self._store(index, self._agents[index])
                if params is not None:
                    self._agents[index].policy.load_state_dict(params)
                self._agents[index].save(folder / f"cell_{u}.zip")

    def agent(self, run: int, cell: int) -> DDPG:
        """A cell's agent by itself as it is now, with its replay memory and an environment of its own."""
        config, index = self._configs[run], self._members.index((run, cell))
        agent = build_agent(config, self._make_env(config, cell), agent_generator(config, cell))
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

    def _store(self, index: int, agent: DDPG) -> None:
        self._learner.store(index, agent)
        agent.num_timesteps = self._slots
        agent._n_updates = self._updates
        agent._episode_num = self._slots // self._config.task.slots

    def _train(self, round_: int, params: Sequence[State | None]) -> list[Results]:
        cells = self._config.federation.num_cells
        for g, state in enumerate(params):
            if state is not None:
                self._learner.load(slice(g * cells, (g + 1) * cells), state)
        for config, env in zip(self._configs, self._envs, strict=True):
            env.seed(environment_seed(config, round_))
        self._observations = np.concatenate([_array(env.reset()) for env in self._envs])
        generators = [
            _seed(agent, learning_seed(self._configs[g], u, round_))
            for agent, (g, u) in zip(self._agents, self._members, strict=True)
        ]
        episodes = [self._episode(round_, episode, generators) for episode in episodes_of(self._config, round_)]
        results = [
            (self._learner.state(index), [metrics[index] for metrics in episodes]) for index in range(len(self._agents))
        ]
        return [results[g * cells : (g + 1) * cells] for g in range(len(self._configs))]

    def _episode(
        self, round_: int, episode: int, generators: Sequence[np.random.RandomState]
    ) -> list[EpisodeMetrics]:
        """Play and learn one episode in every cell; its metrics, one of each agent."""
        slots = self._config.task.slots
        draws = self._draw(generators)
        rewards, infos, losses = [], [], None
        for slot in range(slots):
            actions = np.clip(self._act(draws, slot) + draws.noise[slot], -1, 1)
            reward, info = self._step(actions, last=slot + 1 == slots)
            rewards.append(reward)
            infos.append(info)
            # The updates are those of the last slots: there is none in the warm-up.
            update = len(draws.rows) - slots + slot
            if update >= 0:
                losses = self._learner.update(self._memory.batch(draws.rows[update]))
        self._updates += len(draws.rows)
        metrics = []
        for index, (agent, (_, u)) in enumerate(zip(self._agents, self._members, strict=True)):
            own = [float(reward[index]) for reward in rewards]
            metrics.append(episode_metrics(round_, episode, u, own, [info[index] for info in infos]))
            record_episode(agent.logger, metrics[-1])
            if losses is not None:
                agent.logger.record("train/actor_loss", losses[0][index].item())
                agent.logger.record("train/critic_loss", losses[1][index].item())
            agent.logger.dump(self._slots)
        return metrics

    def _draw(self, generators: Sequence[np.random.RandomState]) -> "_Draws":
        """What an episode needs of chance, of each agent from its own generators and in the order of SB3."""
        agents, before = self._agents, self._slots + np.arange(self._config.task.slots)
        warmup, size = self._config.agent.warmup_slots, self._config.agent.batch_size
        random = [[agent.action_space.sample() for _ in before[before < warmup]] for agent in agents]
        filled = np.minimum(before[before + 1 > warmup] + 1, self._memory.capacity)
        noise = [[_noise(agent) for _ in before] for agent in agents]
        for agent in agents:
            assert agent.action_noise is not None
            agent.action_noise.reset()
        rows = [generator.randint(0, filled[:, None], (len(filled), size)) for generator in generators]
        return _Draws(np.stack(random, 1), np.stack(noise, 1), np.stack(rows, 1))

    def _act(self, draws: "_Draws", slot: int) -> FloatArray:
        if slot < len(draws.actions):
            return draws.actions[slot]
        return self._learner.act(torch.as_tensor(self._observations)).numpy()

    def _step(self, actions: FloatArray, last: bool) -> tuple[FloatArray, list[dict[str, Any]]]:
        """Play one slot in every cell and remember it: rewards [A] and infos."""
        shares = np.split(actions, len(self._envs))
        steps = [env.step(share) for env, share in zip(self._envs, shares, strict=True)]
        observations, reward, done = (np.concatenate([_array(step[i]) for step in steps]) for i in range(3))
        infos = [info for step in steps for info in step[3]]
        if np.any(done != last):
            raise ValueError(f"cells: every episode of a stack must have {self._config.task.slots} slots")
        following = np.stack([info["terminal_observation"] for info in infos]) if last else observations
        self._memory.add(self._observations, actions, reward, following, last)
        self._observations = observations
        self._slots += 1
        return reward, infos


class ReplayMemory:
    """The last transitions of every agent, one ring of float32 rows [A, capacity, ...].

    The ring is as long as the agents' own buffers, or as the run where that is shorter.
    """

    def __init__(self, agents: Sequence[DDPG], run_slots: int, device: str):
        first = agents[0]
        observations, actions = (int(np.prod(space.shape or ())) for space in (first.observation_space, first.action_space))
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


class _Draws(NamedTuple):
    """All that is random in one episode of T slots."""

    actions: FloatArray
    """Of the slots that are warm-up [≤ T, A, n]."""
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
    """Single environments one after the other, all with the same seed: they have the number of their cell."""

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        self._seeds = [seed] * self.num_envs
        return self._seeds


def _side_by_side(config: Config, make_env: EnvFactory) -> VecEnv:
    """All cells of a run: stepped together where they are offices."""
    cells = config.federation.num_cells
    if make_env is OfficeEnv:
        return OfficeVecEnv(cells, config)
    return _SingleEnvs([partial(make_env, config, u) for u in range(cells)])


def _check_equal(configs: Sequence[Config], envs: Sequence[VecEnv]) -> None:
    first, shapes = configs[0], (envs[0].observation_space.shape, envs[0].action_space.shape)
    for config, env in zip(configs, envs, strict=True):
        if config.agent != first.agent or config.federation != first.federation:
            raise ConfigError("configs: runs of one stack must have the same agent and federation sections")
        if config.task.slots != first.task.slots:
            raise ConfigError(f"task.slots: {config.task.slots} is not allowed: the stack's first run has {first.task.slots}")
        if (env.observation_space.shape, env.action_space.shape) != shapes:
            raise ConfigError("configs: runs of one stack must have observations and actions of the same sizes")


def _seed(agent: DDPG, seed: int) -> np.random.RandomState:
    """Seed an agent's warm-up actions; the generator of its minibatches, the same as SB3's global one."""
    agent.action_space.seed(seed)
    return np.random.RandomState(seed)


def _noise(agent: DDPG) -> FloatArray:
    assert agent.action_noise is not None
    return agent.action_noise()


def _array(values: Any) -> FloatArray:
    return np.asarray(values)
