"""One gradient step of stacked agents, agent by agent: all that an agent's step works on then stays in the cache."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import DDPG
from torch import Tensor, nn

from mjris import vectors
from mjris.compiled import compiled
from mjris.learn.products import product

FloatArray = NDArray[np.floating]
Values = NDArray[np.float32]


class Layers(NamedTuple):
    """Linear layers of A agents, or something of each of their parameters."""

    weights: tuple[Values, ...]
    """[A, in, out] of every layer."""
    biases: tuple[Values, ...]
    """[A, out]"""

    @classmethod
    def of(cls, parameters: Iterable[Tensor]) -> "Layers":
        """Of weights and biases in turn, in their memory."""
        arrays = [parameter.numpy() for parameter in parameters]
        return cls(tuple(arrays[::2]), tuple(arrays[1::2]))


class Network(NamedTuple):
    """Linear layers, all but the last one rectified, and what changes with them in a step."""

    own: Layers
    target: Layers
    exp_avg: Layers
    """Adam's averages of the gradients."""
    exp_avg_sq: Layers
    """Those of their squares."""
    rates: FloatArray
    """Learning rates [A]."""
    outputs: tuple[Values, ...]
    """Room for the outputs [B, out] of one agent's layers."""


class Rule(NamedTuple):
    """What a step follows."""

    discount: float
    target_rate: float
    caution: float
    """Of `CautiousCritic`."""
    beta1: float
    beta2: float
    eps: float


class Room(NamedTuple):
    """Memory for one agent's step on a minibatch."""

    seen: Values
    """Observations [B, D]."""
    steering: Values
    """The gradient of the actor's loss in its actions [B, n]."""
    slopes: tuple[Values, Values]
    """The gradients in the outputs of one layer and of the next one, by turns: see `_slope`."""
    gradient: Values
    """That in the weights of a layer."""

    @classmethod
    def of(cls, actor: Network, critic: Network) -> "Room":
        """Enough for all layers of both."""
        actions, outputs = actor.outputs[-1], actor.outputs + critic.outputs
        largest = max(weight[0].size for weight in actor.own.weights + critic.own.weights)
        seen = np.empty((len(actions), actor.own.weights[0].shape[1]), np.float32)
        slope = np.empty(max(output.size for output in outputs), np.float32)
        return cls(seen, np.empty_like(actions), (slope, slope.copy()), np.empty(largest, np.float32))


def has_compiled_form(agent: DDPG) -> bool:
    """Whether an agent's networks are linear and rectified layers in single precision, a tanh behind the actor's."""
    actor, critic = (
        [type(layer) for layer in network.children()] for network in (agent.actor.mu, agent.critic.q_networks[0])
    )
    return (
        actor == [*_rectified(len(actor) - 1), nn.Tanh]
        and critic == _rectified(len(critic))
        and all(parameter.dtype == torch.float32 for parameter in agent.policy.parameters())
    )


def _rectified(layers: int) -> list[type[nn.Module]]:
    return [nn.ReLU if layer % 2 else nn.Linear for layer in range(layers)]


@compiled
def descend(
    actor: Network,
    critic: Network,
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
    said, rows, width = critic.outputs[-1][:, 0], rewards.shape[1], room.seen.shape[1]
    last = len(critic.outputs) - 1
    for agent in range(len(pairs)):
        own, following, value, error = pairs[agent], next_pairs[agent], values[agent, :, 0], errors[agent, :, 0]
        _act(actor.target, agent, following, room.seen, actor.outputs)
        _forward(critic.target, agent, following, critic.outputs)
        error[:] = rewards[agent, :, 0] + np.float32(rule.discount) * said
        _forward(critic.own, agent, own, critic.outputs)
        error[:] = said - error
        _slope(room, critic, last)[:, 0] = error * np.float32(2 / rows)
        _learn(critic, agent, own, room, rule, steps[1])

        _act(actor.own, agent, own, room.seen, actor.outputs)
        _forward(critic.own, agent, own, critic.outputs)
        scale = np.float32(1 / np.abs(said).mean() if rule.caution else 1)
        value[:] = scale * said
        _slope(room, critic, last)[:] = -scale / np.float32(rows)
        _through(critic, agent, room, width)
        _steer(actor, room, np.float32(2 * rule.caution / room.steering.size))
        _learn(actor, agent, room.seen, room, rule, steps[0])
    return values, errors


@compiled
def _act(layers: Layers, agent: int, pairs: Values, seen: Values, outputs: tuple[Values, ...]) -> None:
    """Write an actor's actions into pairs of observations and actions [B, D + n]."""
    width, actions = seen.shape[1], outputs[-1]
    seen[:] = pairs[:, :width]
    _forward(layers, agent, seen, outputs)
    for row in range(len(actions)):
        for i in range(actions.shape[1]):
            actions[row, i] = vectors.tanh(actions[row, i])
            pairs[row, width + i] = actions[row, i]


@compiled
def _forward(layers: Layers, agent: int, inputs: Values, outputs: tuple[Values, ...]) -> None:
    """Write the outputs of all layers: max(x W + b, 0), and x W + b of the last one."""
    for layer in range(len(outputs)):
        below = inputs if layer == 0 else outputs[layer - 1]
        product(below, layers.weights[layer][agent], outputs[layer])
        least = np.float32(0 if layer + 1 < len(outputs) else -np.inf)
        _add(outputs[layer], layers.biases[layer][agent], least)


@compiled
def _learn(network: Network, agent: int, inputs: Values, room: Room, rule: Rule, step: int) -> None:
    """Let a network go down the gradients, from that in its outputs: dW = xᵀ dy, db = Σ dy."""
    own, target, first, second, rates, outputs = network
    for layer in range(len(outputs) - 1, -1, -1):
        slope, weight, bias = _slope(room, network, layer), own.weights[layer][agent], own.biases[layer][agent]
        if layer > 0:
            _pass_back(network, agent, room, layer)
        gradient = room.gradient[: weight.size]
        product(inputs if layer == 0 else outputs[layer - 1], slope, gradient.reshape(weight.shape), True)
        moments = first.weights[layer][agent].ravel(), second.weights[layer][agent].ravel()
        _adam(weight.ravel(), gradient, moments, target.weights[layer][agent].ravel(), rule, rates[agent], step)
        moments = first.biases[layer][agent], second.biases[layer][agent]
        gradient = _sum(slope, room.gradient[: len(bias)])
        _adam(bias, gradient, moments, target.biases[layer][agent], rule, rates[agent], step)


@compiled
def _through(critic: Network, agent: int, room: Room, width: int) -> None:
    """Write the gradient in a critic's actions, the inputs from `width` on, from that in its outputs."""
    for layer in range(len(critic.outputs) - 1, 0, -1):
        _pass_back(critic, agent, room, layer)
    product(_slope(room, critic, 0), critic.own.weights[0][agent][width:], room.steering, False, True)


@compiled
def _pass_back(network: Network, agent: int, room: Room, layer: int) -> None:
    """Write the gradient in the outputs below a layer, from that in its own: dx = dy Wᵀ where x > 0."""
    below, outputs = _slope(room, network, layer - 1), network.outputs[layer - 1]
    product(_slope(room, network, layer), network.own.weights[layer][agent], below, False, True)
    for row in range(len(below)):
        slope, output = below[row], outputs[row]
        for i in range(len(slope)):
            slope[i] = slope[i] if output[i] > 0 else np.float32(0)


@compiled
def _steer(actor: Network, room: Room, cost: np.float32) -> None:
    """Write the gradient in the last layer's outputs of an actor with tanh a: that in its actions, caution included."""
    actions, slope = actor.outputs[-1], _slope(room, actor, len(actor.outputs) - 1)
    for row in range(len(actions)):
        for i in range(actions.shape[1]):
            action = actions[row, i]
            slope[row, i] = (room.steering[row, i] + cost * action) * (1 - action * action)


@compiled
def _slope(room: Room, network: Network, layer: int) -> Values:
    """Room for the gradient in the outputs [B, out] of a layer; only that of the layer before or behind lasts."""
    outputs = network.outputs[layer]
    return room.slopes[layer % 2][: outputs.size].reshape(outputs.shape)


@compiled
def _add(outputs: Values, bias: Values, least: np.float32) -> None:
    """Add a bias to every row [B, out], and raise to the least what is below it."""
    for row in range(len(outputs)):
        output = outputs[row]
        for i in range(len(bias)):
            output[i] = max(output[i] + bias[i], least)


@compiled
def _sum(rows: Values, total: Values) -> Values:
    """`total` [n], the sum of rows [B, n]."""
    total[:] = 0
    for row in range(len(rows)):
        values = rows[row]
        for i in range(len(total)):
            total[i] += values[i]
    return total


@compiled
def _adam(
    parameters: Values,
    gradient: Values,
    moments: tuple[Values, Values],
    target: Values,
    rule: Rule,
    rate: float,
    step: int,
) -> None:
    """A step of Adam (Kingma and Ba, 2015) on P numbers, and one of their averages in the target network after them."""
    first, second = moments
    keep, keep_squares = np.float32(rule.beta1), np.float32(rule.beta2)
    take, take_squares = np.float32(1 - rule.beta1), np.float32(1 - rule.beta2)
    size = np.float32(rate / (1 - rule.beta1**step))
    root, eps = np.float32(1 / math.sqrt(1 - rule.beta2**step)), np.float32(rule.eps)
    follow = np.float32(rule.target_rate)
    for i in range(len(parameters)):
        first[i] = keep * first[i] + take * gradient[i]
        second[i] = keep_squares * second[i] + take_squares * gradient[i] * gradient[i]
        parameters[i] -= size * first[i] / (math.sqrt(second[i]) * root + eps)
        target[i] += follow * (parameters[i] - target[i])
