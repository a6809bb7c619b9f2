import io
from contextlib import redirect_stdout

import numpy as np
import pytest
import torch
from stable_baselines3 import DDPG
from torch import nn
from toy import ToyEnv, toy_config

from mjris.config import Config
from mjris.learn import complexity
from mjris.learn.agent import build_agent
from mjris.learn.complexity import measured_flops, network_operations, paper_operations

# The toy's observation and action have two entries each; 4MN = 4 · 2 · 4 = 32 and half of it in the critic.
PAPER_ACTOR = 5 * (2 + 32) + 32 + 6 * 2 + (2 * 32 + 32 * 2)
PAPER_CRITIC = 5 * (4 + 16) + 16 + (4 * 16 + 16 * 1)


def toy(network: str) -> tuple[DDPG, Config]:
    config = toy_config(agent={"network": network, "hidden": (8, 4), "batch_size": 7}, num_cells=3)
    return build_agent(config, ToyEnv(config), np.random.default_rng(0)), config


def test_a_network_by_hand():
    network = nn.Sequential(
        nn.BatchNorm1d(3), nn.Linear(3, 5), nn.ReLU(), nn.BatchNorm1d(5), nn.Linear(5, 2), nn.Tanh()
    )
    assert network_operations(network) == 5 * (3 + 5) + 1 * 5 + 6 * 2 + 3 * 5 + 5 * 2
    assert network_operations(nn.Sequential(nn.Linear(3, 5, bias=False))) == 15


def test_other_layers_are_refused():
    with pytest.raises(TypeError, match="Sigmoid"):
        network_operations(nn.Sequential(nn.Linear(2, 2), nn.Sigmoid()))


def test_the_papers_agent_by_hand():
    agent, config = toy("paper")
    count = paper_operations(agent, config)
    assert (count.actor, count.critic) == (PAPER_ACTOR, 7 * PAPER_CRITIC)
    assert count.cell == 5 * 10 * (count.actor + count.critic)  # episodes, slots
    # Weights and biases of the linear layers and of the normalisation.
    actor = 2 * 2 + 2 * 32 + 32 + 2 * 32 + 32 * 2 + 2
    critic = 2 * 4 + 4 * 16 + 16 + 2 * 16 + 16 + 1
    assert count.averaging == 2 * 3 * (actor + critic)  # three rounds of 2, 2 and 1 episodes
    assert count.total == count.averaging + 3 * count.cell


def test_the_plain_agent_by_hand():
    agent, config = toy("mlp")
    count = paper_operations(agent, config)
    assert count.actor == 8 + 4 + 6 * 2 + (2 * 8 + 8 * 4 + 4 * 2)
    assert count.critic == 7 * (8 + 4 + (4 * 8 + 8 * 4 + 4 * 1))


def test_torch_counts_two_operations_a_weight():
    agent, _ = toy("paper")
    measured = measured_flops(agent)
    assert measured.actor == 2 * (2 * 32 + 32 * 2)
    assert measured.critic == 7 * 2 * (4 * 16 + 16 * 1)
    agent, _ = toy("mlp")
    assert measured_flops(agent).actor == 2 * (2 * 8 + 8 * 4 + 4 * 2)


def test_measuring_leaves_the_agent_as_it_was():
    agent, _ = toy("paper")
    agent.learn(30)
    before = {key: tensor.clone() for key, tensor in agent.policy.state_dict().items()}
    measured_flops(agent)
    assert all(torch.equal(before[key], tensor) for key, tensor in agent.policy.state_dict().items())


def test_the_table_has_both_presets():
    with redirect_stdout(io.StringIO()) as out:
        complexity.main()
    assert "critic, 64 samples" in out.getvalue()
    assert "critic, 128 samples" in out.getvalue()
