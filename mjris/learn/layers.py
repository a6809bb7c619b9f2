"""Layers of A agents as one, with a leading axis of agents; gradients are written out, as there are so few kinds."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

Tensors = Mapping[str, Tensor]
"""Parameters and statistics, or gradients, of a layer or network by name."""

_ALL = slice(None)
_LINE = 16
"""Parameters begin at multiples of this many numbers: loops are faster over whole lines of the cache."""


class StackedLayer:
    """[A, B, in] → [A, B, out]; `backward` refers to the last `forward`."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:
        """Every agent's rows through its own layer; may write over `inputs`."""
        raise NotImplementedError

    def backward(self, gradient: Tensor, learn: bool, through: slice | None) -> Tensor | None:
        """The gradient [A, B, ≤ in] in the inputs `through`, from that of the outputs; `learn` that of the parameters.

        May write over `gradient`.
        """
        raise NotImplementedError


class StackedLinear(StackedLayer):
    """Linear layers; weights are [A, in, out], as products of such are the faster ones."""

    def __init__(self, state: Tensors, gradients: Tensors):
        self._weight, self._bias = state["weight"], state["bias"][:, None]
        self._weight_gradient, self._bias_gradient = gradients["weight"], gradients["bias"]

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """x W + b."""
        self._inputs = inputs
        return torch.bmm(inputs, self._weight).add_(self._bias)

    def backward(self, gradient: Tensor, learn: bool, through: slice | None) -> Tensor | None:
        """dx = dy Wᵀ, dW = xᵀ dy, db = Σ dy."""
        if learn:
            torch.bmm(self._inputs.mT, gradient, out=self._weight_gradient)
            torch.sum(gradient, 1, out=self._bias_gradient)
        return None if through is None else torch.bmm(gradient, self._weight[:, through].mT)


class StackedBatchNorm(StackedLayer):
    """Batch norms, each with statistics of its own: of the minibatch in training, the running ones otherwise."""

    def __init__(self, state: Tensors, gradients: Tensors, first: nn.BatchNorm1d):
        self._weight, self._bias = state["weight"], state["bias"]
        self._mean, self._var, self._batches = (
            state[name] for name in ("running_mean", "running_var", "num_batches_tracked")
        )
        self._weight_gradient, self._bias_gradient = gradients["weight"], gradients["bias"]
        assert first.momentum is not None
        self._momentum, self._eps = first.momentum, first.eps

    def forward(self, inputs: Tensor, training: bool) -> Tensor:
        """Normalised, scaled and shifted."""
        self._trained = training
        if not training:
            self._scale = self._weight * torch.rsqrt(self._var + self._eps)
            shift = self._bias - self._mean * self._scale
            return torch.addcmul(shift[:, None], inputs, self._scale[:, None])
        self._batches += 1
        self._inputs = _together(inputs)
        outputs, self._batch_mean, self._inverse_std = torch.native_batch_norm(
            self._inputs,
            self._weight.flatten(),
            self._bias.flatten(),
            *self._running_together(),
            True,
            self._momentum,
            self._eps,
        )
        return _apart(outputs, len(inputs))

    def backward(self, gradient: Tensor, learn: bool, through: slice | None) -> Tensor | None:
        """Through the statistics of the minibatch too, where they were what normalised."""
        if not self._trained:
            assert not learn
            return None if through is None else gradient[..., through] * self._scale[:, None, through]
        inputs, weight, bias = torch.ops.aten.native_batch_norm_backward(
            _together(gradient),
            self._inputs,
            self._weight.flatten(),
            *self._running_together(),
            self._batch_mean,
            self._inverse_std,
            True,
            self._eps,
            [through is not None, learn, learn],
        )
        if learn:
            self._weight_gradient.copy_(weight.view_as(self._weight))
            self._bias_gradient.copy_(bias.view_as(self._bias))
        return None if through is None else _apart(inputs, len(gradient))[..., through]

    def _running_together(self) -> tuple[Tensor, Tensor]:
        return self._mean.view(-1), self._var.view(-1)


class ReLU(StackedLayer):
    """Rectifiers."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """max(x, 0)."""
        self._outputs = inputs.relu_()
        return self._outputs

    def backward(self, gradient: Tensor, learn: bool, through: slice | None) -> Tensor:  # noqa: ARG002 - no parameters
        """dy where y > 0."""
        return torch.ops.aten.threshold_backward.grad_input(gradient, self._outputs, 0, grad_input=gradient)


class Tanh(StackedLayer):
    """Hyperbolic tangents."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """tanh x."""
        self._outputs = inputs.tanh_()
        return self._outputs

    def backward(self, gradient: Tensor, learn: bool, through: slice | None) -> Tensor:  # noqa: ARG002 - no parameters
        """(1 − y²) dy."""
        return gradient * (1 - self._outputs.square())


class StackedNetwork:
    """Sequential networks of A agents, of equal shapes, as one. Raises `TypeError` for a layer without a stacked form.

    All parameters are one tensor, and so are their gradients: what is done to each number is one operation.
    """

    def __init__(self, networks: Sequence[nn.Module], device: str = "cpu"):
        first = networks[0]
        self._shapes = {name: turned(parameter).shape for name, parameter in first.named_parameters()}
        sizes = [_LINE * math.ceil(shape.numel() / _LINE) for shape in self._shapes.values()]
        self.starts = dict(zip(self._shapes, np.cumsum([0, *sizes]).tolist(), strict=False))
        """Where each parameter begins in a row of P numbers."""
        dtype = next(first.parameters()).dtype
        self.parameters = torch.zeros(len(networks), sum(sizes), dtype=dtype, device=device)
        """[A, P]"""
        self.gradients = torch.zeros_like(self.parameters)
        """[A, P], of the last `backward` that learned."""
        parameters = self.split(self.parameters)
        for agent, network in enumerate(networks):
            for name, parameter in network.named_parameters():
                parameters[name][agent] = turned(parameter.detach())
        columns = zip(*(network.named_buffers() for network in networks), strict=True)
        self.statistics = {column[0][0]: torch.stack([buffer for _, buffer in column]).to(device) for column in columns}
        """Of batch norms [A, ...], by name."""
        self.state = parameters | self.statistics
        """Parameters and statistics [A, ...] by the names that they have in the agents, weights [A, in, out]."""
        gradients = self.split(self.gradients)
        self._layers = [
            _stack(layer, _of_layer(name, self.state), _of_layer(name, gradients))
            for name, layer in first.named_children()
        ]

    def split(self, flat: Tensor) -> dict[str, Tensor]:
        """[A, P] as a view [A, *shape] for every parameter, by name."""
        return {
            name: flat[:, start : start + shape.numel()].view(-1, *shape)
            for (name, shape), start in zip(self._shapes.items(), self.starts.values(), strict=True)
        }

    def forward(self, inputs: Tensor, training: bool = False) -> Tensor:
        """Outputs [A, B, out] for inputs [A, B, in], normalised by the minibatch's statistics in training."""
        for layer in self._layers:
            inputs = layer.forward(inputs, training)
        return inputs

    def count_batch(self) -> None:
        """Count one more minibatch whose statistics the running ones follow."""
        for name, counts in self.statistics.items():
            if name.endswith("num_batches_tracked"):
                counts += 1

    def learn(self, gradient: Tensor) -> None:
        """Set the gradients of the parameters from that of the outputs [A, B, out]."""
        for layer in reversed(self._layers[1:]):
            gradient = _given(layer.backward(gradient, True, _ALL))
        self._layers[0].backward(gradient, True, None)

    def through(self, gradient: Tensor, inputs: slice) -> Tensor:
        """The gradient in these inputs [A, B, ≤ in] from that of the outputs [A, B, out]."""
        for layer in reversed(self._layers[1:]):
            gradient = _given(layer.backward(gradient, False, _ALL))
        return _given(self._layers[0].backward(gradient, False, inputs))


def turned(tensor: Tensor) -> Tensor:
    """Weights [out, in] as a stack holds them, or the other way round; anything else as it is."""
    return tensor.T if tensor.ndim == 2 else tensor


def _of_layer(number: str, tensors: Tensors) -> Tensors:
    return {
        name.removeprefix(f"{number}."): tensor for name, tensor in tensors.items() if name.startswith(f"{number}.")
    }


def _stack(layer: nn.Module, state: Tensors, gradients: Tensors) -> StackedLayer:
    if isinstance(layer, nn.Linear):
        return StackedLinear(state, gradients)
    if isinstance(layer, nn.BatchNorm1d):
        return StackedBatchNorm(state, gradients, layer)
    if isinstance(layer, nn.ReLU):
        return ReLU()
    if isinstance(layer, nn.Tanh):
        return Tanh()
    raise TypeError(f"network: {type(layer).__name__} has no stacked form")


def _given(gradient: Tensor | None) -> Tensor:
    assert gradient is not None
    return gradient


def _together(values: Tensor) -> Tensor:
    """[A, B, D] as [B, A·D]: one batch norm of A·D features is A batch norms of D."""
    return values.transpose(0, 1).flatten(1)


def _apart(values: Tensor, agents: int) -> Tensor:
    """[B, A·D] as [A, B, D]."""
    return values.view(len(values), agents, -1).transpose(0, 1)
