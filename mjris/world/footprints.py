"""Plan-view outlines of everything solid, and exact distances to them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjris.world.office import GROUP_BLOCKERS, GROUP_WALLS, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Footprints:
    """Rectangles on the floor, B bricks and walls in each cell, or the same ones in all (E or 1).

    `centre` and `half` [2, E or 1, B] [m] are middles and half sides, `axis` [2, E or 1, B] the unit vector of a
    rectangle's own x direction. Coordinates come first: sums over an axis of length two are slow.
    """

    centre: FloatArray
    half: FloatArray
    axis: FloatArray

    def of(self, cells: IntArray) -> "Footprints":
        """The footprints of some cells [n]."""
        if self.centre.shape[1] == 1:
            return self
        return Footprints(*(part[:, cells] for part in (self.centre, self.half, self.axis)))

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from points [E, P, 2] [m] to the nearest rectangle, [E, P] [m]; zero inside one."""
        along, across = self._local(points)
        dx = np.maximum(np.abs(along) - self.half[0][:, None], 0)
        dy = np.maximum(np.abs(across) - self.half[1][:, None], 0)
        return np.sqrt((dx * dx + dy * dy).min(-1))

    def near(self, points: FloatArray, reach_m: float) -> "NearFootprints":
        """What lies within `reach_m` [m] of points [E, 2] [m], one a cell."""
        dx = points[:, 0, None] - self.centre[0]
        dy = points[:, 1, None] - self.centre[1]
        reach = reach_m + self._corner[:, 0]
        cell, brick = np.nonzero(dx * dx + dy * dy <= reach * reach)
        office = cell if self.centre.shape[1] > 1 else np.zeros_like(cell)
        return NearFootprints(
            cell, self.centre[:, office, brick], self.half[:, office, brick], self.axis[:, office, brick]
        )

    def free_run(self, start: FloatArray, end: FloatArray, inflate: float) -> NDArray[np.bool_]:
        """Whether segments start–end, both [E, P, 2] [m], miss every rectangle grown by `inflate` [m], [E, P].

        Grown rectangles keep square corners, which errs on the safe side.
        """
        return self.free_share(start, end, inflate) == np.inf

    def free_share(self, start: FloatArray, end: FloatArray, inflate: float) -> FloatArray:
        """The share of segments in [0, 1) before they enter a grown rectangle, inf where they never do, [E, P].

        Arguments as in `free_run`.
        """
        # Few rectangles are near a segment, and only for those the slabs are worked out.
        way = end - start
        reach = np.hypot(way[..., 0], way[..., 1])[..., None] + self._corner + math.sqrt(2) * inflate
        dx = start[..., 0, None] - self.centre[0][:, None]
        dy = start[..., 1, None] - self.centre[1][:, None]
        cell, segment, brick = near = np.nonzero(dx * dx + dy * dy <= reach * reach)
        office = cell if self.centre.shape[1] > 1 else np.zeros_like(cell)
        ax, ay = self.axis[:, office, brick]
        x, y = dx[near], dy[near]
        u, v = way[cell, segment].T
        enter, leave = np.zeros(1), np.ones(1)
        for origin, direction, half in (
            (x * ax + y * ay, u * ax + v * ay, self.half[0, office, brick]),
            (y * ax - x * ay, v * ax - u * ay, self.half[1, office, brick]),
        ):
            # A direction along the slab would divide zero by zero on its edge; the least number keeps it finite.
            inverse = 1 / np.where(np.abs(direction) < 1e-300, 1e-300, direction)
            middle = -origin * inverse
            slab = np.abs((half + inflate) * inverse)
            enter, leave = np.maximum(enter, middle - slab), np.minimum(leave, middle + slab)
        met = enter < leave
        share = np.full(way.shape[:-1], np.inf)
        np.minimum.at(share, (cell[met], segment[met]), enter[met])
        return share

    @cached_property
    def _corner(self) -> FloatArray:
        """From a rectangle's middle to its corners [E or 1, 1, B] [m]."""
        return np.hypot(*self.half)[:, None]

    def _local(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates of points [E, P, 2] along and across every rectangle, [E, P, B] each."""
        ax, ay = self.axis[:, :, None]
        x, y = points[..., 0, None], points[..., 1, None]
        along, across = x * ax, y * ax
        along += y * ay
        across -= x * ay
        for local, origin in zip((along, across), self._origin, strict=True):
            local -= origin
        return along, across

    @cached_property
    def _origin(self) -> FloatArray:
        """Coordinates of the rectangles' middles along and across them, [2, E or 1, 1, B] [m]."""
        (x, y), (ax, ay) = self.centre, self.axis
        return np.stack([x * ax + y * ay, y * ax - x * ay])[:, :, None]


@dataclass(frozen=True)
class NearFootprints:
    """The few rectangles that matter to each cell for a while: those of `Footprints`, [2, R], with their cells [R]."""

    cell: IntArray
    centre: FloatArray
    half: FloatArray
    axis: FloatArray

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from points [E, 2] [m] to the nearest of these rectangles, [E] [m]; inf where there is none."""
        x, y = points[self.cell].T - self.centre
        ax, ay = self.axis
        dx = np.maximum(np.abs(x * ax + y * ay) - self.half[0], 0)
        dy = np.maximum(np.abs(y * ax - x * ay) - self.half[1], 0)
        nearest = np.full(len(points), np.inf)
        np.minimum.at(nearest, self.cell, np.sqrt(dx * dx + dy * dy))
        return nearest


def footprints(offices: list[Office], low_m: float, high_m: float) -> Footprints:
    """Footprints of the furniture and walls that stand between two heights [m], for one office or one a cell."""
    parts = zip(*(_rectangles(office.model, low_m, high_m) for office in offices), strict=True)
    return Footprints(*(np.moveaxis(np.stack(part), -1, 0).copy() for part in parts))


def _rectangles(model: mujoco.MjModel, low_m: float, high_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, half sides and axis of what stands between two heights, [B, 2] each."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solid = np.isin(model.geom_group, (GROUP_BLOCKERS, GROUP_WALLS))
    centre, half = data.geom_xpos[solid], model.geom_size[solid]
    axis = data.geom_xmat[solid].reshape(-1, 3, 3)[:, :2, 0]
    reaches = (centre[:, 2] - half[:, 2] < high_m) & (centre[:, 2] + half[:, 2] > low_m)
    return centre[reaches, :2], half[reaches, :2], axis[reaches]
