"""All that is random: a stream of its own for every purpose and cell, all from one seed; and the streams of cells."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.radio import fading

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class Purpose(IntEnum):
    """What a random stream is for: the first number of its key."""

    FURNITURE = 0
    """Where a cell's furniture stands."""
    PLACES = 1
    """Places and steps of a cell's rover and people."""
    FADING = 2
    """What a cell does not share of the fading: apart, so that arrays of any size leave places and steps alone."""
    SHARED_FADING = 3
    """What the cells of a run share of it."""
    PHASES = 4
    """Random phases of a cell: apart, so that they leave the rest of the scene as it is."""
    AGENT = 5
    """First weights and exploration noise of a cell's agent."""
    LEARNING = 6
    """Minibatches and warm-up actions of a cell in a round."""
    EPISODES = 7
    """The environments of a run in a round."""
    SEARCH = 8
    """Random starts of a search."""
    RESAMPLING = 9
    """Intervals by resampling."""
    STUDY = 10
    """Whatever a script draws by itself."""
    DEAD = 11
    """Which elements of a cell reflect nothing."""
    PHASE_NOISE = 12
    """What a cell's elements miss their phases by."""
    KNOWLEDGE = 13
    """What a cell is wrong about."""


def sequence(seed: int, purpose: Purpose, *key: int) -> np.random.SeedSequence:
    """What a stream follows from: the seed, what it is for, and perhaps whose it is, as cell and round."""
    return np.random.SeedSequence(seed, spawn_key=(purpose, *key))


def generator(seed: int, purpose: Purpose, *key: int) -> np.random.Generator:
    """The generator of a stream, see `sequence`. Different keys have independent ones."""
    return np.random.default_rng(sequence(seed, purpose, *key))


def word(seed: int, purpose: Purpose, *key: int) -> int:
    """A 32-bit seed from a stream of its own, for whatever takes no generator."""
    return int(sequence(seed, purpose, *key).generate_state(1)[0])


def fresh_seed() -> int:
    """A seed that nobody named, from the entropy of the system, 32 bit."""
    return int(np.random.SeedSequence().generate_state(1)[0])


def seeded(config: Config) -> Config:
    """The config with a seed: its own, or a fresh one where it names none."""
    return config if config.seed is not None else replace(config, seed=fresh_seed())


class CellId(NamedTuple):
    """What all that is random in a cell follows from."""

    seed: int
    """The run's seed, for the furniture; other streams may be seeded anew."""
    number: int
    """Counted from 0 in the run."""


def first_cells(config: Config, count: int) -> list[CellId]:
    """The first cells of a run of `config`, with a fresh seed where it names none."""
    seed = seeded(config).named_seed
    return [CellId(seed, number) for number in range(count)]


class _OfCell(NamedTuple):
    """Random generators of one cell."""

    own: np.random.Generator
    """`Purpose.PLACES`"""
    fading: np.random.Generator
    """`Purpose.FADING`"""
    shared: np.random.Generator
    """`Purpose.SHARED_FADING`, or a copy of it where cells are not at the same place of their episodes."""
    phases: np.random.Generator
    """`Purpose.PHASES`"""
    phase_noise: np.random.Generator
    """`Purpose.PHASE_NOISE`"""
    knowledge: np.random.Generator
    """`Purpose.KNOWLEDGE`"""


class Streams:
    """The random streams of E cells, seeded as their ids say."""

    def __init__(self, cells: Sequence[CellId]):
        self._cells, self.num_cells = cells, len(cells)
        self._streams: list[_OfCell] = []
        self.seed([cell.seed for cell in cells])

    def furniture(self) -> list[np.random.Generator]:
        """Generators that place each cell's furniture, always the same [E]."""
        return [generator(cell.seed, Purpose.FURNITURE, cell.number) for cell in self._cells]

    def seed(self, seeds: Sequence[int]) -> None:
        """Restart all streams with a seed for each cell; equal seeds share a stream."""
        shared = {seed: generator(seed, Purpose.SHARED_FADING) for seed in seeds}
        self._streams = [
            _OfCell(
                own=generator(seed, Purpose.PLACES, cell.number),
                fading=generator(seed, Purpose.FADING, cell.number),
                shared=shared[seed],
                phases=generator(seed, Purpose.PHASES, cell.number),
                phase_noise=generator(seed, Purpose.PHASE_NOISE, cell.number),
                knowledge=generator(seed, Purpose.KNOWLEDGE, cell.number),
            )
            for seed, cell in zip(seeds, self._cells, strict=True)
        ]

    def own(self, cells: IntArray) -> list[np.random.Generator]:
        """Generators of some cells alone [n]."""
        return [self._streams[e].own for e in cells]

    def knowledge(self, cells: IntArray) -> list[np.random.Generator]:
        """Generators for what some cells [n] are wrong about."""
        return [self._streams[e].knowledge for e in cells]

    def part(self, cells: IntArray) -> None:
        """Let some cells go on with copies of what they have shared so far: their episodes begin apart."""
        for e in cells:
            self._streams[e] = self._streams[e]._replace(shared=copy.deepcopy(self._streams[e].shared))

    def phases(self, num_elements: int) -> FloatArray:
        """Uniform phases [E, N] [rad]."""
        return np.stack([stream.phases.uniform(-np.pi, np.pi, num_elements) for stream in self._streams])

    def phase_noise(self, num_elements: int, deviation_rad: float) -> FloatArray:
        """What elements miss their phases by, normally distributed [E, N] [rad]."""
        return np.stack([stream.phase_noise.normal(0, deviation_rad, num_elements) for stream in self._streams])

    def dead(self, num_elements: int, share: float) -> NDArray[np.bool_]:
        """Which elements reflect nothing, always the same [E, N]; as many in every cell, to the nearest number."""
        dead = np.zeros((len(self._cells), num_elements), np.bool_)
        for own, cell in zip(dead, self._cells, strict=True):
            order = generator(cell.seed, Purpose.DEAD, cell.number).permutation(num_elements)
            own[order[: round(share * num_elements)]] = True
        return dead

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
        drawn = np.stack([fading.complex_normal(source, (size,)) for source in first])
        shared = drawn[[first[source] for source in sources]]
        if difference_factor == 0:
            return shared
        own = np.stack([fading.complex_normal(self._streams[e].fading, (size,)) for e in cells])
        return fading.mix_cells(shared, own, difference_factor)
