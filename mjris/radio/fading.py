"""Diffuse fading, its memory from slot to slot, and what cells share of it."""

import numpy as np
from numpy.typing import NDArray

ComplexArray = NDArray[np.complexfloating]


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    """Circular complex Gaussian samples of unit mean power [*shape]."""
    parts = rng.standard_normal((*shape, 2)) * 0.5**0.5
    return parts.view(np.complex128)[..., 0]


def evolve(diffuse: ComplexArray, innovation: ComplexArray, memory: float) -> ComplexArray:
    """One slot of the first-order autoregression of diffuse fading.

    `innovation` is a fresh unit-power sample; the mean power stays one and the correlation from slot to slot is
    `memory` (1 freezes the fading).
    """
    return memory * diffuse + (1 - memory**2) ** 0.5 * innovation


def mix_cells(shared: ComplexArray, own: ComplexArray, difference_factor: float) -> ComplexArray:
    """Diffuse fading of cells that share a part of it.

    `shared` [...] is one unit-power sample for all cells, `own` [E, ...] one for each; between two cells the result
    [E, ...] has the correlation 1 - `difference_factor`, and unit mean power.
    """
    return (1 - difference_factor) ** 0.5 * shared + difference_factor**0.5 * own
