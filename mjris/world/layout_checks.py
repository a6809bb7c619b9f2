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
THICKEST_WALL_M, _WALL_HEIGHT_M = 0.4, 1.2  # what is thicker or lower is no wall
_PARALLEL = math.radians(15)  # walls that are less apart are in one line


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
    size, outside = np.array(layout.room.size), outside_m(boxes, layout.room)
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


def outside_m(boxes: Boxes, room: "Room") -> _Floats:
    """How far bricks reach out of the room in x, y and z, [B, 3] [m]; negative where they do not."""
    extent = np.einsum("bk,bkd->bd", boxes.half, np.abs(boxes.axes))
    return np.maximum(extent - boxes.centre, boxes.centre + extent - np.array(room.size))


def _check_overlaps(layout: "Layout", boxes: Boxes, fail: Callable[[str], NoReturn]) -> None:
    i, j = _near_pairs(boxes)
    depth = overlap_m(boxes, i, j)
    for pair in np.flatnonzero(depth > _OVERLAP_M):
        if not _is_joint(boxes, i[pair], j[pair]):
            first, second = (layout.obstacles[boxes.owner[b[pair]]].name for b in (i, j))
            fail(f"obstacles {first} and {second} overlap by {depth[pair]:.2f} m")


def _near_pairs(boxes: Boxes) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bricks of different obstacles whose circles on the floor plan meet, the first of the lower obstacle: two [P].

    A sweep along x, so that time and memory grow with the pairs that are near.
    """
    reach = np.hypot(boxes.half[:, 0], boxes.half[:, 1])
    low = boxes.centre[:, 0] - reach
    by_low = np.argsort(low)
    ends = np.searchsorted(low[by_low], boxes.centre[by_low, 0] + reach[by_low])
    pairs = [np.empty((0, 2), np.intp)]
    for place, b in enumerate(by_low):
        others = by_low[place + 1 : ends[place]]
        apart = np.linalg.norm(boxes.centre[others, :2] - boxes.centre[b, :2], axis=1)
        met = others[(apart < reach[others] + reach[b]) & (boxes.owner[others] != boxes.owner[b])]
        pairs.append(np.stack([np.minimum(met, b), np.maximum(met, b)], 1))
    found = np.concatenate(pairs)
    return found[:, 0], found[:, 1]


def overlap_m(boxes: Boxes, i: NDArray[np.intp], j: NDArray[np.intp]) -> _Floats:
    """How far bricks i and j [P] sink into each other [P] [m]; negative where they are apart."""
    # Separating axes: as all boxes share z, the sides of both are all the directions that need a look.
    normals = np.concatenate([boxes.axes[i], boxes.axes[j]], axis=1)  # [P, 6, 3]
    reach = sum(np.einsum("pk,pnk->pn", boxes.half[b], np.abs(normals @ boxes.axes[b].swapaxes(1, 2))) for b in (i, j))
    apart = np.abs(np.einsum("pnd,pd->pn", normals, boxes.centre[j] - boxes.centre[i]))
    return (reach - apart).min(axis=1)


def _is_joint(boxes: Boxes, i: int, j: int) -> bool:
    """Whether two bricks are walls that meet: across each other, or end to end.

    Walls in one line may share as much of their length as the thicker one is thick.
    """
    if not (is_wall(boxes, i) and is_wall(boxes, j)):
        return False
    (along, length, thickness), (other, other_length, other_thickness) = (_wall(boxes, b) for b in (i, j))
    if abs(along[0] * other[1] - along[1] * other[0]) > math.sin(_PARALLEL):
        return True
    apart = abs(float((boxes.centre[j, :2] - boxes.centre[i, :2]) @ along))
    return (length + other_length) / 2 - apart <= max(thickness, other_thickness) + _TOUCH_M


def is_wall(boxes: Boxes, b: int) -> bool:
    """Whether a brick is the only one of its obstacle, stands on the floor, and is thin and high."""
    on_floor = boxes.centre[b, 2] - boxes.half[b, 2] <= _OVERLAP_M
    alone = (boxes.owner == boxes.owner[b]).sum() == 1
    thin = 2 * boxes.half[b, :2].min() <= THICKEST_WALL_M
    return bool(on_floor and alone and thin and 2 * boxes.half[b, 2] >= _WALL_HEIGHT_M)


def _wall(boxes: Boxes, b: int) -> tuple[_Floats, float, float]:
    """The direction [2] of a wall on the floor plan, its length and its thickness [m]."""
    long = int(boxes.half[b, 1] > boxes.half[b, 0])
    return boxes.axes[b, long, :2], 2 * float(boxes.half[b, long]), 2 * float(boxes.half[b, 1 - long])


def wall_distance(points: _Floats, room: "Room") -> _Floats:
    """Distance from points [..., 2] to the nearest wall [m]; negative outside."""
    return np.minimum(points, np.array(room.size[:2]) - points).min(axis=-1)
