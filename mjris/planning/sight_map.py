"""Sight between squares of the floor, cast once when first asked for: what a radio map can know beforehand."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.world.office import Boxes
from mjris.world.sight import Sight, obstacles

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
Counts = NDArray[np.int16]

_SQUARE_M = 0.5
_MOST_SQUARES = 4000
"""On a floor of more of them, 1,000 m², only the AP's sight is kept: memory grows with their square."""
_UNKNOWN = -1
_STEPS = 10
"""Of what is kept, in one obstacle or dB: whole numbers take a quarter of the room."""


class Grid(NamedTuple):
    """The floor in s squares, which are numbered along y first."""

    x_m: float
    y_m: float
    """Middle of the first one."""
    columns: int
    """How many there are along x."""
    rows: int
    """How many there are along y."""


class Seen(NamedTuple):
    """Obstacles between the present places of users, the AP, and any place at the upper height, in E cells."""

    grid: Grid
    rows: Counts
    """From the squares of users and, last, the AP to all squares, in tenths [E, K + 1, s]; of the AP alone on a large
    floor [E, 1, s]."""
    low: FloatArray
    """Users [E, K, 2] [m]."""
    low_m: float
    """Their height, the lower one [m]."""
    high_m: float
    """The upper one [m]."""
    bricks: Boxes
    """What is in the way."""

    @property
    def through_everything(self) -> "Seen":
        """The same with nothing in the way."""
        cells, users = self.low.shape[:2]
        return self._replace(rows=np.zeros((cells, users + 1, self.rows.shape[2]), np.int16))


class SightMap:
    """Obstacles between places at two heights and to an access point, by the squares that the places lie in.

    Squares have their middles half a metre apart, one of them on the rover's start, as the nodes of `Paths` do.

    For one office or one a cell, as in `Footprints`. Memory grows with the squares that were asked for: two bytes for
    each of them and each of the s squares of the floor. On a large floor links from users are cast every time, from
    place to place.
    """

    def __init__(
        self, sight: Sight, room_m: FloatArray, start: FloatArray, ap: FloatArray, low_m: float, high_m: float
    ):
        """`room_m` and `start` [2], `ap` [E or 1, 3] [m]; links lead from `low_m` [m] up to `high_m`, or to the AP."""
        self._sight = sight
        self._heights_m = low_m, high_m
        origin = start - np.rint(start / _SQUARE_M) * _SQUARE_M
        columns, rows = (np.rint((room_m - origin) / _SQUARE_M).astype(int) + 1).tolist()
        self.grid = Grid(float(origin[0]), float(origin[1]), columns, rows)
        index = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
        # Squares at the walls have their middles pulled inside.
        middles = np.clip(origin + index * _SQUARE_M, 0.01, room_m - 0.01)
        self._low, self._high = (np.insert(middles, 2, height, 1) for height in (low_m, high_m))
        high = np.broadcast_to(self._high, (len(ap), *self._high.shape))
        self._from_ap = self._cast(np.arange(len(ap)), np.broadcast_to(ap[:, None], high.shape), high)
        self._known = np.empty((0, len(middles)), np.int16)
        """Rows of lower squares, of which some are still empty [r, s]."""
        self._row_of = np.full((len(ap), len(middles)), _UNKNOWN, np.int32)
        """Where the row of an office's lower square is, [offices, s]."""
        self._filled = 0

    def seen(self, low: FloatArray) -> Seen:
        """What is `Seen` from places `low` [E, K, 2] [m] at the lower height."""
        large = len(self._high) > _MOST_SQUARES
        rows = self._from_ap[np.arange(len(low)) % len(self._from_ap), None] if large else self._table(low)
        return Seen(self.grid, rows, low, *self._heights_m, self._sight.bricks)

    def _table(self, low: FloatArray) -> Counts:
        rows, unknown = _rows(self.grid, self._known, self._row_of, self._from_ap, low)
        if not unknown:
            return rows
        for office, lower in unknown:
            start = np.broadcast_to(self._low[lower], (1, *self._high.shape))
            self._keep(office, lower, self._cast(np.array([office]), start, self._high[None])[0])
        return self._table(low)

    def _keep(self, office: int, lower: int, row: Counts) -> None:
        if self._filled == len(self._known):
            more = np.empty((max(self._filled, 16), self._known.shape[1]), np.int16)
            self._known = np.concatenate([self._known, more])
        self._known[self._filled], self._row_of[office, lower] = row, self._filled
        self._filled += 1

    def _cast(self, cells: IntArray, start: FloatArray, end: FloatArray) -> Counts:
        obstacles = np.rint(_STEPS * self._sight.blockers(start, end, ids=cells))
        return np.minimum(obstacles, np.iinfo(np.int16).max).astype(np.int16)


@compiled
def write_obstacles(seen: Seen, cell: int, end: int, x: FloatArray, y: FloatArray, behind: FloatArray) -> None:
    """Write the obstacles between a user, or the AP as the last end, and P places at the upper height to `behind`."""
    row = end - (seen.low.shape[1] + 1 - seen.rows.shape[1])
    if row >= 0:
        for p in range(len(x)):
            behind[p] = seen.rows[cell, row, square(seen.grid, x[p], y[p])] / _STEPS
        return
    office, from_x, from_y = cell % len(seen.bricks.body), seen.low[cell, end, 0], seen.low[cell, end, 1]
    for p in range(len(x)):
        way = x[p] - from_x, y[p] - from_y, seen.high_m - seen.low_m
        behind[p] = obstacles(seen.bricks, office, from_x, from_y, seen.low_m, *way)


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
    grid: Grid, known: Counts, row_of: NDArray[np.int32], from_ap: Counts, low: FloatArray
) -> tuple[Counts, list[tuple[int, int]]]:
    """`Seen.rows`, and the offices and lower squares that are not known yet."""
    cells, users = low.shape[:2]
    rows = np.empty((cells, users + 1, from_ap.shape[1]), np.int16)
    unknown = [(0, 0) for _ in range(0)]  # empty, and of a type that Numba can tell
    for cell in range(cells):
        office = cell % len(row_of)
        rows[cell, users] = from_ap[office]
        for k in range(users):
            lower = square(grid, low[cell, k, 0], low[cell, k, 1])
            row = row_of[office, lower]
            if row != _UNKNOWN:
                rows[cell, k] = known[row]
            elif (office, lower) not in unknown:
                unknown.append((office, lower))
    return rows, unknown
