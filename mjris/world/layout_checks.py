"""Whether a layout is possible by itself: everything within the room, and nothing in the same place."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from mjris.config import ConfigError

if TYPE_CHECKING:
    from mjris.world.layout import Layout, Room

_Floats = NDArray[np.float64]

_TOUCH_M = 1e-6  # rounding allowed where a brick touches a wall
_OVERLAP_M = 0.01  # how far bricks of two obstacles may sink into each other


class Boxes(NamedTuple):
    """All bricks of a layout in the room's frame; row b belongs to obstacle owner[b]."""

    centre: _Floats  # [B, 3]
    half: _Floats  # [B, 3]
    axes: _Floats  # [B, 3, 3], rows are the unit vectors along the box's sides
    owner: NDArray[np.intp]  # [B]

    def between(self, low_m: float, high_m: float) -> NDArray[np.intp]:
        """Indices of the bricks that stand between two heights [m]."""
        z, half = self.centre[:, 2], self.half[:, 2]
        return np.flatnonzero((z - half < high_m) & (z + half > low_m))


def check_layout(layout: "Layout", source: str = "layout") -> None:
    """Check that everything fits in the room and nothing overlaps; `fit.check_fit` checks what depends on a config.

    Raises `ConfigError`, naming the obstacles at fault; `source` says where the layout comes from.
    """
    boxes = boxes_of(layout)

    def fail(message: str) -> NoReturn:
        raise ConfigError(f"{source}: {message}")

    _check_inside(layout, boxes, fail)
    _check_overlaps(layout, boxes, fail)


def boxes_of(layout: "Layout") -> Boxes:
    """The bricks of a layout."""
    centre, half, axes, owner = [], [], [], []
    for index, obstacle in enumerate(layout.obstacles):
        cos, sin = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        frame = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        for brick in obstacle.bricks:
            centre.append(np.array([*obstacle.position, 0]) + np.array(brick.at) @ frame)
            half.append(np.array(brick.size) / 2)
            axes.append(frame)
            owner.append(index)
    return Boxes(
        np.reshape(centre, (-1, 3)), np.reshape(half, (-1, 3)), np.reshape(axes, (-1, 3, 3)), np.array(owner, np.intp)
    )


def plan_distance(points: _Floats, boxes: Boxes, b: int) -> _Floats:
    """Distance in the plan view from points [..., 2] to brick b [m]; zero within it."""
    local = np.abs((points - boxes.centre[b, :2]) @ boxes.axes[b, :2, :2].T) - boxes.half[b, :2]
    return np.hypot(*np.moveaxis(np.maximum(local, 0), -1, 0))


def _check_inside(layout: "Layout", boxes: Boxes, fail: Callable[[str], NoReturn]) -> None:
    size = np.array(layout.room.size)
    extent = np.einsum("bk,bkd->bd", boxes.half, np.abs(boxes.axes))
    outside = np.maximum(extent - boxes.centre, boxes.centre + extent - size)  # [B, 3]
    for b, d in np.argwhere(outside > _TOUCH_M):
        side = ("a wall in x", "a wall in y", "the floor or the ceiling")[d]
        fail(f"obstacle {layout.obstacles[boxes.owner[b]].name} sticks through {side} by {outside[b, d]:.2f} m")
    position = np.array(layout.ap.position)
    if (position <= 0).any() or (position >= size).any():
        fail(
            f"ap.position: {list(layout.ap.position)} is not allowed: the room spans 0 to {list(layout.room.size)}, "
            f"and it must lie within"
        )
    local = np.abs(np.einsum("bkd,bd->bk", boxes.axes, position - boxes.centre))
    for b in np.flatnonzero((local < boxes.half).all(axis=1)):
        name = layout.obstacles[boxes.owner[b]].name
        fail(f"ap.position: {list(layout.ap.position)} is not allowed: it lies within obstacle {name}")


def _check_overlaps(layout: "Layout", boxes: Boxes, fail: Callable[[str], NoReturn]) -> None:
    i, j = np.nonzero(boxes.owner[:, None] < boxes.owner)
    # Separating axes: as all boxes share z, the sides of both are all the directions that need a look.
    normals = np.concatenate([boxes.axes[i], boxes.axes[j]], axis=1)  # [P, 6, 3]
    reach = sum(np.einsum("pk,pnk->pn", boxes.half[b], np.abs(normals @ boxes.axes[b].swapaxes(1, 2))) for b in (i, j))
    apart = np.abs(np.einsum("pnd,pd->pn", normals, boxes.centre[j] - boxes.centre[i]))
    depth = (reach - apart).min(axis=1)
    for pair in np.flatnonzero(depth > _OVERLAP_M):
        first, second = (layout.obstacles[boxes.owner[b[pair]]].name for b in (i, j))
        fail(f"obstacles {first} and {second} overlap by {depth[pair]:.2f} m")


def wall_distance(points: _Floats, room: "Room") -> _Floats:
    """Distance from points [..., 2] to the nearest wall [m]; negative outside."""
    return np.minimum(points, np.array(room.size[:2]) - points).min(axis=-1)
