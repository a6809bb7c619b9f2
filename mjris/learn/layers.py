"""Layers of A agents as one, with a leading axis of agents; gradients are written out, as there are so few kinds."""

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn


class StackedLayer(nn.Module):
    """[A, B, in] → [A, B, out]; `backward` refers to the last `forward`."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:
        """Every agent's rows through its own layer; may write over `inputs`."""
        raise NotImplementedError

    def backward(self, gradient: Tensor, learn: bool, through: bool) -> Tensor | None:
        """The gradient [A, B, in] for that of the outputs, if `through`; with `learn`, sets that of the parameters.

        May write over `gradient`.
        """
        raise NotImplementedError


class StackedLinear(StackedLayer):
    """Linear layers; weights are [A, in, out], as products of such are the faster ones."""

    def __init__(self, layers: Sequence[nn.Linear]):
        super().__init__()
        self.weight = nn.Parameter(torch.stack([layer.weight.detach().T for layer in layers]))
        self.bias = nn.Parameter(torch.stack([layer.bias.detach() for layer in layers]))

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """x W + b."""
        self._inputs = inputs
        return torch.baddbmm(self.bias[:, None], inputs, self.weight)

    def backward(self, gradient: Tensor, learn: bool, through: bool) -> Tensor | None:
        """dx = dy Wᵀ, dW = xᵀ dy, db = Σ dy."""
        if learn:
            self.weight.grad = torch.bmm(self._inputs.mT, gradient)
            self.bias.grad = gradient.sum(1)
        return torch.bmm(gradient, self.weight.mT) if through else None


class StackedBatchNorm(StackedLayer):
    """Batch norms, each with statistics of its own: of the minibatch in training, the running ones otherwise."""

    running_mean: Tensor
    running_var: Tensor
    num_batches_tracked: Tensor

    def __init__(self, layers: Sequence[nn.BatchNorm1d]):
        super().__init__()
        self.weight = nn.Parameter(torch.stack([layer.weight.detach() for layer in layers]))
        self.bias = nn.Parameter(torch.stack([layer.bias.detach() for layer in layers]))
        for name, _ in layers[0].named_buffers():
            self.register_buffer(name, torch.stack([getattr(layer, name) for layer in layers]))
        assert layers[0].momentum is not None
        self._momentum, self._eps = layers[0].momentum, layers[0].eps

    def forward(self, inputs: Tensor, training: bool) -> Tensor:
        """Normalised, scaled and shifted."""
        self._trained = training
        if not training:
            self._scale = self.weight * torch.rsqrt(self.running_var + self._eps)
            shift = self.bias - self.running_mean * self._scale
            return torch.addcmul(shift[:, None], inputs, self._scale[:, None])
        self.num_batches_tracked += 1
        self._inputs = _together(inputs)
        outputs, self._mean, self._inverse_std = torch.native_batch_norm(
            self._inputs, *self._parameters_together(), *self._running_together(), True, self._momentum, self._eps
        )
        return _apart(outputs, len(inputs))

    def backward(self, gradient: Tensor, learn: bool, through: bool) -> Tensor | None:
        """Through the statistics of the minibatch too, where they were what normalised."""
        if not self._trained:
            assert not learn
            return gradient * self._scale[:, None]
        inputs, weight, bias = torch.ops.aten.native_batch_norm_backward(
            _together(gradient),
            self._inputs,
            self.weight.view(-1),
            *self._running_together(),
            self._mean,
            self._inverse_std,
            True,
            self._eps,
            [through, learn, learn],
        )
        if learn:
            self.weight.grad, self.bias.grad = weight.view_as(self.weight), bias.view_as(self.bias)
        return _apart(inputs, len(gradient)) if through else None

    def _parameters_together(self) -> tuple[Tensor, Tensor]:
        return self.weight.view(-1), self.bias.view(-1)

    def _running_together(self) -> tuple[Tensor, Tensor]:
        return self.running_mean.view(-1), self.running_var.view(-1)


class ReLU(StackedLayer):
    """Rectifiers."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """max(x, 0)."""
        self._outputs = inputs.relu_()
        return self._outputs

    def backward(self, gradient: Tensor, learn: bool, through: bool) -> Tensor:  # noqa: ARG002 - no parameters
        """dy where y > 0."""
        return torch.ops.aten.threshold_backward.grad_input(gradient, self._outputs, 0, grad_input=gradient)


class Tanh(StackedLayer):
    """Hyperbolic tangents."""

    def forward(self, inputs: Tensor, training: bool) -> Tensor:  # noqa: ARG002 - the same in training
        """tanh x."""
        self._outputs = inputs.tanh_()
        return self._outputs

    def backward(self, gradient: Tensor, learn: bool, through: bool) -> Tensor:  # noqa: ARG002 - no parameters
        """(1 − y²) dy."""
        return gradient * (1 - self._outputs.square())


class StackedNetwork(nn.ModuleList):
    """Layers one after the other; parameters and statistics have the names of the agents' own networks."""

    def forward(self, inputs: Tensor, training: bool = False) -> Tensor:
        """Outputs [A, B, out] for inputs [A, B, in], normalised by the minibatch's statistics in training."""
        for layer in self:
            inputs = layer(inputs, training)
        return inputs

    def backward(self, gradient: Tensor, learn: bool) -> Tensor | None:
        """Set the parameters' gradients with `learn`, and else return that of the last inputs."""
        first, *others = cast(Sequence[StackedLayer], list(self))
        for layer in reversed(others):
            gradient = cast(Tensor, layer.backward(gradient, learn, through=True))
        return first.backward(gradient, learn, through=not learn)


def stack_networks(networks: Sequence[nn.Module]) -> StackedNetwork:
    """One network for A sequential ones of equal shapes. Raises `TypeError` for a layer that has no stacked form."""
    columns = zip(*(network.children() for network in networks), strict=True)
    return StackedNetwork(_stack(column) for column in columns)


def _stack(layers: Sequence[nn.Module]) -> StackedLayer:
    first = layers[0]
    if isinstance(first, nn.Linear):
        return StackedLinear(cast(Sequence[nn.Linear], layers))
    if isinstance(first, nn.BatchNorm1d):
        return StackedBatchNorm(cast(Sequence[nn.BatchNorm1d], layers))
    if isinstance(first, nn.ReLU):
        return ReLU()
    if isinstance(first, nn.Tanh):
        return Tanh()
    raise TypeError(f"network: {type(first).__name__} has no stacked form")


def _together(values: Tensor) -> Tensor:
    """[A, B, D] as [B, A·D]: one batch norm of A·D features is A batch norms of D."""
    return values.transpose(0, 1).flatten(1)


def _apart(values: Tensor, agents: int) -> Tensor:
    """[B, A·D] as [A, B, D]."""
    return values.view(len(values), agents, -1).transpose(0, 1)
