"""What stacked agents do and one gradient step of theirs, agent by agent in compiled loops."""

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from torch import nn

from mjris.jit import vectors
from mjris.jit.compiled import compiled
from mjris.learn.compiled_layers import backward, forward, through
from mjris.learn.networks import Networks, Pass, Values, fits, slope

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


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
    """Memory for one agent's minibatch and step."""

    seen: Values
    """Observations [B, D]."""
    pairs: Values
    """Observations and actions [B, D + n]."""
    rewards: Values
    """[B]"""
    goes_on: Values
    """0 where the episode ended for good, and 1 elsewhere [B]."""
    next_seen: Values
    """Next observations [B, D]."""
    next_pairs: Values
    """These and the target's actions [B, D + n]."""
    errors: Values
    """Of the critic [B]."""
    steering: Values
    """The gradient of the actor's loss in its actions [B, n]."""

    @classmethod
    def of(cls, actor: Learner) -> "Room":
        """For what goes into an actor, and comes out."""
        rows, actions = actor.made.outputs[-1].shape
        width = actor.own.layout.inputs[0]
        seen, pairs = (rows, width), (rows, width + actions)
        shapes = seen, pairs, rows, rows, seen, pairs, rows, (rows, actions)
        return cls(*(np.empty(shape, np.float32) for shape in shapes))


def has_compiled_form(agent: DDPG) -> bool:
    """Whether `descend` knows an agent's networks, which must be in single precision."""
    return (
        fits(agent.actor.mu, nn.Tanh)
        and fits(agent.critic.q_networks[0])
        and all(parameter.dtype == torch.float32 for parameter in agent.policy.parameters())
    )


@compiled
def act(actors: Networks, observations: Values, made: Pass) -> Values:
    """Actions [A, n] for observations [A, D] of A agents, whose layers make of one row what goes into `made`."""
    actions = np.empty((len(observations), made.outputs[-1].shape[1]), np.float32)
    for agent in range(len(actions)):
        forward(actors, agent, observations[agent : agent + 1], made, False)
        for i in range(actions.shape[1]):
            actions[agent, i] = vectors.tanh(made.outputs[-1][0, i])
    return actions


@compiled
def descend(
    actor: Learner,
    critic: Learner,
    room: Room,
    rule: Rule,
    steps: tuple[int, int],
    memory: Values,
    places: IntArray,
    following: IntArray,
    losses: FloatArray,
) -> None:
    """One step of A agents; writes what the actors and the critics lost to `losses` [2, A].

    For minibatches at `places` [A, B] of a `memory` [A, L, D + n + 2], see `Batch.rows`, and next observations at
    `following` ones. `steps` are the numbers of the actors' step and of the critics'.
    """
    rows, said, last = len(room.seen), critic.made.outputs[-1][:, 0], len(critic.made.outputs) - 1
    for agent in range(len(memory)):
        _recall(memory[agent], places[agent], room.seen, room.pairs)
        _recall_outcomes(memory[agent], places[agent], room.rewards, room.goes_on)
        _recall(memory[agent], following[agent], room.next_seen, room.next_pairs)
        _act(actor.target, agent, room.next_seen, room.next_pairs, actor.made, False)
        forward(critic.target, agent, room.next_pairs, critic.made, False)
        room.errors[:] = room.rewards + np.float32(rule.discount) * room.goes_on * said
        forward(critic.own, agent, room.pairs, critic.made, True)
        room.errors[:] = said - room.errors
        losses[1, agent] = np.square(room.errors).mean()
        slope(critic.made, last, 1)[:, 0] = room.errors * np.float32(2 / rows)
        backward(critic.own, agent, room.pairs, critic.made)
        _adam(critic, agent, rule, steps[1])

        _act(actor.own, agent, room.seen, room.pairs, actor.made, True)
        # Batch norms take the running statistics, see `PaperCritic`.
        forward(critic.own, agent, room.pairs, critic.made, False)
        scale = np.float32(1 / np.abs(said).mean() if rule.caution else 1)
        losses[0, agent] = rule.caution * np.square(actor.made.outputs[-1]).mean() - scale * said.mean()
        slope(critic.made, last, 1)[:] = -scale / np.float32(rows)
        through(critic.own, agent, critic.made, room.steering)
        _steer(actor.made, room.steering, np.float32(2 * rule.caution / room.steering.size))
        backward(actor.own, agent, room.seen, actor.made)
        _adam(actor, agent, rule, steps[0])


@compiled
def _recall(memory: Values, places: IntArray, seen: Values, pairs: Values) -> None:
    """Write observations [B, D], and these with actions [B, D + n], from places [B] of a memory."""
    for row in range(len(places)):
        remembered, own, pair = memory[places[row]], seen[row], pairs[row]
        for i in range(len(own)):
            own[i] = remembered[i]
        for i in range(len(pair)):
            pair[i] = remembered[i]


@compiled
def _recall_outcomes(memory: Values, places: IntArray, rewards: Values, goes_on: Values) -> None:
    """Write rewards [B], and whether the episode goes on [B], from places [B] of a memory."""
    for row in range(len(places)):
        remembered = memory[places[row]]
        rewards[row], goes_on[row] = remembered[-2], remembered[-1]


@compiled
def _act(actors: Networks, agent: int, seen: Values, pairs: Values, made: Pass, training: bool) -> None:
    """Write an actor's actions for observations [B, D] into pairs of both [B, D + n]."""
    forward(actors, agent, seen, made, training)
    actions, width = made.outputs[-1], seen.shape[1]
    flat = actions.reshape(-1)
    for i in range(len(flat)):
        flat[i] = vectors.tanh(flat[i])
    for row in range(len(actions)):
        action, pair = actions[row], pairs[row]
        for i in range(len(action)):
            pair[width + i] = action[i]


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
