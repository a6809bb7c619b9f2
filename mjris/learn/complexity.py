"""Operations of the agents: the paper's count, and what torch counts for the same networks.

python -m mjris.learn.complexity prints both for the presets.
"""

from dataclasses import dataclass

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from stable_baselines3 import DDPG
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from mjris.config import Config, preset
from mjris.envs.gym_env import OfficeEnv
from mjris.learn.agent import build_agent
from mjris.learn.federation import num_rounds

_NORMALISED, _RELU, _TANH = 5, 1, 6
"""Operations of a node by its kind (paper, section V-D)."""


@dataclass(frozen=True)
class Operations:
    """The paper's counts (section V-D; it gives them no labels)."""

    actor: int
    """ζ_{ω^Q}, one choice of an action."""
    critic: int
    """ζ_{ω^μ}, values of a minibatch of e transitions."""
    cell: int
    """ζ^u, all slots of all episodes in one cell."""
    averaging: int
    """ζ^G, sending and loading the parameters of actor and critic in every round."""
    total: int
    """ζ, all cells."""


@dataclass(frozen=True)
class Flops:
    """Floating-point operations of the forward passes: torch counts two for each weight, and nothing else."""

    actor: int
    """One choice of an action."""
    critic: int
    """Values of a minibatch."""


def network_operations(network: nn.Module) -> int:
    """Operations for one sample, 5 n + r + 6 t + Σ_i |ω_i| |ω_{i+1}|, of a network made of layers.

    n, r and t are its normalised, ReLU and tanh nodes, and the sum goes over its linear layers.
    """
    operations, width = 0, 0
    for layer in network.children():
        if isinstance(layer, nn.Linear):
            width = layer.out_features
            operations += layer.in_features * width
        elif isinstance(layer, nn.BatchNorm1d):
            operations += _NORMALISED * layer.num_features
        elif isinstance(layer, nn.ReLU):
            operations += _RELU * width
        elif isinstance(layer, nn.Tanh):
            operations += _TANH * width
        else:
            raise TypeError(f"network: {type(layer).__name__} is not a layer that the paper counts")
    return operations


def paper_operations(agent: DDPG, config: Config) -> Operations:
    """The paper's counts for a run of `config` with agents like this one."""
    actor, critic = _networks(agent)
    choice = network_operations(actor)
    judgement = agent.batch_size * network_operations(critic)
    federation = config.federation
    cell = federation.episodes * config.task.slots * (choice + judgement)
    parameters = sum(weights.numel() for network in (actor, critic) for weights in network.parameters())
    averaging = 2 * num_rounds(config) * parameters
    return Operations(choice, judgement, cell, averaging, averaging + federation.num_cells * cell)


def measured_flops(agent: DDPG) -> Flops:
    """What torch's counter sees in the forward passes that the paper counts."""
    actor, critic = _networks(agent)
    agent.policy.set_training_mode(False)  # a batch of one has no statistics
    return Flops(_forward_flops(actor, 1), _forward_flops(critic, agent.batch_size))


def _networks(agent: DDPG) -> tuple[nn.Module, nn.Module]:
    """Actor and critic."""
    return agent.actor.mu, agent.critic.q_networks[0]


def _forward_flops(network: nn.Module, samples: int) -> int:
    inputs = next(layer.in_features for layer in network.children() if isinstance(layer, nn.Linear))
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        network(torch.zeros(samples, inputs))
    return counter.get_total_flops()


def main() -> None:
    """Print both counts for the presets."""
    table = Table("preset", "network", "paper's count", "torch", "a run, one cell", "averaging", "a run, all cells")
    for column in table.columns[2:]:
        column.justify = "right"
    for name in ("paper", "office"):
        config = preset(name)
        agent = build_agent(config, OfficeEnv(config), np.random.default_rng())
        paper, torch_ = paper_operations(agent, config), measured_flops(agent)
        run = [f"{count:.3g}" for count in (paper.cell, paper.averaging, paper.total)]
        table.add_row(name, "actor, 1 sample", f"{paper.actor:,}", f"{torch_.actor:,}", *run)
        table.add_row("", f"critic, {agent.batch_size} samples", f"{paper.critic:,}", f"{torch_.critic:,}")
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
