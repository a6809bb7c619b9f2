"""Sight between squares of the floor, cast once when first asked for: what a radio map can know beforehand."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.world.sight import Sight

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_SQUARE_M = 0.5
_UNKNOWN = -1
_MOST = 127
"""More obstacles than an int8 can count are as many."""


class Grid(NamedTuple):
    """The floor in s squares, which are numbered along y first."""

    x_m: float
    y_m: float
    """Middle of the first one."""
    columns: int
    """How many there are along x."""
    rows: int
    """How many there are along y."""


class SightMap:
    """Obstacles between places at two heights and to an access point, by the squares that the places lie in.

    Squares have their middles half a metre apart, one of them on the rover's start, as the nodes of `Paths` do.

    For one office or one a cell, as in `Footprints`. Memory: s² bytes an office with s squares.
    """

    def __init__(
        self, sight: Sight, room_m: FloatArray, start: FloatArray, ap: FloatArray, low_m: float, high_m: float
    ):
        """`room_m` and `start` [2], `ap` [E or 1, 3] [m]; links lead from `low_m` [m] up to `high_m`, or to the AP."""
        self._sight = sight
        origin = start - np.rint(start / _SQUARE_M) * _SQUARE_M
        columns, rows = (np.rint((room_m - origin) / _SQUARE_M).astype(int) + 1).tolist()
        self.grid = Grid(float(origin[0]), float(origin[1]), columns, rows)
        index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
        # Squares at the walls have their middles pulled inside.
        middles = np.clip(origin + index * _SQUARE_M, 0.01, room_m - 0.01)
        self._low, self._high = (np.insert(middles, 2, height, 1) for height in (low_m, high_m))
        high = np.broadcast_to(self._high, (len(ap), *self._high.shape))
        self._from_ap = self._cast(np.arange(len(ap)), np.broadcast_to(ap[:, None], high.shape), high)
        self._between = np.full((len(ap), len(middles), len(middles)), _UNKNOWN, np.int8)
        """By office, lower square and upper square."""

    def blockers(self, low: FloatArray) -> NDArray[np.int8]:
        """Obstacles from places `low` [E, K, 2] [m] at the lower height and, last, the AP to all squares [E, K + 1, s].

        The squares are at the upper height.
        """
        rows, unknown = _rows(self.grid, self._between, self._from_ap, low)
        if not unknown:
            return rows
        for office, lower in unknown:
            start = np.broadcast_to(self._low[lower], (1, *self._high.shape))
            self._between[office, lower] = self._cast(np.array([office]), start, self._high[None])[0]
        return self.blockers(low)

    def _cast(self, cells: IntArray, start: FloatArray, end: FloatArray) -> NDArray[np.int8]:
        return np.minimum(self._sight.blockers(start, end, ids=cells), _MOST).astype(np.int8)


@compiled
def square(grid: Grid, x: float, y: float) -> int:
    """The number of the square that a place lies in, the nearest one for a place outside."""
    return _line((x - grid.x_m) / _SQUARE_M, grid.columns) * grid.rows + _line((y - grid.y_m) / _SQUARE_M, grid.rows)


@compiled
def _line(place: float, count: int) -> int:
    """The whole number in [0, count) that is nearest to a place; 0 for NaN, which no comparison holds for."""
    if place >= count - 1:
        return count - 1
    return int(np.rint(place)) if place > 0 else 0


@compiled
def _rows(
    grid: Grid, between: NDArray[np.int8], from_ap: NDArray[np.int8], low: FloatArray
) -> tuple[NDArray[np.int8], list[tuple[int, int]]]:
    """`SightMap.blockers`, and the offices and lower squares that it does not know yet."""
    cells, users = low.shape[:2]
    rows = np.empty((cells, users + 1, between.shape[2]), np.int8)
    unknown = [(0, 0) for _ in range(0)]  # empty, and of a type that Numba can tell
    for cell in range(cells):
        office = cell % len(between)
        rows[cell, users] = from_ap[office]
        for k in range(users):
            lower = square(grid, low[cell, k, 0], low[cell, k, 1])
            rows[cell, k] = between[office, lower]
            if between[office, lower, 0] == _UNKNOWN and (office, lower) not in unknown:
                unknown.append((office, lower))
    return rows, unknown
