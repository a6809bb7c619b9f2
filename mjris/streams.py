"""All that is random in cells: a stream of its own for each, and one that the cells of a run share."""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.radio import propagation

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class CellId(NamedTuple):
    """What all that is random in a cell follows from."""

    seed: int
    """The run's seed, for the furniture; other streams may be seeded anew."""
    number: int
    """Counted from 0 in the run."""


class _OfCell(NamedTuple):
    """Random generators of one cell."""

    own: np.random.Generator
    """Places and steps of this cell."""
    fading: np.random.Generator
    """What it does not share of the fading: a stream apart, so that arrays of any size leave places and steps alone."""
    shared: np.random.Generator
    """The one that a run's cells share, or a copy of it where cells are not at the same place of their episodes."""
    phases: np.random.Generator
    """Random phases: a stream of their own, so that they leave the rest of the scene as it is."""


class Streams:
    """The random streams of E cells, seeded as their ids say."""

    def __init__(self, cells: Sequence[CellId]):
        self._cells = cells
        self._streams: list[_OfCell] = []
        self.seed([cell.seed for cell in cells])

    def furniture(self) -> list[np.random.Generator]:
        """Generators that place each cell's furniture, always the same [E]."""
        return [np.random.default_rng([cell.seed, cell.number, 1]) for cell in self._cells]

    def seed(self, seeds: Sequence[int]) -> None:
        """Restart all streams with a seed for each cell; equal seeds share a stream."""
        shared = {seed: np.random.default_rng(seed) for seed in seeds}
        self._streams = [
            _OfCell(
                own=np.random.default_rng([seed, cell.number, 0]),
                fading=np.random.default_rng([seed, cell.number, 3]),
                shared=shared[seed],
                phases=np.random.default_rng([seed, cell.number, 2]),
            )
            for seed, cell in zip(seeds, self._cells, strict=True)
        ]

    def own(self, cells: IntArray) -> list[np.random.Generator]:
        """Generators of some cells alone [n]."""
        return [self._streams[e].own for e in cells]

    def part(self, cells: IntArray) -> None:
        """Let some cells go on with copies of what they have shared so far: their episodes begin apart."""
        for e in cells:
            self._streams[e] = self._streams[e]._replace(shared=copy.deepcopy(self._streams[e].shared))

    def phases(self, num_elements: int) -> FloatArray:
        """Uniform phases [E, N] [rad]."""
        return np.stack([stream.phases.uniform(-np.pi, np.pi, num_elements) for stream in self._streams])

    def steps(self, num_users: int, scale_m: float) -> tuple[FloatArray, FloatArray]:
        """Everyone's step: Rayleigh distances [E, K] [m] and uniform directions [E, K] [rad]."""
        uniform = np.empty((len(self._streams), 2, num_users))
        for stream, drawn in zip(self._streams, uniform, strict=True):
            stream.own.random(out=drawn)
        # Inverse transform of the Rayleigh distribution.
        distance = scale_m * np.sqrt(-2 * np.log1p(-uniform[:, 0]))
        return distance, 2 * np.pi * uniform[:, 1]

    def diffuse(self, cells: IntArray, size: int, difference_factor: float) -> ComplexArray:
        """Fresh diffuse fading of some cells [n, size], correlated between cells by the difference factor."""
        sources = [self._streams[e].shared for e in cells]
        first = {source: place for place, source in enumerate(dict.fromkeys(sources))}
        drawn = np.stack([propagation.complex_normal(source, (size,)) for source in first])
        shared = drawn[[first[source] for source in sources]]
        if difference_factor == 0:
            return shared
        own = np.stack([propagation.complex_normal(self._streams[e].fading, (size,)) for e in cells])
        return propagation.mix_cells(shared, own, difference_factor)
