from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from stable_baselines3 import DDPG, TD3
from stable_baselines3.common.utils import get_parameters_by_name
from torch import nn
from toy import BrokenToyEnv, EndingToyEnv, ToyEnv, toy_config

from mjris.config import Config, ConfigError, preset
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.agent import DecayingOUNoise, build_agent
from mjris.learn.descent import _recall, _recall_outcomes
from mjris.learn.federation import Cell, average
from mjris.learn.layers import StackedNetwork
from mjris.learn.policy import load_policy
from mjris.learn.products import AVAILABLE
from mjris.learn.replay import Batch, Picked, ReplayMemory
from mjris.learn.run import train, train_many
from mjris.learn.spread import SpreadRuns, StackedCells, num_stacks
from mjris.learn.stack import StackedDDPG
from mjris.learn.stacked import StackedRuns
from mjris.learn.workers import LocalCells, WorkerCells, backend, describe, open_cells

# The mean over a batch takes a bias in front of a batch norm out again where its ReLU lets every row through. Its
# gradient is then nothing but rounding errors, which Adam scales up to whole steps, and no two orders of sums agree.
ROUNDED_AWAY = ("actor.mu.1.bias", "critic.qf0.1.bias")


def toy_agents(number: int, **agent) -> list[DDPG]:
    config = toy_config(agent=agent)
    return [build_agent(config, ToyEnv(config, u), np.random.default_rng(u)) for u in range(number)]


def convert(agent: DDPG, dtype: torch.dtype) -> None:
    """Give an agent another precision; SB3 keeps references to statistics, which the conversion replaces."""
    agent.policy.to(dtype)
    for name in ("actor", "critic"):
        for network, suffix in ((name, "_batch_norm_stats"), (f"{name}_target", "_batch_norm_stats_target")):
            setattr(agent, name + suffix, get_parameters_by_name(getattr(agent, network), ["running_"]))


def random_batch(rng: np.random.Generator, agents: int, rows: int, dtype: torch.dtype) -> Batch:
    """Of a memory in which every fourth transition ends an episode for good."""
    memory = torch.tensor(rng.uniform(-1, 1, (agents, 3 * rows, 6)), dtype=dtype)
    memory[..., -1] = torch.arange(3 * rows) % 4 > 0
    places, following = rng.integers(0, 3 * rows, (2, agents, rows))
    return Batch(memory, places, following, width=2)


@pytest.fixture
def double_observations(monkeypatch: pytest.MonkeyPatch):
    """SB3 casts observations to float32; leave those of double precision as they are."""
    monkeypatch.setattr("stable_baselines3.common.policies.preprocess_obs", lambda observation, *_, **__: observation)


class Samples:
    """What SB3 calls a sample of the replay memory: agent `index`'s part of a batch."""

    def __init__(self, batch: Picked, index: int):
        names = ("observations", "actions", "rewards", "next_observations")
        self.observations, self.actions, self.rewards, self.next_observations = (
            getattr(batch, name)[index] for name in names
        )
        self.dones = 1 - batch.goes_on[index]
        self.discounts = None


def sb3_update(agents: Sequence[DDPG], batch: Batch) -> None:
    for index, agent in enumerate(agents):
        agent.replay_buffer.sample = lambda *_, index=index, **__: Samples(batch.picked(), index)  # type: ignore
        agent.train(1, agent.batch_size)


def assert_close(left, right, atol: float, ignore: Sequence[str] = ()) -> None:
    assert left.keys() == right.keys()
    for key in left.keys() - set(ignore) - {key.replace(".", "_target.", 1) for key in ignore}:
        torch.testing.assert_close(left[key], right[key], rtol=0, atol=atol, msg=lambda text, key=key: f"{key}: {text}")


@pytest.mark.parametrize(
    ("settings", "dtype", "atol", "one_by_one"),
    [
        ({"network": "mlp"}, torch.float32, 1e-5, True),
        ({"network": "mlp", "caution": 0.7}, torch.float32, 1e-5, True),
        ({"network": "mlp", "hidden": (48, 16, 24), "caution": 0.7}, torch.float32, 1e-5, True),
        ({"network": "paper"}, torch.float32, 1e-5, True),
        ({"network": "mlp"}, torch.float32, 1e-5, False),
        ({"network": "mlp", "caution": 0.7}, torch.float32, 1e-5, False),
        ({"network": "mlp", "caution": 0.7}, torch.float64, 1e-10, False),
        ({"network": "paper"}, torch.float32, 1e-5, False),
        ({"network": "paper"}, torch.float64, 1e-10, False),
    ],
)
@pytest.mark.usefixtures("double_observations")
def test_a_stacked_update_equals_sb3s_own(
    settings: dict, dtype: torch.dtype, atol: float, one_by_one: bool, monkeypatch: pytest.MonkeyPatch
):
    if not one_by_one:
        monkeypatch.setattr("mjris.learn.stack.AVAILABLE", False)
    agents, rng = toy_agents(3, **settings), np.random.default_rng(0)
    for agent in agents:
        convert(agent, dtype)
    for _ in range(5):  # until the optimizers have moments
        sb3_update(agents, random_batch(rng, 3, 32, dtype))
    stack = StackedDDPG(agents)
    assert stack._one_by_one == (one_by_one and AVAILABLE)
    batch = random_batch(rng, 3, 32, dtype)
    stack.update(batch)
    actor_losses, critic_losses = stack.losses()
    sb3_update(agents, batch)
    ignore = ROUNDED_AWAY if dtype == torch.float32 else ()
    for index, agent in enumerate(agents):
        logged = agent.logger.name_to_value
        assert actor_losses[index].item() == pytest.approx(logged["train/actor_loss"], abs=atol)
        assert critic_losses[index].item() == pytest.approx(logged["train/critic_loss"], abs=atol)
        assert_close(stack.state(index), dict(agent.policy.state_dict()), atol, ignore)
        assert agent.actor.optimizer.state_dict()["state"][0]["step"] == 6


@pytest.mark.usefixtures("double_observations")
@pytest.mark.parametrize("network", ["mlp", "paper"])
def test_an_agent_goes_on_by_itself_where_the_stack_left_it(network: str):
    agents, others = (toy_agents(2, network=network) for _ in range(2))
    rng = np.random.default_rng(0)
    for agent in agents:
        convert(agent, torch.float64)
    stack = StackedDDPG(agents)
    for _ in range(3):
        batch = random_batch(rng, 2, 32, torch.float64)
        stack.update(batch)
        sb3_update(agents, batch)
    for index, other in enumerate(others):
        convert(other, torch.float64)
        stack.store(index, other)
    batch = random_batch(rng, 2, 32, torch.float64)
    sb3_update(agents, batch)
    sb3_update(others, batch)
    for agent, other in zip(agents, others, strict=True):
        assert_close(dict(other.policy.state_dict()), dict(agent.policy.state_dict()), 1e-10)
        for name in ("actor", "critic"):
            theirs, own = (getattr(each, name).optimizer.state_dict()["state"] for each in (agent, other))
            for number, entries in theirs.items():
                assert_close(own[number], entries, 1e-10)


@pytest.mark.parametrize("one_by_one", [True, False])
@pytest.mark.parametrize("network", ["mlp", "paper"])
def test_agents_act_as_they_do_alone(network: str, one_by_one: bool, monkeypatch: pytest.MonkeyPatch):
    if not one_by_one:
        monkeypatch.setattr("mjris.learn.stack.AVAILABLE", False)
    agents = toy_agents(3, network=network)
    for agent in agents:
        agent.learn(30)
    observations = np.random.default_rng(0).normal(size=(3, 2)).astype(np.float32)
    stack = StackedDDPG(agents)
    alone = [agent.predict(row)[0] for agent, row in zip(agents, observations, strict=True)]
    np.testing.assert_allclose(stack.act(observations), alone, atol=1e-6)
    # Environments whose spaces are of double precision, or rows of a larger array.
    np.testing.assert_allclose(stack.act(observations.astype(np.float64)), alone, atol=1e-6)
    np.testing.assert_allclose(stack.act(np.repeat(observations, 2, 1)[:, ::2]), alone, atol=1e-6)


@pytest.mark.parametrize("network", ["mlp", "paper"])
def test_every_tensor_of_a_step_is_made_on_the_device_of_the_stack(network: str, monkeypatch: pytest.MonkeyPatch):
    agents, rng = toy_agents(2, network=network, caution=0.0 if network == "paper" else 0.5), np.random.default_rng(0)
    # Only on the CPU are agents updated one by one.
    monkeypatch.setattr("mjris.learn.stack.AVAILABLE", False)
    stack, memory = StackedDDPG(agents, "cpu"), ReplayMemory(agents, 20, 10, "cpu")
    following = np.zeros((2, 2), np.float32)
    # Where a tensor would be made that is told no device, and could not be used beside the others.
    with torch.device("meta"):
        for slot in range(12):
            observations, actions, following = rng.normal(size=(3, 2, 2)).astype(np.float32)
            memory.add(observations, actions, rng.normal(size=2), np.array([False, slot == 9]), following, slot == 9)
        stack.update(memory.batch(rng.integers(0, 12, (2, 32))))
        losses, acted = stack.losses(), stack.act(following)
    assert np.isfinite(losses).all()
    assert np.isfinite(acted).all()
    assert {tensor.device.type for tensor in stack.state(0).values()} == {"cpu"}


def test_the_memory_gives_what_was_added_over_ends_of_episodes_and_of_the_ring():
    agents, rng = toy_agents(2, buffer_size=15), np.random.default_rng(0)
    memory, added = ReplayMemory(agents, 60, 10, "cpu"), []
    observations = rng.normal(size=(2, 2)).astype(np.float32)
    for slot in range(47):
        actions, following = rng.normal(size=(2, 2, 2)).astype(np.float32)
        rewards, last = rng.normal(size=2).astype(np.float32), slot % 10 == 9
        terminated = np.array([last, slot == 29])
        memory.add(observations, actions, rewards, terminated, following, last)
        added.append((observations, actions, rewards[:, None], ~terminated[:, None], following))
        observations = rng.normal(size=(2, 2)).astype(np.float32) if last else following
        oldest = max(0, slot - 14)
        kept = np.tile(np.arange(oldest, slot + 1), (2, 1))
        batch = memory.batch(kept % 15).picked()
        parts = batch.observations, batch.actions, batch.rewards, batch.goes_on, batch.next_observations
        for part, expected in zip(parts, zip(*added[oldest:], strict=True), strict=True):
            np.testing.assert_array_equal(part.numpy(), np.stack(expected, 1))


def test_minibatches_are_the_same_on_any_device():
    rng = np.random.default_rng(0)
    memory = rng.normal(size=(3, 20, 7)).astype(np.float32)
    batch = Batch(torch.from_numpy(memory), *rng.integers(0, 20, (2, 3, 7)), width=3)
    with torch.device("meta"):  # where a tensor would be made that is told no device
        picked = batch.picked()
    for agent in range(3):
        seen, pairs, rewards, goes_on = (np.empty(shape, np.float32) for shape in ((7, 3), (7, 5), 7, 7))
        _recall(memory[agent], batch.following[agent], seen, pairs)
        np.testing.assert_array_equal(picked.next_pairs[agent].numpy(), pairs)
        _recall(memory[agent], batch.places[agent], seen, pairs)
        _recall_outcomes(memory[agent], batch.places[agent], rewards, goes_on)
        np.testing.assert_array_equal(picked.observations[agent].numpy(), seen)
        np.testing.assert_array_equal(picked.pairs[agent].numpy(), pairs)
        np.testing.assert_array_equal(picked.rewards[agent, :, 0].numpy(), rewards)
        np.testing.assert_array_equal(picked.goes_on[agent, :, 0].numpy(), goes_on)


def test_what_has_no_stacked_form_is_refused():
    with pytest.raises(TypeError, match="Dropout has no stacked form"):
        StackedNetwork([nn.Sequential(nn.Linear(2, 2), nn.Dropout()) for _ in range(2)])
    with pytest.raises(TypeError, match="TD3 with these settings has no stacked form"):
        StackedDDPG([TD3("MlpPolicy", ToyEnv(toy_config()))])  # type: ignore
    ahead, behind = toy_agents(2)
    ahead.learn(30)
    with pytest.raises(ValueError, match="equally many steps on"):
        StackedDDPG([ahead, behind])


def rounds(cells, number: int = 3) -> list:
    results, merged = [], None
    for round_ in range(1, number + 1):
        results.append(cells.train(round_, merged))
        merged = average([state for state, _ in results[-1]])
    cells.close()
    return results


def assert_same_run(stacked: list, plain: list, atol: float, ignore: Sequence[str] = ()) -> None:
    for ours, theirs in zip(stacked, plain, strict=True):
        for (state, metrics), (expected, rows) in zip(ours, theirs, strict=True):
            assert_close(state, expected, atol, ignore)
            for row, other in zip(metrics, rows, strict=True):
                assert (row.round, row.episode, row.cell) == (other.round, other.episode, other.cell)
                assert row.qos_share == other.qos_share
                assert row.collisions == other.collisions
                for name in ("reward", "sum_rate_mbps", "bare_rate_mbps", "clearance_m"):
                    assert getattr(row, name) == pytest.approx(getattr(other, name), abs=atol)


@pytest.mark.parametrize("first_weights", ["own", "common"])
@pytest.mark.parametrize("agent", [{}, {"warmup_slots": 25}, {"buffer_size": 15}])
def test_a_short_run_agrees_with_cells_one_by_one(agent: dict, first_weights: str):
    config = toy_config(agent=agent, num_cells=3, first_weights=first_weights)
    stacked = rounds(StackedCells(config, ToyEnv, None))
    assert_same_run(stacked, rounds(LocalCells(config, range(3), ToyEnv, None)), 1e-5)


@pytest.mark.parametrize("one_by_one", [True, False])
def test_a_true_end_of_an_episode_counts_in_a_stack_as_it_does_one_by_one(one_by_one: bool, monkeypatch):
    if not one_by_one:
        monkeypatch.setattr("mjris.learn.stack.AVAILABLE", False)
    config = toy_config(num_cells=3, episodes=8)
    ending = rounds(StackedCells(config, EndingToyEnv, None), 4)
    assert_same_run(ending, rounds(LocalCells(config, range(3), EndingToyEnv, None), 4), 1e-5)
    limited = rounds(StackedCells(config, ToyEnv, None), 4)
    key = "critic.qf0.2.bias"
    assert not torch.allclose(ending[-1][0][0][key], limited[-1][0][0][key], atol=1e-3)


def test_a_short_run_of_the_papers_agents_agrees():
    config = toy_config(agent={"network": "paper", "learning_rate": 3e-4, "target_rate": 0.002})
    stacked = rounds(StackedCells(config, ToyEnv, None))
    assert_same_run(stacked, rounds(LocalCells(config, range(2), ToyEnv, None)), 2e-3)


def office_config(**changes) -> Config:
    office = preset("classic")
    federation = {"num_cells": 2, "episodes": 2, "round_episodes": 1} | changes
    return replace(
        office,
        seed=0,
        # A mobile rover may drive another way round for a rounding error.
        task=replace(office.task, slots=12, ris="fixed"),
        agent=replace(office.agent, hidden=(16,), batch_size=8, warmup_slots=4),
        federation=replace(office.federation, **federation),
    )


def test_a_short_run_in_the_office_agrees():
    config = office_config()
    stacked = rounds(StackedCells(config, OfficeEnv, None), 2)
    assert_same_run(stacked, rounds(LocalCells(config, range(2), OfficeEnv, None), 2), 1e-5)


def test_stacks_in_several_processes_train_as_one(tmp_path: Path):
    configs = [replace(office_config(num_cells=2, episodes=2), seed=seed) for seed in (0, 1)]
    together, apart = StackedRuns(configs, OfficeEnv, [None, None]), SpreadRuns(configs, OfficeEnv, [None, None], 2)
    params: list = [None, None]
    for round_ in (1, 2):
        ours, theirs = (runs.train(round_, params) for runs in (apart, together))
        for own, expected in zip(ours, theirs, strict=True):
            assert_same_run([own], [expected], 1e-5)
        params = [average([state for state, _ in results]) for results in theirs]
    for name, runs in (("together", together), ("apart", apart)):
        (tmp_path / name).mkdir()
        runs.save(1, tmp_path / name, params[1])
        runs.close()
    for u in (0, 1):
        saved = [DDPG.load(tmp_path / name / f"cell_{u}.zip") for name in ("together", "apart")]
        left, right = (dict(agent.policy.state_dict()) for agent in saved)
        assert_close(left, right, 1e-6)
        moments = [list(agent.actor.optimizer.state_dict()["state"].values()) for agent in saved]
        for own, expected in zip(*moments, strict=True):
            assert_close(own, expected, 1e-5)


@pytest.mark.parametrize(
    ("cells", "workers", "cores", "make_env", "device", "stacks"),
    [
        (4, 0, 2, OfficeEnv, "cpu", 2),
        (3, 0, 64, OfficeEnv, "cpu", 3),
        (16, 3, 64, OfficeEnv, "cpu", 3),
        (16, 0, 64, ToyEnv, "cpu", 1),
        (16, 0, 64, OfficeEnv, "cuda", 1),
    ],
)
def test_there_is_a_stack_for_every_core(cells: int, workers: int, cores: int, make_env, device: str, stacks: int):
    assert num_stacks([office_config(num_cells=cells, workers=workers)], make_env, device, cores) == stacks


@pytest.mark.parametrize("make_env", [ToyEnv, EndingToyEnv])
def test_an_agent_taken_out_remembers_and_continues_as_its_cell_does(make_env):
    config = toy_config(num_cells=2)
    runs = StackedRuns([config], make_env, [None])
    cells = [Cell(config, u, make_env) for u in (0, 1)]
    results = [cell.train(1, None) for cell in cells]
    runs.train(1, [None])
    agent, theirs = runs.agent(0, 1), cells[1]._agent
    buffer, expected = agent.replay_buffer, theirs.replay_buffer
    assert buffer is not None
    assert expected is not None
    assert (buffer.pos, buffer.full, agent.num_timesteps) == (expected.pos, expected.full, theirs.num_timesteps)
    assert (agent._n_updates, agent._episode_num) == (theirs._n_updates, theirs._episode_num)
    for name in ("observations", "actions", "rewards", "next_observations", "dones", "timeouts"):
        np.testing.assert_allclose(getattr(buffer, name), getattr(expected, name), atol=1e-5)
    # Its own second round, noise decay and all: beside the stack, and without touching it.
    alone = Cell(config, 1, make_env)
    alone._agent = agent
    merged = average([state for state, _ in results])
    expected_states = [cell.train(2, merged)[0] for cell in cells]
    assert_close(alone._train(2, merged)[0], expected_states[1], 1e-5)
    stacked = runs.train(2, [merged])[0]
    for (state, _), expected_state in zip(stacked, expected_states, strict=True):
        assert_close(state, expected_state, 1e-5)


def test_saved_agents_load_and_hold_what_a_cell_saves(tmp_path: Path):
    config = toy_config()
    merged = None
    for folder, cells in (
        ("ours", StackedCells(config, ToyEnv, None)),
        ("theirs", LocalCells(config, range(2), ToyEnv, None)),
    ):
        merged = average([state for state, _ in cells.train(1, None)])
        (tmp_path / folder).mkdir()
        cells.save(tmp_path / folder, merged)
    for u in (0, 1):
        ours, theirs = [DDPG.load(tmp_path / folder / f"cell_{u}.zip") for folder in ("ours", "theirs")]
        assert_close(dict(ours.policy.state_dict()), dict(theirs.policy.state_dict()), 1e-5)
        for name in ("actor", "critic"):
            moments = [getattr(agent, name).optimizer.state_dict()["state"] for agent in (ours, theirs)]
            for number, entries in moments[1].items():
                assert_close(moments[0][number], entries, 1e-5)
        assert isinstance(ours.action_noise, DecayingOUNoise)
        assert (ours.num_timesteps, theirs.num_timesteps) == (20, 20)
        assert ours.action_noise.scale == pytest.approx(0.4 * (1 - 20 / 50))


def states(run_dir: Path) -> list[dict[str, torch.Tensor]]:
    return [dict(load_policy(run_dir, u, make_env=ToyEnv).policy.state_dict()) for u in (0, 1)]


def test_seeds_and_rates_in_one_stack_are_the_runs_that_they_are_alone(tmp_path: Path):
    rates = ((0, 1e-3), (1, 1e-3), (2, 3e-4))
    configs = [toy_config(seed=seed, agent={"learning_rate": rate}) for seed, rate in rates]
    together, alone = ([tmp_path / name / str(seed) for seed in (0, 1, 2)] for name in ("together", "alone"))
    reports = []
    train_many(configs, together, report=reports.append, make_env=ToyEnv)
    assert [len(rows) for rows in reports] == [12, 12, 6]
    merged = []
    for config, ours, theirs in zip(configs, together, alone, strict=True):
        train(config, theirs, make_env=ToyEnv)  # cell by cell
        files = [sorted(str(path.relative_to(run)) for path in run.glob("**/*")) for run in (ours, theirs)]
        assert [name for name in files[0] if "events" not in name] == [
            name for name in files[1] if "events" not in name
        ]
        assert len(files[0]) == len(files[1])
        assert (ours / "config.json").read_text() == (theirs / "config.json").read_text()
        tables = [pd.read_csv(run / "metrics.csv") for run in (ours, theirs)]
        pd.testing.assert_frame_equal(tables[0], tables[1], atol=1e-5, rtol=0)
        for state, expected in zip(states(ours), states(theirs), strict=True):
            assert_close(state, expected, 1e-5)
        merged.append(states(ours)[0])
        assert_close(states(ours)[1], merged[-1], 0)  # the last average, in every cell
    assert not torch.allclose(merged[0]["actor.mu.0.weight"], merged[1]["actor.mu.0.weight"], atol=1e-2)


def test_runs_without_a_common_stack_are_refused(tmp_path: Path):
    config = toy_config()
    others = [
        (toy_config(agent={"batch_size": 16}), "same agent and federation"),
        (toy_config(num_cells=3), "same agent and federation"),
        (replace(config, task=replace(config.task, slots=7)), r"task\.slots: 7 is not allowed"),
    ]
    for other, message in others:
        with pytest.raises(ConfigError, match=message):
            train_many([config, other], [tmp_path / "a", tmp_path / "b"], make_env=ToyEnv)
    with pytest.raises(ConfigError, match="2 runs need a folder each"):
        train_many([config, config], [tmp_path / "a", tmp_path / "a"], make_env=ToyEnv)
    assert not list(tmp_path.iterdir())


def test_a_device_that_is_of_no_use_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for backend_, message in (("stacked", "torch finds none here"), ("processes", "only a stack of agents")):
        with pytest.raises(ConfigError, match=f"device: 'cuda' is not allowed: {message}"):
            train(toy_config(backend=backend_), tmp_path / "run", make_env=ToyEnv, device="cuda")
    assert not list(tmp_path.iterdir())


class ShortEnv(ToyEnv):
    def step(self, action):
        observation, reward, terminated, _, info = super().step(action)
        return observation, reward, terminated, self._slot == 5, info


def test_failures_in_a_stack_reach_the_caller():
    with pytest.raises(ValueError, match="every episode of a stack must have 10 slots"):
        StackedCells(toy_config(), ShortEnv, None).train(1, None)
    cells = StackedCells(toy_config(), BrokenToyEnv, None)
    with pytest.raises(ArithmeticError, match="the floor gave way"):
        cells.train(1, None)
    with pytest.raises(ValueError, match="round 1 is out of order after round 1"):
        cells.train(1, None)


@pytest.mark.parametrize(
    ("asked", "cells", "cores", "make_env", "chosen"),
    [
        ("auto", 16, 2, OfficeEnv, "stacked"),
        ("auto", 16, 64, OfficeEnv, "stacked"),
        ("auto", 16, 2, ToyEnv, "processes"),
        ("stacked", 16, 64, ToyEnv, "stacked"),
        ("processes", 16, 2, OfficeEnv, "processes"),
    ],
)
def test_the_faster_backend_is_picked_unless_one_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, asked: str, cells: int, cores: int, make_env, chosen: str
):
    monkeypatch.setattr("mjris.learn.workers.CORES", cores)
    assert backend(office_config(num_cells=cells, backend=asked), make_env) == chosen


def test_it_is_said_and_opened(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("mjris.learn.workers.CORES", 2)
    assert describe(office_config()) == "2 cells learn as 2 stacks, one in each worker process"
    assert describe(office_config(workers=1)) == "2 cells learn as one stack in this process"
    assert describe(office_config(), "cuda") == "2 cells learn as one stack in this process"
    assert describe(office_config(backend="processes")) == "2 cells learn in 2 worker processes"
    assert (
        describe(office_config(backend="processes", workers=1)) == "2 cells learn one after the other in this process"
    )
    assert isinstance(open_cells(toy_config(backend="stacked"), ToyEnv), StackedCells)
    cells = open_cells(toy_config(backend="processes", workers=2), ToyEnv)
    assert isinstance(cells, WorkerCells)
    cells.close()
