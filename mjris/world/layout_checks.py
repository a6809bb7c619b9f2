"""Whether a layout is possible: everything within the room, nothing in the same place, floor for the rover."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from mjris.config import ConfigError

if TYPE_CHECKING:
    from mjris.world.layout import Layout, Room

_Floats = NDArray[np.float64]

ROVER_RADIUS_M = 0.3
"""Around the rover's start, this much floor is free of bricks and walls [m]."""
OVERHEAD_M = 2.0
"""Bricks whose underside is at this height or above do not occupy floor [m]."""

_TOUCH_M = 1e-6  # rounding allowed where a brick touches a wall
_OVERLAP_M = 0.01  # how far bricks of two obstacles may sink into each other
_GRID_M = 0.25
_PASSAGE_M = 0.4  # floor counts as free further than this from bricks and walls
_LEAST_FLOOR_M2 = 5.0
_LEAST_FLOOR_SHARE = 0.05


class _Boxes(NamedTuple):
    """All bricks of a layout in the room's frame; row b belongs to obstacle owner[b]."""

    centre: _Floats  # [B, 3]
    half: _Floats  # [B, 3]
    axes: _Floats  # [B, 3, 3], rows are the unit vectors along the box's sides
    owner: NDArray[np.intp]  # [B]


def check_layout(layout: "Layout", source: str = "layout") -> None:
    """Check that everything fits in the room, nothing overlaps, and the rover has floor to drive on.

    Raises `ConfigError`, naming the obstacles at fault; `source` says where the layout comes from.
    """
    boxes = _boxes(layout)

    def fail(message: str) -> NoReturn:
        raise ConfigError(f"{source}: {message}")

    _check_inside(layout, boxes, fail)
    _check_overlaps(layout, boxes, fail)
    _check_start(layout, boxes, fail)
    _check_floor(layout, boxes, fail)


def _boxes(layout: "Layout") -> _Boxes:
    centre, half, axes, owner = [], [], [], []
    for index, obstacle in enumerate(layout.obstacles):
        cos, sin = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        frame = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        for brick in obstacle.bricks:
            centre.append(np.array([*obstacle.position, 0]) + np.array(brick.at) @ frame)
            half.append(np.array(brick.size) / 2)
            axes.append(frame)
            owner.append(index)
    return _Boxes(
        np.reshape(centre, (-1, 3)), np.reshape(half, (-1, 3)), np.reshape(axes, (-1, 3, 3)), np.array(owner, np.intp)
    )


def _plan_distance(points: _Floats, boxes: _Boxes, b: int) -> _Floats:
    """Distance in the plan view from points [..., 2] to brick b [m]; zero within it."""
    local = np.abs((points - boxes.centre[b, :2]) @ boxes.axes[b, :2, :2].T) - boxes.half[b, :2]
    return np.hypot(*np.moveaxis(np.maximum(local, 0), -1, 0))


def _check_inside(layout: "Layout", boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    size = np.array(layout.room.size)
    extent = np.einsum("bk,bkd->bd", boxes.half, np.abs(boxes.axes))
    outside = np.maximum(extent - boxes.centre, boxes.centre + extent - size)  # [B, 3]
    for b, d in np.argwhere(outside > _TOUCH_M):
        side = ("a wall in x", "a wall in y", "the floor or the ceiling")[d]
        fail(f"obstacle {layout.obstacles[boxes.owner[b]].name} sticks through {side} by {outside[b, d]:.2f} m")
    position = np.array(layout.ap.position)
    if (position < 0).any() or (position > size).any():
        fail(f"ap.position: {list(layout.ap.position)} is not allowed: the room spans 0 to {list(layout.room.size)}")
    local = np.abs(np.einsum("bkd,bd->bk", boxes.axes, position - boxes.centre))
    for b in np.flatnonzero((local < boxes.half).all(axis=1)):
        name = layout.obstacles[boxes.owner[b]].name
        fail(f"ap.position: {list(layout.ap.position)} is not allowed: it lies within obstacle {name}")


def _check_overlaps(layout: "Layout", boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    i, j = np.nonzero(boxes.owner[:, None] < boxes.owner)
    # Separating axes: as all boxes share z, the sides of both are all the directions that need a look.
    normals = np.concatenate([boxes.axes[i], boxes.axes[j]], axis=1)  # [P, 6, 3]
    reach = sum(np.einsum("pk,pnk->pn", boxes.half[b], np.abs(normals @ boxes.axes[b].swapaxes(1, 2))) for b in (i, j))
    apart = np.abs(np.einsum("pnd,pd->pn", normals, boxes.centre[j] - boxes.centre[i]))
    depth = (reach - apart).min(axis=1)
    for pair in np.flatnonzero(depth > _OVERLAP_M):
        first, second = (layout.obstacles[boxes.owner[b[pair]]].name for b in (i, j))
        fail(f"obstacles {first} and {second} overlap by {depth[pair]:.2f} m")


def _standing(boxes: _Boxes) -> NDArray[np.intp]:
    """Indices of the bricks that occupy floor."""
    return np.flatnonzero(boxes.centre[:, 2] - boxes.half[:, 2] < OVERHEAD_M)


def _wall_distance(points: _Floats, room: "Room") -> _Floats:
    """Distance from points [..., 2] to the nearest wall [m]; negative outside."""
    return np.minimum(points, np.array(room.size[:2]) - points).min(axis=-1)


def _check_start(layout: "Layout", boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    start = np.array(layout.start)
    shown = f"rover.start: {list(layout.start)} is not allowed"
    if _wall_distance(start, layout.room) < ROVER_RADIUS_M:
        fail(f"{shown}: it must be at least {ROVER_RADIUS_M} m inside the room's walls")
    for b in _standing(boxes):
        if _plan_distance(start, boxes, b) < ROVER_RADIUS_M:
            fail(f"{shown}: it is within {ROVER_RADIUS_M} m of obstacle {layout.obstacles[boxes.owner[b]].name}")


def _check_floor(layout: "Layout", boxes: _Boxes, fail: Callable[[str], NoReturn]) -> None:
    floor_m2 = layout.room.size[0] * layout.room.size[1]
    area = _reachable_m2(layout, boxes)
    least = max(_LEAST_FLOOR_M2, _LEAST_FLOOR_SHARE * floor_m2)
    if area < least:
        fail(f"no free floor: the rover can reach {area:.1f} m² from its start, and at least {least:.1f} m² are needed")


def _reachable_m2(layout: "Layout", boxes: _Boxes) -> float:
    """Area connected to the rover's start where everything is further than the passage clearance [m²]."""
    x, y = (np.arange(_GRID_M / 2, side, _GRID_M) for side in layout.room.size[:2])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    free = _wall_distance(points, layout.room) > _PASSAGE_M
    for b in _standing(boxes):
        free &= _plan_distance(points, boxes, b) > _PASSAGE_M
    from_start = np.where(free, np.linalg.norm(points - layout.start, axis=-1), np.inf)
    reached = np.zeros_like(free)
    reached.flat[from_start.argmin()] = True
    reached &= free
    while True:  # flood fill, one ring a pass
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown &= free
        if (grown == reached).all():
            return float(reached.sum()) * _GRID_M**2
        reached = grown
