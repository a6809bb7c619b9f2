"""Agents of equal shapes as one: their networks, optimizers and updates with a leading axis of agents."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate, pairwise
from typing import cast

import torch
from stable_baselines3 import DDPG
from torch import Tensor, nn

from mjris.learn.agent import CautiousCritic
from mjris.learn.layers import StackedNetwork, stack_networks
from mjris.learn.replay import Batch

CORES = torch.get_num_threads()
"""As the machine or OMP_NUM_THREADS says, before anyone sets it."""
_MOST_LANES = 4  # lanes share one interpreter

# The networks of an agent that `State` holds, and how each names its sequences of layers.
_ACTORS, _CRITICS = ("actor", "actor_target"), ("critic", "critic_target")


class StackedDDPG:
    """SB3 DDPG agents of equal shapes and settings, trained together from where each of them is.

    Every agent keeps weights, statistics and optimizer state of its own. The agents themselves are not touched until
    `store` writes all of it back.
    """

    def __init__(self, agents: Sequence[DDPG], device: str = "cpu"):
        first = agents[0]
        if first.policy_delay != 1 or first.critic.n_critics != 1 or first.target_noise_clip != 0:
            raise TypeError(f"agent: {type(first).__name__} with these settings has no stacked form")
        networks = {
            **{name: {"mu": stack_networks([getattr(agent, name).mu for agent in agents])} for name in _ACTORS},
            **{name: {"qf0": stack_networks([getattr(agent, name).qf0 for agent in agents])} for name in _CRITICS},
        }
        self._policy = nn.ModuleDict({name: nn.ModuleDict(parts) for name, parts in networks.items()}).to(device)
        self._actor, self._actor_target = (self._network(name, "mu") for name in _ACTORS)
        self._critic, self._critic_target = (self._network(name, "qf0") for name in _CRITICS)
        self._discount, self._target_rate = first.gamma, first.tau
        self._caution = first.critic.caution if isinstance(first.critic, CautiousCritic) else 0.0
        self._optimizers = {
            name: _stack_optimizers([getattr(agent, name).optimizer for agent in agents], self._policy[name])
            for name in ("actor", "critic")
        }
        self._device = device

    def _network(self, name: str, part: str) -> StackedNetwork:
        return cast(StackedNetwork, cast(nn.ModuleDict, self._policy[name])[part])

    @torch.no_grad()
    def act(self, observations: Tensor) -> Tensor:
        """Actions [A, n] without noise for observations [A, D]."""
        return self._actor(observations.to(self._device)[:, None])[:, 0].cpu()

    @torch.no_grad()
    def update(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """One gradient step of every agent, as in SB3's `DDPG.train`: losses of the actors and of the critics [A]."""
        next_actions = self._actor_target(batch.next_observations)
        next_values = self._critic_target(torch.cat([batch.next_observations, next_actions], -1))
        errors = self._critic(torch.cat([batch.observations, batch.actions], -1), training=True)
        errors -= batch.rewards + self._discount * next_values
        rows = errors.shape[1]
        self._critic.backward(errors * (2 / rows), learn=True)
        self._optimizers["critic"].step()

        actions = self._actor(batch.observations, training=True)
        actor_losses, gradient = self._judge(batch.observations, actions)
        self._actor.backward(gradient, learn=True)
        self._optimizers["actor"].step()
        self._move_targets()
        return actor_losses, errors.square().mean((1, 2))

    def _judge(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """The actors' losses [A] for actions [A, B, n], and the gradient in the actions.

        With the critics' running statistics, see `PaperCritic`, or with their caution, see `CautiousCritic`.
        """
        rows, size = actions.shape[1:]
        values = self._critic(torch.cat([observations, actions], -1))
        scale = 1 / values.abs().mean((1, 2), keepdim=True) if self._caution else torch.ones_like(values[:, :1])
        through = cast(Tensor, self._critic.backward((-scale / rows).repeat(1, rows, 1), learn=False))
        losses = self._caution * actions.square().mean((1, 2)) - (scale * values).mean((1, 2))
        return losses, through[..., -size:] + actions * (2 * self._caution / (rows * size))

    def _move_targets(self) -> None:
        for network, target in ((self._actor, self._actor_target), (self._critic, self._critic_target)):
            for own, followed in zip(network.parameters(), target.parameters(), strict=True):
                followed.lerp_(own, self._target_rate)
            # SB3 copies the running statistics and leaves the count of batches as it is.
            for (name, own), followed in zip(network.named_buffers(), target.buffers(), strict=True):
                if not name.endswith("num_batches_tracked"):
                    followed.copy_(own)

    def state(self, agent: int) -> dict[str, Tensor]:
        """A copy of what SB3's policy of an agent holds, by the same names."""
        return {name: _single(tensor, agent) for name, tensor in self._policy.state_dict().items()}

    @torch.no_grad()
    def load(self, agent: int, state: Mapping[str, Tensor]) -> None:
        """Give an agent these parameters and statistics."""
        for name, tensor in self._policy.state_dict().items():
            tensor[agent] = _turned(state[name].to(self._device))

    def store(self, index: int, agent: DDPG) -> None:
        """Write parameters, statistics and optimizer state of one agent back to it."""
        agent.policy.load_state_dict(self.state(index))
        for name, optimizer in self._optimizers.items():
            theirs = getattr(agent, name).optimizer
            state = {
                number: {
                    key: value.clone() if key == "step" else _single(value, index) for key, value in entries.items()
                }
                for number, entries in optimizer.state_dict()["state"].items()
            }
            theirs.load_state_dict({"state": state, "param_groups": theirs.state_dict()["param_groups"]})


class Lanes:
    """A stack in parts, each updated in a thread of its own, or whole where there is one lane.

    The threads wait asleep. Those of torch's own operations spin: beside other work on the same cores they lose more
    than they gain.
    """

    def __init__(self, agents: Sequence[DDPG], device: str, lanes: int):
        sizes = [len(agents) // lanes + (lane < len(agents) % lanes) for lane in range(lanes)]
        starts = [0, *accumulate(sizes)]
        self._shares = [slice(start, stop) for start, stop in pairwise(starts)]
        self._stacks = [StackedDDPG(agents[share], device) for share in self._shares]
        self._places = [
            (stack, index) for stack, size in zip(self._stacks, sizes, strict=True) for index in range(size)
        ]
        self._threads = ThreadPoolExecutor(lanes)

    def act(self, observations: Tensor) -> Tensor:
        """`StackedDDPG.act`."""
        parts = zip(self._stacks, self._shares, strict=True)
        return torch.cat([stack.act(observations[share]) for stack, share in parts])

    def update(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """`StackedDDPG.update`."""
        if len(self._stacks) == 1:
            return self._stacks[0].update(batch)
        batches = [Batch(*(part[share] for part in batch)) for share in self._shares]
        actor, critic = zip(*self._threads.map(StackedDDPG.update, self._stacks, batches), strict=True)
        return torch.cat(actor), torch.cat(critic)

    def state(self, agent: int) -> dict[str, Tensor]:
        """`StackedDDPG.state`."""
        stack, index = self._places[agent]
        return stack.state(index)

    def load(self, agent: int, state: Mapping[str, Tensor]) -> None:
        """`StackedDDPG.load`."""
        stack, index = self._places[agent]
        stack.load(index, state)

    def store(self, agent: int, target: DDPG) -> None:
        """`StackedDDPG.store`."""
        stack, index = self._places[agent]
        stack.store(index, target)

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown()


def num_lanes(agents: int, device: str, cores: int) -> int:
    """One lane for each core, but two agents or more in each; one lane on other devices."""
    return min(cores, -(-agents // 2), _MOST_LANES) if device == "cpu" else 1


def _turned(tensor: Tensor) -> Tensor:
    """Weights [out, in] as a stack holds them, or the other way round; anything else as it is."""
    return tensor.T if tensor.ndim == 2 else tensor


def _single(stacked: Tensor, agent: int) -> Tensor:
    """A copy of one agent's part on the CPU, as SB3 holds it."""
    return _turned(stacked[agent]).to("cpu", copy=True, memory_format=torch.contiguous_format)


def _stack_optimizers(optimizers: Sequence[torch.optim.Optimizer], network: nn.Module) -> torch.optim.Optimizer:
    """One optimizer for a stacked network, from where those of the agents are.

    Raises `ValueError` where they are not equally many steps on.
    """
    first = optimizers[0]
    stacked = type(first)(network.parameters(), **first.defaults)
    theirs = [optimizer.state_dict()["state"] for optimizer in optimizers]
    if len({float(entries[0]["step"]) if entries else 0.0 for entries in theirs}) > 1:
        raise ValueError("optimizers: those of a stack must be equally many steps on")
    state = {}
    for number, entries in theirs[0].items():
        state[number] = {"step": entries["step"].clone()}
        for key in entries.keys() - {"step"}:
            state[number][key] = torch.stack([_turned(other[number][key]) for other in theirs])
    stacked.load_state_dict({"state": state, "param_groups": stacked.state_dict()["param_groups"]})
    return stacked
