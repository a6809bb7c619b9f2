"""One gradient step of stacked agents, agent by agent in compiled loops."""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from torch import nn

from mjris import vectors
from mjris.compiled import compiled
from mjris.learn.compiled_layers import backward, forward, through
from mjris.learn.networks import Networks, Pass, Values, fits, slope

FloatArray = NDArray[np.floating]


class Learner(NamedTuple):
    """The actors or the critics of A agents."""

    own: Networks
    target: Networks
    exp_avg: Values
    """Adam's averages of the gradients [A, P]."""
    exp_avg_sq: Values
    """Those of their squares."""
    rates: FloatArray
    """Learning rates [A]."""
    made: Pass


class Rule(NamedTuple):
    """What a step follows."""

    discount: float
    target_rate: float
    caution: float
    """Of `CautiousCritic`."""
    betas: tuple[float, float]
    """Of Adam."""
    eps: float


class Room(NamedTuple):
    """Memory for one agent's step."""

    seen: Values
    """Observations [B, D]."""
    steering: Values
    """The gradient of the actor's loss in its actions [B, n]."""

    @classmethod
    def of(cls, actor: Learner) -> "Room":
        """For what goes into an actor, and comes out."""
        actions = actor.made.outputs[-1]
        return cls(np.empty((len(actions), actor.own.layout.inputs[0]), np.float32), np.empty_like(actions))


def has_compiled_form(agent: DDPG) -> bool:
    """Whether `descend` knows an agent's networks, which must be in single precision."""
    return (
        fits(agent.actor.mu, nn.Tanh)
        and fits(agent.critic.q_networks[0])
        and all(parameter.dtype == torch.float32 for parameter in agent.policy.parameters())
    )


@compiled
def descend(
    actor: Learner,
    critic: Learner,
    room: Room,
    rule: Rule,
    steps: tuple[int, int],
    pairs: Values,
    rewards: Values,
    next_pairs: Values,
) -> tuple[Values, Values]:
    """One step of A agents: what the critics say of the actors' actions, and the critics' errors [A, B, 1].

    For minibatches `pairs` [A, B, D + n], `rewards` [A, B, 1] and `next_pairs`; `steps` are the numbers of the actors'
    step and of the critics'. Writes the actors' actions over those in the pairs.
    """
    values, errors = np.empty_like(rewards), np.empty_like(rewards)
    rows, said, last = len(room.seen), critic.made.outputs[-1][:, 0], len(critic.made.outputs) - 1
    for agent in range(len(pairs)):
        own, following, value, error = pairs[agent], next_pairs[agent], values[agent, :, 0], errors[agent, :, 0]
        _act(actor.target, agent, following, room.seen, actor.made, False)
        forward(critic.target, agent, following, critic.made, False)
        error[:] = rewards[agent, :, 0] + np.float32(rule.discount) * said
        forward(critic.own, agent, own, critic.made, True)
        error[:] = said - error
        slope(critic.made, last, 1)[:, 0] = error * np.float32(2 / rows)
        backward(critic.own, agent, own, critic.made)
        _adam(critic, agent, rule, steps[1])

        _act(actor.own, agent, own, room.seen, actor.made, True)
        # Batch norms take the running statistics, see `PaperCritic`.
        forward(critic.own, agent, own, critic.made, False)
        scale = np.float32(1 / np.abs(said).mean() if rule.caution else 1)
        value[:] = scale * said
        slope(critic.made, last, 1)[:] = -scale / np.float32(rows)
        through(critic.own, agent, critic.made, room.steering)
        _steer(actor.made, room.steering, np.float32(2 * rule.caution / room.steering.size))
        backward(actor.own, agent, room.seen, actor.made)
        _adam(actor, agent, rule, steps[0])
    return values, errors


@compiled
def _act(actors: Networks, agent: int, pairs: Values, seen: Values, made: Pass, training: bool) -> None:
    """Write an actor's actions into pairs of observations and actions [B, D + n]."""
    width, actions = seen.shape[1], made.outputs[-1]
    seen[:] = pairs[:, :width]
    forward(actors, agent, seen, made, training)
    for row in range(len(actions)):
        for i in range(actions.shape[1]):
            actions[row, i] = vectors.tanh(actions[row, i])
            pairs[row, width + i] = actions[row, i]


@compiled
def _steer(made: Pass, steering: Values, cost: np.float32) -> None:
    """Write the gradient in the outputs of an actor's last layer, from that in its actions a = tanh y, and a cost."""
    actions = made.outputs[-1]
    gradient = slope(made, len(made.outputs) - 1, actions.shape[1])
    for row in range(len(actions)):
        for i in range(actions.shape[1]):
            action = actions[row, i]
            gradient[row, i] = (steering[row, i] + cost * action) * (1 - action * action)


@compiled
def _adam(learner: Learner, agent: int, rule: Rule, step: int) -> None:
    """A step of Adam (Kingma and Ba, 2015) for a network, and one of its target after it."""
    own, target, gradient = learner.own.parameters[agent], learner.target.parameters[agent], learner.made.gradient
    first, second, (beta1, beta2) = learner.exp_avg[agent], learner.exp_avg_sq[agent], rule.betas
    keep, keep_squares = np.float32(beta1), np.float32(beta2)
    take, take_squares = np.float32(1 - beta1), np.float32(1 - beta2)
    size = np.float32(learner.rates[agent] / (1 - beta1**step))
    root, eps = np.float32(1 / math.sqrt(1 - beta2**step)), np.float32(rule.eps)
    follow = np.float32(rule.target_rate)
    for i in range(len(own)):
        first[i] = keep * first[i] + take * gradient[i]
        second[i] = keep_squares * second[i] + take_squares * gradient[i] * gradient[i]
        own[i] -= size * first[i] / (math.sqrt(second[i]) * root + eps)
        target[i] += follow * (own[i] - target[i])
    # SB3 copies the running statistics.
    from_, to = learner.own.statistics, learner.target.statistics
    for layer in range(len(from_.means)):
        to.means[layer][agent] = from_.means[layer][agent]
        to.variances[layer][agent] = from_.variances[layer][agent]
