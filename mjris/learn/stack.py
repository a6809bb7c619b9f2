"""Agents of equal shapes as one: their networks, optimizers and updates with a leading axis of agents."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import torch
from stable_baselines3 import DDPG
from torch import Tensor, nn
from torch.nn import functional

# The networks of an agent that `State` holds, and how each names its sequences of layers.
_ACTORS, _CRITICS = ("actor", "actor_target"), ("critic", "critic_target")


class Batch(NamedTuple):
    """Minibatches of A agents, B transitions each; no episode of mjris ends but by truncation."""

    observations: Tensor
    """[A, B, D]"""
    actions: Tensor
    """[A, B, n]"""
    rewards: Tensor
    """[A, B, 1]"""
    next_observations: Tensor
    """[A, B, D]"""


class StackedLinear(nn.Module):
    """A linear layers, [A, B, in] → [A, B, out]."""

    def __init__(self, layers: Sequence[nn.Linear]):
        super().__init__()
        # In memory the inputs come first: then autograd's gradient has the same strides, and nothing is copied.
        self.weight = nn.Parameter(torch.stack([layer.weight.detach().T for layer in layers]).mT)
        self.bias = nn.Parameter(torch.stack([layer.bias.detach() for layer in layers]))

    def forward(self, inputs: Tensor) -> Tensor:
        """Every agent's rows through its own layer."""
        return torch.baddbmm(self.bias[:, None], inputs, self.weight.mT)


class StackedBatchNorm(nn.Module):
    """A batch norms, each with statistics of its own, [A, B, D] → [A, B, D]."""

    running_mean: Tensor
    running_var: Tensor
    num_batches_tracked: Tensor

    def __init__(self, layers: Sequence[nn.BatchNorm1d]):
        super().__init__()
        self.weight = nn.Parameter(torch.stack([layer.weight.detach() for layer in layers]))
        self.bias = nn.Parameter(torch.stack([layer.bias.detach() for layer in layers]))
        for name, _ in layers[0].named_buffers():
            self.register_buffer(name, torch.stack([getattr(layer, name) for layer in layers]))
        self._momentum, self._eps = layers[0].momentum, layers[0].eps

    def forward(self, inputs: Tensor) -> Tensor:
        """Normalised by each agent's minibatch in training mode, by its running statistics otherwise."""
        if not self.training:
            scale = self.weight * torch.rsqrt(self.running_var + self._eps)
            return torch.addcmul((self.bias - self.running_mean * scale)[:, None], inputs, scale[:, None])
        agents, rows, features = inputs.shape
        self.num_batches_tracked += 1
        # One batch norm of A·D features is A batch norms of D.
        together = functional.batch_norm(
            inputs.transpose(0, 1).reshape(rows, agents * features),
            self.running_mean.view(-1),
            self.running_var.view(-1),
            self.weight.view(-1),
            self.bias.view(-1),
            True,
            self._momentum,
            self._eps,
        )
        return together.view(rows, agents, features).transpose(0, 1)


def stack_layers(networks: Sequence[nn.Module]) -> nn.Module:
    """One network [A, B, in] → [A, B, out] for A sequential ones of equal shapes; entries keep their names.

    Raises `TypeError` for a layer that has no stacked form.
    """
    first = networks[0]
    if isinstance(first, nn.Sequential):
        columns = zip(*(network.children() for network in networks), strict=True)
        return nn.Sequential(*(stack_layers(column) for column in columns))
    if isinstance(first, nn.Linear):
        return StackedLinear(cast(Sequence[nn.Linear], networks))
    if isinstance(first, nn.BatchNorm1d):
        return StackedBatchNorm(cast(Sequence[nn.BatchNorm1d], networks))
    if isinstance(first, nn.ReLU | nn.Tanh):
        return first
    raise TypeError(f"network: {type(first).__name__} has no stacked form")


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
            **{name: {"mu": stack_layers([getattr(agent, name).mu for agent in agents])} for name in _ACTORS},
            **{name: {"qf0": stack_layers([getattr(agent, name).qf0 for agent in agents])} for name in _CRITICS},
        }
        self._policy = nn.ModuleDict({name: nn.ModuleDict(parts) for name, parts in networks.items()}).to(device)
        self._policy.eval()
        self._actor, self._actor_target = (self._network(name, "mu") for name in _ACTORS)
        self._critic, self._critic_target = (self._network(name, "qf0") for name in _CRITICS)
        self._discount, self._target_rate = first.gamma, first.tau
        self._optimizers = {
            name: _stack_optimizers([getattr(agent, name).optimizer for agent in agents], self._policy[name])
            for name in ("actor", "critic")
        }
        for target in (self._actor_target, self._critic_target):
            target.requires_grad_(False)
        self._device = device

    def _network(self, name: str, part: str) -> nn.Module:
        return cast(nn.ModuleDict, self._policy[name])[part]

    @torch.no_grad()
    def act(self, observations: Tensor) -> Tensor:
        """Actions [A, n] without noise for observations [A, D]."""
        return self._actor(observations.to(self._device)[:, None])[:, 0].cpu()

    def update(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """One gradient step of every agent, as in SB3's `DDPG.train`: losses of the actors and of the critics [A]."""
        with torch.no_grad():
            next_actions = self._actor_target(batch.next_observations)
            next_values = self._critic_target(torch.cat([batch.next_observations, next_actions], -1))
            goals = batch.rewards + self._discount * next_values
        self._policy.train()
        values = self._critic(torch.cat([batch.observations, batch.actions], -1))
        critic_losses = (values - goals).square().mean((1, 2))
        self._descend("critic", critic_losses)
        actions = self._actor(batch.observations)
        self._policy.eval()  # the actors are judged with the running statistics, see `PaperCritic`
        actor_losses = -self._critic(torch.cat([batch.observations, actions], -1)).mean((1, 2))
        self._descend("actor", actor_losses)
        self._move_targets()
        return actor_losses.detach(), critic_losses.detach()

    def _descend(self, name: str, losses: Tensor) -> None:
        """One optimizer step; the gradient of the sum over agents is each agent's own."""
        optimizer = self._optimizers[name]
        optimizer.zero_grad()
        losses.sum().backward(inputs=optimizer.param_groups[0]["params"])
        optimizer.step()

    @torch.no_grad()
    def _move_targets(self) -> None:
        for network, target in ((self._actor, self._actor_target), (self._critic, self._critic_target)):
            torch._foreach_lerp_(list(target.parameters()), list(network.parameters()), self._target_rate)
            # SB3 copies the running statistics and leaves the count of batches as it is.
            for (name, own), followed in zip(network.named_buffers(), target.buffers(), strict=True):
                if not name.endswith("num_batches_tracked"):
                    followed.copy_(own)

    def state(self, agent: int) -> dict[str, Tensor]:
        """A copy of what SB3's policy of an agent holds, by the same names."""
        return {name: _own(tensor[agent]) for name, tensor in self._policy.state_dict().items()}

    @torch.no_grad()
    def load(self, agents: slice, state: Mapping[str, Tensor]) -> None:
        """Give some agents the same parameters and statistics."""
        for name, tensor in self._policy.state_dict().items():
            tensor[agents] = state[name].to(self._device)

    def store(self, index: int, agent: DDPG) -> None:
        """Write parameters, statistics and optimizer state of one agent back to it."""
        agent.policy.load_state_dict(self.state(index))
        for name, optimizer in self._optimizers.items():
            theirs = getattr(agent, name).optimizer
            state = {
                number: {key: _own(value if key == "step" else value[index]) for key, value in entries.items()}
                for number, entries in optimizer.state_dict()["state"].items()
            }
            theirs.load_state_dict({"state": state, "param_groups": theirs.state_dict()["param_groups"]})


def _own(tensor: Tensor) -> Tensor:
    """A contiguous copy on the CPU."""
    return tensor.detach().to("cpu", copy=True, memory_format=torch.contiguous_format)


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
    for number, parameter in enumerate(network.parameters()):
        if number in theirs[0]:
            state[number] = {"step": theirs[0][number]["step"].clone()}
            for key in theirs[0][number].keys() - {"step"}:
                # With the parameter's strides: the fused optimizers run through memory.
                moments = torch.stack([entries[number][key] for entries in theirs])
                state[number][key] = torch.empty_like(parameter, requires_grad=False).copy_(moments)
    stacked.load_state_dict({"state": state, "param_groups": stacked.state_dict()["param_groups"]})
    return stacked
