"""Sight between squares of the floor, cast once when first asked for: what a radio map can know beforehand."""

import numpy as np
from numpy.typing import NDArray

from mjris.world.sight import Sight

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_SQUARE_M = 0.5
_UNKNOWN = -1


class SightMap:
    """Obstacles between places at two heights and to an access point, by the squares that the places lie in.

    Squares have their middles half a metre apart, one of them on the rover's start, as the nodes of `Paths` do.

    For one office or one a cell, as in `Footprints`. Memory: n² bytes an office with n squares.
    """

    def __init__(
        self, sight: Sight, room_m: FloatArray, start: FloatArray, ap: FloatArray, low_m: float, high_m: float
    ):
        """`room_m` and `start` [2], `ap` [E or 1, 3] [m]; links lead from `low_m` [m] up to `high_m`, or to the AP."""
        self._sight = sight
        self._offices = len(ap)
        self._origin = start - np.rint(start / _SQUARE_M) * _SQUARE_M
        self._shape = np.rint((room_m - self._origin) / _SQUARE_M).astype(int) + 1
        index = np.stack(np.meshgrid(*map(np.arange, self._shape), indexing="ij"), -1).reshape(-1, 2)
        # Squares at the walls have their middles pulled inside.
        middles = np.clip(self._origin + index * _SQUARE_M, 0.01, room_m - 0.01)
        self._low, self._high = (np.insert(middles, 2, height, 1) for height in (low_m, high_m))
        self._between = np.full((self._offices, len(middles), len(middles)), _UNKNOWN, np.int8)
        """By office, lower square and upper square."""
        high = np.broadcast_to(self._high, (self._offices, *self._high.shape))
        self._from_ap = self._cast(np.arange(self._offices), np.broadcast_to(ap[:, None], high.shape), high)

    def between(self, low: FloatArray, high: FloatArray) -> IntArray:
        """Obstacles between places [E, K, 2] [m] at the lower and [E, P, 2] [m] at the upper height, [E, P, K]."""
        office = self._office(len(low))
        lower, upper = self._square(low), self._square(high)
        self._fill(office, lower)
        return self._between[office[:, None, None], lower[:, None], upper[:, :, None]].astype(np.int64)

    def from_ap(self, high: FloatArray) -> IntArray:
        """Obstacles between the AP and places [E, P, 2] [m] at the upper height, [E, P]."""
        return self._from_ap[self._office(len(high))[:, None], self._square(high)]

    def _fill(self, office: IntArray, lower: IntArray) -> None:
        """Cast the links of lower squares [E, K] that are not known yet."""
        unknown = self._between[office[:, None], lower, 0] == _UNKNOWN
        offices = np.broadcast_to(office[:, None], lower.shape)[unknown]
        for square_office, square in {*zip(offices.tolist(), lower[unknown].tolist(), strict=True)}:
            start = np.broadcast_to(self._low[square], (1, *self._high.shape))
            row = self._cast(np.array([square_office]), start, self._high[None])
            self._between[square_office, square] = row[0]

    def _cast(self, cells: IntArray, start: FloatArray, end: FloatArray) -> IntArray:
        return self._sight.blockers(start, end, ids=cells)

    def _office(self, cells: int) -> IntArray:
        return np.arange(cells) % self._offices

    def _square(self, places: FloatArray) -> IntArray:
        """The squares that places [..., 2] [m] lie in [...], the nearest ones for places outside."""
        index = np.clip(np.rint((places - self._origin) / _SQUARE_M).astype(np.int64), 0, self._shape - 1)
        return index[..., 0] * self._shape[1] + index[..., 1]
