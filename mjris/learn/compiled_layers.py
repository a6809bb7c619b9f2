"""The layers of one agent after the other in compiled loops, where `layers` has those of all agents as one.

All that one agent's pass works on then stays in the cache.
"""

import numpy as np

from mjris.jit.compiled import compiled
from mjris.learn.networks import Networks, Pass, Values, bias_of, scale_of, shift_of, slope, weight_of
from mjris.learn.products import product


@compiled
def forward(networks: Networks, agent: int, inputs: Values, made: Pass, training: bool) -> None:
    """Pass rows of inputs [B, in] of an agent through its layers: max(x W + b, 0), and x W + b in the last one.

    Batch norms take the running statistics or, in training, those of the rows, which the running ones follow.
    """
    layout, statistics = networks.layout, networks.statistics
    own, last = networks.parameters[agent], len(made.outputs) - 1
    for layer in range(last + 1):
        below = inputs if layer == 0 else made.outputs[layer - 1]
        if layout.scales[layer] >= 0:
            mean, inverse_std = made.means[layer], made.inverse_stds[layer]
            running_mean, running_variance = statistics.means[layer][agent], statistics.variances[layer][agent]
            if training:
                _measure(below, mean, inverse_std)
                _follow(running_mean, mean, statistics.momentum, 1.0)
                _follow(running_variance, inverse_std, statistics.momentum, len(below) / (len(below) - 1))
            else:
                mean[:], inverse_std[:] = running_mean, running_variance
            inverse_std[:] = 1 / np.sqrt(inverse_std + np.float32(statistics.eps))
            scale, shift = scale_of(own, layout, layer), shift_of(own, layout, layer)
            _normalise(below, mean, inverse_std, scale, shift, made.normalised[layer])
            below = made.normalised[layer]
        product(below, weight_of(own, layout, layer), made.outputs[layer])
        _add(made.outputs[layer], bias_of(own, layout, layer), np.float32(0 if layer < last else -np.inf))


@compiled
def backward(networks: Networks, agent: int, inputs: Values, made: Pass) -> None:
    """Write the gradient in all parameters, after `forward` in training and from the gradient in the outputs.

    That is dW = xᵀ dy and db = Σ dy for dx = dy Wᵀ.
    """
    layout, own = networks.layout, networks.parameters[agent]
    for layer in range(len(made.outputs) - 1, -1, -1):
        below, normed = inputs if layer == 0 else made.outputs[layer - 1], layout.scales[layer] >= 0
        dy, dx = slope(made, layer, layout.outputs[layer]), slope(made, layer - 1, layout.inputs[layer])
        product(made.normalised[layer] if normed else below, dy, weight_of(made.gradient, layout, layer), True)
        _sum(dy, bias_of(made.gradient, layout, layer))
        if layer > 0 or normed:
            product(dy, weight_of(own, layout, layer), dx, False, True)
        if normed:
            scales, shifts = scale_of(made.gradient, layout, layer), shift_of(made.gradient, layout, layer)
            mean, inverse_std = made.means[layer], made.inverse_stds[layer]
            _normalise_back(dx, below, mean, inverse_std, scale_of(own, layout, layer), scales, shifts)
        if layer > 0:
            _rectify_back(dx, below)


@compiled
def through(networks: Networks, agent: int, made: Pass, wanted: Values) -> None:
    """Write the gradient in the last of the inputs, those that are `wanted` [B, < in], from that in the outputs.

    After `forward` without training.
    """
    layout, own = networks.layout, networks.parameters[agent]
    for layer in range(len(made.outputs) - 1, 0, -1):
        dy, dx = slope(made, layer, layout.outputs[layer]), slope(made, layer - 1, layout.inputs[layer])
        product(dy, weight_of(own, layout, layer), dx, False, True)
        if layout.scales[layer] >= 0:
            _scale(dx, made.inverse_stds[layer] * scale_of(own, layout, layer))
        _rectify_back(dx, made.outputs[layer - 1])
    first = layout.inputs[0] - wanted.shape[1]
    product(slope(made, 0, layout.outputs[0]), weight_of(own, layout, 0)[first:], wanted, False, True)
    if layout.scales[0] >= 0:
        _scale(wanted, (made.inverse_stds[0] * scale_of(own, layout, 0))[first:])


@compiled
def _measure(rows: Values, mean: Values, variance: Values) -> None:
    """Write the mean and the variance [n] of rows [B, n]."""
    _sum(rows, mean)
    mean /= np.float32(len(rows))
    variance[:] = 0
    for row in range(len(rows)):
        values = rows[row]
        for i in range(len(mean)):
            variance[i] += (values[i] - mean[i]) * (values[i] - mean[i])
    variance /= np.float32(len(rows))


@compiled
def _follow(running: Values, measured: Values, momentum: float, factor: float) -> None:
    """Move running statistics [n] toward those measured times a factor."""
    running += np.float32(momentum) * (np.float32(factor) * measured - running)


@compiled
def _normalise(rows: Values, mean: Values, inverse_std: Values, scale: Values, shift: Values, into: Values) -> None:
    for row in range(len(rows)):
        values, normalised = rows[row], into[row]
        for i in range(len(mean)):
            normalised[i] = (values[i] - mean[i]) * inverse_std[i] * scale[i] + shift[i]


@compiled
def _normalise_back(
    gradient: Values,
    inputs: Values,
    mean: Values,
    inverse_std: Values,
    scale: Values,
    in_scale: Values,
    in_shift: Values,
) -> None:
    """From the gradient dy [B, n] behind a batch norm to that before it, and Σ x̂ dy and Σ dy in scales and shifts."""
    in_scale[:] = 0
    _sum(gradient, in_shift)
    for row in range(len(inputs)):
        values, dy = inputs[row], gradient[row]
        for i in range(len(mean)):
            in_scale[i] += (values[i] - mean[i]) * inverse_std[i] * dy[i]
    share = np.float32(1 / len(inputs))
    for row in range(len(inputs)):
        values, dy = inputs[row], gradient[row]
        for i in range(len(mean)):
            mean_gradient = share * (in_shift[i] + (values[i] - mean[i]) * inverse_std[i] * in_scale[i])
            dy[i] = scale[i] * inverse_std[i] * (dy[i] - mean_gradient)


@compiled
def _rectify_back(gradient: Values, outputs: Values) -> None:
    """From the gradient behind a rectifier [B, n] to that before it: dy where y > 0."""
    for row in range(len(outputs)):
        output, dy = outputs[row], gradient[row]
        for i in range(len(dy)):
            dy[i] = dy[i] if output[i] > 0 else np.float32(0)


@compiled
def _add(rows: Values, bias: Values, least: np.float32) -> None:
    """Add a bias to rows [B, n], and raise to the least what is below it."""
    for row in range(len(rows)):
        values = rows[row]
        for i in range(len(bias)):
            values[i] = max(values[i] + bias[i], least)


@compiled
def _scale(rows: Values, factors: Values) -> None:
    for row in range(len(rows)):
        values = rows[row]
        for i in range(len(factors)):
            values[i] *= factors[i]


@compiled
def _sum(rows: Values, total: Values) -> None:
    """Write the sum of rows [B, n] to `total` [n]."""
    total[:] = 0
    for row in range(len(rows)):
        values = rows[row]
        for i in range(len(total)):
            total[i] += values[i]
