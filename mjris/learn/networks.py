"""Stacked networks as compiled loops see them, in the same memory, and room for what one agent's pass makes."""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from mjris.jit.compiled import compiled
from mjris.learn.layers import StackedNetwork

Values = NDArray[np.float32]
IntArray = NDArray[np.int64]
Each = tuple[Values, ...]
"""An array of every layer."""


class Layout(NamedTuple):
    """Linear layers, all but the last one rectified, perhaps with a batch norm before each; numbers of each [L].

    The parameters of a network are P numbers in a row, where those of a layer begin as said here.
    """

    inputs: IntArray
    outputs: IntArray
    weights: IntArray
    """[in, out]"""
    biases: IntArray
    """[out]"""
    scales: IntArray
    """Of the batch norm [in]; -1 where there is none."""
    shifts: IntArray

    @classmethod
    def of(cls, network: nn.Module, starts: Mapping[str, int]) -> "Layout":
        """Of a sequential network, whose parameters by name begin so."""
        rows = [
            (
                layer.in_features,
                layer.out_features,
                *(starts[f"{name}.{part}"] for part in ("weight", "bias")),
                *(starts.get(f"{norm}.{part}", -1) for part in ("weight", "bias")),
            )
            for name, layer, norm in _linear(network)
        ]
        return cls(*np.array(rows, np.int64).T.copy())


class Statistics(NamedTuple):
    """Running statistics of batch norms [A, in], or [A, 0] where there are none."""

    means: Each
    variances: Each
    eps: float
    """What is added to a variance."""
    momentum: float
    """How far they follow a minibatch."""

    @classmethod
    def of(cls, network: nn.Module, state: Mapping[str, Tensor]) -> "Statistics":
        """Those of a sequential network, by the names that they have there, in the same memory."""
        nothing = np.empty((len(next(iter(state.values()))), 0), np.float32)
        means, variances = (
            tuple(state[f"{norm}.{part}"].numpy() if norm else nothing for _, _, norm in _linear(network))
            for part in ("running_mean", "running_var")
        )
        norm = next((layer for layer in network.children() if isinstance(layer, nn.BatchNorm1d)), nn.BatchNorm1d(1))
        assert norm.momentum is not None
        return cls(means, variances, norm.eps, norm.momentum)


class Networks(NamedTuple):
    """Those of A agents, which are alike."""

    layout: Layout
    parameters: Values
    """[A, P]"""
    statistics: Statistics

    @classmethod
    def of(cls, first: nn.Module, stack: StackedNetwork) -> "Networks":
        """Those of a stack on the CPU, in its memory; `first` is the first of them."""
        layout = Layout.of(first, stack.starts)
        return cls(layout, stack.parameters.numpy(), Statistics.of(first, stack.state))


class Pass(NamedTuple):
    """What the layers of one agent make of a minibatch of B rows, and room for gradients."""

    outputs: Each
    """Of every layer [B, out]."""
    normalised: Each
    """Its inputs, behind the batch norm [B, in]; [B, 0] where there is none."""
    means: Each
    """What the batch norm took off [in]."""
    inverse_stds: Each
    """What it multiplied with [in]."""
    slopes: tuple[Values, Values]
    """Gradients in the outputs of one layer and of the next one, by turns: see `slope`."""
    gradient: Values
    """That in all parameters [P]."""

    @classmethod
    def of(cls, networks: Networks, rows: int) -> "Pass":
        """Room for one."""
        layout = networks.layout
        norms = np.where(layout.scales < 0, 0, layout.inputs).tolist()
        widest = max(layout.inputs.max(), layout.outputs.max())
        return cls(
            tuple(np.empty((rows, width), np.float32) for width in layout.outputs.tolist()),
            tuple(np.empty((rows, width), np.float32) for width in norms),
            tuple(np.empty(width, np.float32) for width in norms),
            tuple(np.empty(width, np.float32) for width in norms),
            (np.empty(rows * widest, np.float32), np.empty(rows * widest, np.float32)),
            np.zeros(networks.parameters.shape[1], np.float32),
        )


def fits(network: nn.Module, *behind: type[nn.Module]) -> bool:
    """Whether a network is a sequence of such layers, with layers of these kinds behind."""
    kinds = [type(layer) for layer in network.children()]
    plain = [kind for kind in kinds if kind is not nn.BatchNorm1d]
    rectified = [nn.ReLU if number % 2 else nn.Linear for number in range(len(plain) - len(behind))]
    before_linear = all(after is nn.Linear for kind, after in pairwise([*kinds, None]) if kind is nn.BatchNorm1d)
    return plain == [*rectified, *behind] and rectified[-1:] == [nn.Linear] and before_linear


def _linear(network: nn.Module) -> list[tuple[str, nn.Linear, str]]:
    """Names and linear layers, and the name of the batch norm before each, or none."""
    return [
        (name, layer, before if isinstance(norm, nn.BatchNorm1d) else "")
        for (before, norm), (name, layer) in pairwise([("", None), *network.named_children()])
        if isinstance(layer, nn.Linear)
    ]


@compiled
def weight_of(values: Values, layout: Layout, layer: int) -> Values:
    """A layer's weights [in, out], or whatever stands in their place, in P numbers."""
    start, inputs, outputs = layout.weights[layer], layout.inputs[layer], layout.outputs[layer]
    return values[start : start + inputs * outputs].reshape(inputs, outputs)


@compiled
def bias_of(values: Values, layout: Layout, layer: int) -> Values:
    """A layer's biases [out]."""
    return values[layout.biases[layer] :][: layout.outputs[layer]]


@compiled
def scale_of(values: Values, layout: Layout, layer: int) -> Values:
    """The scales of its batch norm [in]."""
    return values[layout.scales[layer] :][: layout.inputs[layer]]


@compiled
def shift_of(values: Values, layout: Layout, layer: int) -> Values:
    """The shifts of its batch norm [in]."""
    return values[layout.shifts[layer] :][: layout.inputs[layer]]


@compiled
def slope(made: Pass, layer: int, width: int) -> Values:
    """Room for the gradient in the outputs [B, out] of a layer, which lasts until that of the second next."""
    rows = len(made.outputs[0])
    return made.slopes[layer % 2][: rows * width].reshape(rows, width)
