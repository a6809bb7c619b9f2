"""Agents of equal shapes as one: their networks, optimizers and updates with a leading axis of agents."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from torch import Tensor, nn

from mjris.learn.agent import CautiousCritic
from mjris.learn.descent import Learner, Room, Rule, act, descend, has_compiled_form
from mjris.learn.layers import StackedNetwork, turned
from mjris.learn.networks import Networks, Pass
from mjris.learn.products import AVAILABLE
from mjris.learn.replay import Batch, Picked

FloatArray = NDArray[np.floating]

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
        self._dtype = np.float64 if self._actor.parameters.dtype == torch.float64 else np.float32
        self._one_by_one = device == "cpu" and AVAILABLE and has_compiled_form(first)
        if self._one_by_one:
            self._descent = self._compiled(first)
            self._acting = self._descent[0].own, Pass.of(self._descent[0].own, 1)
        self._losses: FloatArray = np.full((2, len(agents)), np.nan)

    def act(self, observations: FloatArray) -> FloatArray:
        """Actions [A, n] without noise for observations [A, D]."""
        # Spaces may be of any precision; networks, and products of the compiled loops, are not.
        observations = np.ascontiguousarray(observations, self._dtype)
        if not self._one_by_one:
            return self._act_together(observations)
        actors, made = self._acting
        return act(actors, observations, made)

    def update(self, batch: Batch) -> None:
        """One gradient step of every agent, as in SB3's `DDPG.train`.

        On the CPU it is done agent by agent in compiled loops, where those know the networks' form.
        """
        if not self._one_by_one:
            self._update_together(batch.picked())
            return
        for network in (self._actor, self._critic):
            network.count_batch()
        steps = self._optimizers["actor"].count(), self._optimizers["critic"].count()
        descend(*self._descent, steps, batch.rows.numpy(), batch.places, batch.following, self._losses)

    def losses(self) -> FloatArray:
        """What the actors and the critics lost in the last update [2, A], as SB3 logs it."""
        return self._losses.copy() if self._one_by_one else self._judgement.losses()

    def finite(self) -> NDArray[np.bool_]:
        """Whether all parameters and statistics of an agent are finite numbers [A]."""
        return np.logical_and.reduce(
            [tensor.isfinite().reshape(len(tensor), -1).all(1).cpu().numpy() for tensor in self._state().values()]
        )

    @torch.inference_mode()
    def _act_together(self, observations: FloatArray) -> FloatArray:
        return self._actor.forward(torch.from_numpy(observations).to(self._device)[:, None])[:, 0].cpu().numpy()

    @torch.inference_mode()
    def _update_together(self, batch: Picked) -> None:
        batch.next_actions.copy_(self._actor_target.forward(batch.next_observations))
        next_values = self._critic_target.forward(batch.next_pairs)
        errors = self._critic.forward(batch.pairs, training=True)
        errors -= batch.rewards + self._discount * batch.goes_on * next_values
        self._critic.learn(errors * (2 / errors.shape[1]))
        self._optimizers["critic"].step()

        batch.actions.copy_(self._actor.forward(batch.observations, training=True))
        values = self._critic.forward(batch.pairs)
        scale = 1 / values.abs().mean((1, 2), keepdim=True) if self._caution else torch.ones_like(values[:, :1])
        self._actor.learn(self._gradient_in_actions(batch.actions, scale))
        self._optimizers["actor"].step()
        self._move_targets()
        self._judgement = Judgement(scale * values, self._caution, batch.actions, errors)

    def _gradient_in_actions(self, actions: Tensor, scale: Tensor) -> Tensor:
        """That of the actors' losses [A, B, n], for the values of the critics' last `forward` by `scale` [A, 1, 1].

        With the critics' running statistics, see `PaperCritic`, or with their caution, see `CautiousCritic`.
        """
        rows, size = actions.shape[1:]
        gradient = self._critic.through((-scale / rows).expand(-1, rows, 1), inputs=slice(-size, None))
        if self._caution:
            gradient.add_(actions, alpha=2 * self._caution / (rows * size))
        return gradient

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

    def store(self, index: int, agent: DDPG, params: Mapping[str, Tensor] | None = None) -> None:
        """Write one agent's optimizer state back to it, and its parameters and statistics or those given."""
        agent.policy.load_state_dict(self.state(index) if params is None else params)
        for name, optimizer in self._optimizers.items():
            optimizer.store(index, getattr(agent, name).optimizer)

    def _compiled(self, first: DDPG) -> tuple[Learner, Learner, Room, Rule]:
        """What `descend` works on, in the memory of networks and optimizers."""
        actor, critic = (
            self._learner(name, getattr(getattr(first, name), _PARTS[name]), first.batch_size)
            for name in self._optimizers
        )
        adam = self._optimizers["actor"]
        rule = Rule(self._discount, self._target_rate, self._caution, adam.betas, adam.eps)
        return actor, critic, Room.of(actor), rule

    def _learner(self, name: str, first: nn.Module, rows: int) -> Learner:
        own, target = (Networks.of(first, self._networks[each]) for each in (name, f"{name}_target"))
        adam = self._optimizers[name]
        exp_avg, exp_avg_sq = (moment.numpy() for moment in adam.moments.values())
        return Learner(own, target, exp_avg, exp_avg_sq, adam.rates, Pass.of(own, rows))

    def _state(self) -> dict[str, Tensor]:
        return {
            f"{name}.{_PARTS[name]}.{key}": tensor
            for name, network in self._networks.items()
            for key, tensor in network.state.items()
        }


class Judgement(NamedTuple):
    """What agents were judged by in an update."""

    values: Tensor
    """Of the actors' actions, as the actors see them [A, B, 1]."""
    caution: float
    actions: Tensor
    """[A, B, n]"""
    errors: Tensor
    """Of the critics [A, B, 1]."""

    def losses(self) -> FloatArray:
        """`StackedDDPG.losses`."""
        actors = self.caution * self.actions.square().mean((1, 2)) - self.values.mean((1, 2))
        return torch.stack([actors, self.errors.square().mean((1, 2))]).cpu().numpy()


class StackedAdam:
    """The Adam optimizers of a stacked network's agents, each from where it is.

    Raises `ValueError` where they are not equally many steps on.
    """

    def __init__(self, optimizers: Sequence[torch.optim.Optimizer], network: StackedNetwork):
        states = [list(optimizer.state_dict()["state"].values()) for optimizer in optimizers]
        steps = [float(entries[0]["step"]) if entries else 0.0 for entries in states]
        if len(set(steps)) > 1:
            raise ValueError("optimizers: those of a stack must be equally many steps on")
        self.moments = {key: torch.zeros_like(network.parameters) for key in ("exp_avg", "exp_avg_sq")}
        """Averages of gradients and of their squares [A, P]."""
        self._moments = {key: list(network.split(moment).values()) for key, moment in self.moments.items()}
        for key, parameters in self._moments.items():
            for agent, entries in enumerate(states):
                for parameter, entry in zip(parameters, entries, strict=bool(entries)):
                    parameter[agent] = turned(entry[key])
        self._steps, self._device = int(steps[0]), network.parameters.device
        self.rates = np.array([optimizer.param_groups[0]["lr"] for optimizer in optimizers])
        """Learning rates [A]."""
        self._groups = []
        """Agents next to each other that have the same learning rate: what changes in a step, and the rate."""
        first = 0
        for rate, group in groupby(self.rates.tolist()):
            agents = slice(first, first := first + len(list(group)))
            tensors = network.parameters, network.gradients, *self.moments.values()
            self._groups.append(([[tensor[agents]] for tensor in tensors], rate))
        self.betas, self.eps = optimizers[0].defaults["betas"], optimizers[0].defaults["eps"]

    def count(self) -> int:
        """Begin a step: its number."""
        self._steps += 1
        return self._steps

    def step(self) -> None:
        """One step along the gradients of the network."""
        step = torch.full((), self.count(), dtype=torch.float32, device=self._device)
        for tensors, rate in self._groups:
            # What `torch.optim.Adam` calls in the end, which takes longer to get there than the step itself.
            torch.ops.aten._fused_adam_(
                *tensors,
                [],
                [step],
                lr=rate,
                beta1=self.betas[0],
                beta2=self.betas[1],
                eps=self.eps,
                weight_decay=0.0,
                amsgrad=False,
                maximize=False,
            )

    def store(self, index: int, optimizer: torch.optim.Optimizer) -> None:
        """Write one agent's state back to its own optimizer."""
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        for parameter, *moments in zip(parameters, *self._moments.values(), strict=True):
            optimizer.state[parameter] = {"step": torch.tensor(float(self._steps))} | {
                key: _single(moment[index]) for key, moment in zip(self._moments, moments, strict=True)
            }


def _single(tensor: Tensor) -> Tensor:
    """A copy of one agent's part on the CPU, as SB3 holds it."""
    return turned(tensor).to("cpu", copy=True, memory_format=torch.contiguous_format)
