"""Agents of equal shapes as one: their networks, optimizers and updates with a leading axis of agents."""

from collections.abc import Mapping, Sequence
from itertools import groupby

import torch
from stable_baselines3 import DDPG
from torch import Tensor

from mjris.learn.agent import CautiousCritic
from mjris.learn.layers import StackedNetwork, flattened, turned
from mjris.learn.replay import Batch

# The networks of an agent that `State` holds, and how each names its sequence of layers.
_PARTS = {"actor": "mu", "actor_target": "mu", "critic": "qf0", "critic_target": "qf0"}


class StackedDDPG:
    """SB3 DDPG agents of equal shapes and settings, trained together from where each of them is.

    Every agent keeps weights, statistics and optimizer state of its own, and its learning rate. The agents themselves
    are not touched until `store` writes all of it back.
    """

    def __init__(self, agents: Sequence[DDPG], device: str = "cpu"):
        first = agents[0]
        if first.policy_delay != 1 or first.critic.n_critics != 1 or first.target_noise_clip != 0:
            raise TypeError(f"agent: {type(first).__name__} with these settings has no stacked form")
        self._networks = {
            name: StackedNetwork([getattr(getattr(agent, name), part) for agent in agents], device)
            for name, part in _PARTS.items()
        }
        self._actor, self._actor_target, self._critic, self._critic_target = self._networks.values()
        self._discount, self._target_rate = first.gamma, first.tau
        self._caution = first.critic.caution if isinstance(first.critic, CautiousCritic) else 0.0
        self._optimizers = {
            name: StackedAdam([getattr(agent, name).optimizer for agent in agents], self._networks[name])
            for name in ("actor", "critic")
        }
        self._device = device

    @torch.inference_mode()
    def act(self, observations: Tensor) -> Tensor:
        """Actions [A, n] without noise for observations [A, D]."""
        return self._actor.forward(observations.to(self._device)[:, None])[:, 0].cpu()

    @torch.inference_mode()
    def update(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """One gradient step of every agent, as in SB3's `DDPG.train`: losses of the actors and of the critics [A].

        Writes over the actions in the batch.
        """
        batch.next_actions.copy_(self._actor_target.forward(batch.next_observations))
        next_values = self._critic_target.forward(batch.next_pairs)
        errors = self._critic.forward(batch.pairs, training=True)
        errors -= batch.rewards + self._discount * next_values
        self._critic.learn(errors * (2 / errors.shape[1]))
        self._optimizers["critic"].step()

        batch.actions.copy_(self._actor.forward(batch.observations, training=True))
        actor_losses, gradient = self._judge(batch)
        self._actor.learn(gradient)
        self._optimizers["actor"].step()
        self._move_targets()
        return actor_losses, errors.square().mean((1, 2))

    def _judge(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """The actors' losses [A] for the actions in the batch, and the gradient in the actions.

        With the critics' running statistics, see `PaperCritic`, or with their caution, see `CautiousCritic`.
        """
        rows, size = batch.actions.shape[1:]
        values = self._critic.forward(batch.pairs)
        scale = 1 / values.abs().mean((1, 2), keepdim=True) if self._caution else torch.ones_like(values[:, :1])
        through = self._critic.through((-scale / rows).repeat(1, rows, 1), inputs=slice(-size, None))
        losses = -(scale * values).mean((1, 2))
        if self._caution:
            losses += self._caution * batch.actions.square().mean((1, 2))
            through += batch.actions * (2 * self._caution / (rows * size))
        return losses, through

    def _move_targets(self) -> None:
        for network, target in ((self._actor, self._actor_target), (self._critic, self._critic_target)):
            target.parameters.lerp_(network.parameters, self._target_rate)
            # SB3 copies the running statistics and leaves the count of batches as it is.
            for name, own in network.statistics.items():
                if not name.endswith("num_batches_tracked"):
                    target.statistics[name].copy_(own)

    def state(self, agent: int) -> dict[str, Tensor]:
        """A copy of what SB3's policy of an agent holds, by the same names."""
        return {name: _single(tensor[agent]) for name, tensor in self._state().items()}

    def load(self, agent: int, state: Mapping[str, Tensor]) -> None:
        """Give an agent these parameters and statistics."""
        for name, tensor in self._state().items():
            tensor[agent] = turned(state[name].to(self._device))

    def store(self, index: int, agent: DDPG) -> None:
        """Write parameters, statistics and optimizer state of one agent back to it."""
        agent.policy.load_state_dict(self.state(index))
        for name, optimizer in self._optimizers.items():
            optimizer.store(index, getattr(agent, name).optimizer)

    def _state(self) -> dict[str, Tensor]:
        return {
            f"{name}.{_PARTS[name]}.{key}": tensor
            for name, network in self._networks.items()
            for key, tensor in network.state.items()
        }


class StackedAdam:
    """The Adam optimizers of a stacked network's agents, each from where it is.

    Raises `ValueError` where they are not equally many steps on.
    """

    def __init__(self, optimizers: Sequence[torch.optim.Optimizer], network: StackedNetwork):
        self._split = network.split
        states = [list(optimizer.state_dict()["state"].values()) for optimizer in optimizers]
        steps = [float(entries[0]["step"]) if entries else 0.0 for entries in states]
        if len(set(steps)) > 1:
            raise ValueError("optimizers: those of a stack must be equally many steps on")
        self._moments = {key: torch.zeros_like(network.parameters) for key in ("exp_avg", "exp_avg_sq")}
        for key, moment in self._moments.items():
            for own, entries in zip(moment, states, strict=True):
                if entries:
                    own.copy_(flattened(entry[key] for entry in entries))
        self._steps = torch.tensor(steps[0], device=network.parameters.device)
        self._groups = []
        """Agents next to each other that have the same learning rate: what changes in a step, and the rate."""
        tensors = network.parameters, network.gradients, *self._moments.values()
        first = 0
        for rate, group in groupby(optimizer.param_groups[0]["lr"] for optimizer in optimizers):
            agents = slice(first, first := first + len(list(group)))
            self._groups.append(([[tensor[agents]] for tensor in tensors], rate))
        (self._beta1, self._beta2), self._eps = optimizers[0].defaults["betas"], optimizers[0].defaults["eps"]

    def step(self) -> None:
        """One step along the gradients of the network."""
        self._steps += 1
        for tensors, rate in self._groups:
            # What `torch.optim.Adam` calls in the end, which takes longer to get there than the step itself.
            torch.ops.aten._fused_adam_(
                *tensors,
                [],
                [self._steps],
                lr=rate,
                beta1=self._beta1,
                beta2=self._beta2,
                eps=self._eps,
                weight_decay=0.0,
                amsgrad=False,
                maximize=False,
            )

    def store(self, index: int, optimizer: torch.optim.Optimizer) -> None:
        """Write one agent's state back to its own optimizer."""
        moments = {key: self._split(moment[index]).values() for key, moment in self._moments.items()}
        state = {
            number: {"step": self._steps.to("cpu", copy=True)}
            | {key: _single(value) for key, value in zip(moments, values, strict=True)}
            for number, values in enumerate(zip(*moments.values(), strict=True))
        }
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _single(tensor: Tensor) -> Tensor:
    """A copy of one agent's part on the CPU, as SB3 holds it."""
    return turned(tensor).to("cpu", copy=True, memory_format=torch.contiguous_format)
