"""Plan-view outlines of everything solid, and exact distances to them."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.world.office import GROUP_BLOCKERS, GROUP_WALLS, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]
Rectangles = tuple[FloatArray, FloatArray, FloatArray]
"""Middles, half sides and axes, as in `Footprints`."""


@dataclass(frozen=True)
class Footprints:
    """Rectangles on the floor, B bricks and walls in each cell, or the same ones in all (E or 1).

    `centre` and `half` [2, E or 1, B] [m] are middles and half sides, `axis` [2, E or 1, B] the unit vector of a
    rectangle's own x direction.
    """

    centre: FloatArray
    half: FloatArray
    axis: FloatArray

    def of(self, cells: IntArray) -> "Footprints":
        """The footprints of some cells [n]."""
        if self.centre.shape[1] == 1:
            return self
        return Footprints(*(part[:, cells] for part in (self.centre, self.half, self.axis)))

    @cached_property
    def arrays(self) -> Rectangles:
        """What compiled loops work on."""
        centre, half, axis = (np.ascontiguousarray(part) for part in (self.centre, self.half, self.axis))
        return centre, half, axis

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from points [E, P, 2] [m] to the nearest rectangle, [E, P] [m]; zero inside one."""
        return _gaps(self.arrays, np.ascontiguousarray(points))

    def free_run(self, start: FloatArray, end: FloatArray, inflate: float) -> NDArray[np.bool_]:
        """Whether segments miss every rectangle grown by `inflate` [m], [E, P].

        From `start` [E, P or 1, 2] to `end` [E, P, 2] [m]. Grown rectangles keep square corners, which errs on the safe
        side.
        """
        return self.free_share(start, end, inflate) == np.inf

    def free_share(self, start: FloatArray, end: FloatArray, inflate: float) -> FloatArray:
        """The share of segments in [0, 1) before they enter a grown rectangle, inf where they never do, [E, P].

        Arguments as in `free_run`.
        """
        return _entries(self.arrays, np.ascontiguousarray(start), np.ascontiguousarray(end), inflate)


@compiled
def gap(rectangles: Rectangles, office: int, x: float, y: float) -> float:
    """Distance from a place to the nearest rectangle of an office [m]; zero inside one."""
    nearest = np.inf
    for b in range(rectangles[0].shape[2]):
        nearest = min(nearest, _squared_gap(rectangles, office, b, x, y))
    return math.sqrt(nearest)


@compiled
def near(rectangles: Rectangles, office: int, x: float, y: float, reach_m: float) -> Rectangles:
    """Those of an office's rectangles that are within reach of a place, as those of the only office."""
    count, close = 0, np.empty(rectangles[0].shape[2], np.int64)
    for b in range(len(close)):
        if _squared_gap(rectangles, office, b, x, y) <= reach_m * reach_m:
            close[count], count = b, count + 1
    centre, half, axis = np.empty((2, 1, count)), np.empty((2, 1, count)), np.empty((2, 1, count))
    for place in range(count):
        for i in range(2):
            centre[i, 0, place] = rectangles[0][i, office, close[place]]
            half[i, 0, place] = rectangles[1][i, office, close[place]]
            axis[i, 0, place] = rectangles[2][i, office, close[place]]
    return centre, half, axis


@compiled
def _squared_gap(rectangles: Rectangles, office: int, b: int, x: float, y: float) -> float:
    centre, half, axis = rectangles
    dx, dy = x - centre[0, office, b], y - centre[1, office, b]
    ax, ay = axis[0, office, b], axis[1, office, b]
    beyond_x = max(abs(dx * ax + dy * ay) - half[0, office, b], 0.0)
    beyond_y = max(abs(dy * ax - dx * ay) - half[1, office, b], 0.0)
    return beyond_x * beyond_x + beyond_y * beyond_y


@compiled
def toward(rectangles: Rectangles, office: int, b: int, x: float, y: float) -> tuple[float, float]:
    """The way from a place to the nearest point of a rectangle [m]; zero inside it."""
    centre, half, axis = rectangles
    dx, dy = x - centre[0, office, b], y - centre[1, office, b]
    ax, ay = axis[0, office, b], axis[1, office, b]
    along, across = dx * ax + dy * ay, dy * ax - dx * ay
    along = min(max(along, -half[0, office, b]), half[0, office, b]) - along
    across = min(max(across, -half[1, office, b]), half[1, office, b]) - across
    return along * ax - across * ay, along * ay + across * ax


@compiled
def entry(rectangles: Rectangles, office: int, x: float, y: float, u: float, v: float, inflate: float) -> float:
    """The share of a way (u, v) from (x, y) before it enters a rectangle grown by `inflate`, inf if it never does."""
    first = np.inf
    for b in range(rectangles[0].shape[2]):
        first = min(first, _entry_of(rectangles, office, b, x, y, u, v, inflate))
    return first


@compiled
def is_free(rectangles: Rectangles, office: int, x: float, y: float, u: float, v: float, inflate: float) -> bool:
    """Whether a way (u, v) from (x, y) misses every rectangle grown by `inflate`."""
    for b in range(rectangles[0].shape[2]):  # noqa: SIM110 - Numba compiles no generators
        if _entry_of(rectangles, office, b, x, y, u, v, inflate) < np.inf:
            return False
    return True


@compiled
def _entry_of(
    rectangles: Rectangles, office: int, b: int, x: float, y: float, u: float, v: float, inflate: float
) -> float:
    centre, half, axis = rectangles
    ax, ay = axis[0, office, b], axis[1, office, b]
    dx, dy = x - centre[0, office, b], y - centre[1, office, b]
    from_x, way_x, half_x = dx * ax + dy * ay, u * ax + v * ay, half[0, office, b] + inflate
    from_y, way_y, half_y = dy * ax - dx * ay, v * ax - u * ay, half[1, office, b] + inflate
    if _far_off(from_x, way_x, half_x) or _far_off(from_y, way_y, half_y):
        return np.inf
    enter, leave = slab(from_x, way_x, half_x, 0.0, 1.0)
    if enter < leave:
        enter, leave = slab(from_y, way_y, half_y, enter, leave)
        if enter < leave:
            return enter
    return np.inf


@compiled
def _far_off(origin: float, direction: float, half: float) -> bool:
    """Whether a whole way is clearly beyond `half` of zero in one coordinate, which shows without a division.

    Most rectangles are. The hair leaves whatever touches to `slab`.
    """
    return abs(2 * origin + direction) - abs(direction) > 2 * half + 1e-9


@compiled
def slab(origin: float, direction: float, half: float, enter: float, leave: float) -> tuple[float, float]:
    """The part of the shares (enter, leave) of a way at which it is within `half` of zero in one coordinate."""
    # A direction along the slab would divide zero by zero on its edge; the least number keeps it finite.
    inverse = 1 / (1e-300 if abs(direction) < 1e-300 else direction)
    middle, reach = -origin * inverse, abs(half * inverse)
    return max(enter, middle - reach), min(leave, middle + reach)


@compiled
def _gaps(rectangles: Rectangles, points: FloatArray) -> FloatArray:
    gaps = np.empty(points.shape[:2])
    for cell in range(points.shape[0]):
        office = cell % rectangles[0].shape[1]
        for p in range(points.shape[1]):
            gaps[cell, p] = gap(rectangles, office, points[cell, p, 0], points[cell, p, 1])
    return gaps


@compiled
def _entries(rectangles: Rectangles, start: FloatArray, end: FloatArray, inflate: float) -> FloatArray:
    shares = np.empty(end.shape[:2])
    for cell in range(end.shape[0]):
        office = cell % rectangles[0].shape[1]
        for p in range(end.shape[1]):
            x, y = start[cell, p % start.shape[1]]
            shares[cell, p] = entry(rectangles, office, x, y, end[cell, p, 0] - x, end[cell, p, 1] - y, inflate)
    return shares


def footprints(offices: list[Office], low_m: float, high_m: float) -> Footprints:
    """Footprints of the furniture and walls that stand between two heights [m], for one office or one a cell."""
    parts = zip(*(_rectangles(office, low_m, high_m) for office in offices), strict=True)
    return Footprints(*(np.moveaxis(np.stack(part), -1, 0).copy() for part in parts))


def _rectangles(office: Office, low_m: float, high_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, half sides and axis of what stands between two heights, [B, 2] each."""
    centre, half, axis = office.boxes(GROUP_BLOCKERS, GROUP_WALLS)[:3]
    reaches = (centre[:, 2] - half[:, 2] < high_m) & (centre[:, 2] + half[:, 2] > low_m)
    return centre[reaches, :2], half[reaches, :2], axis[reaches]
