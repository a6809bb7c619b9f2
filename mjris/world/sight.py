"""Which obstacles block each link: the segment from end to end against every brick, and every person if asked."""

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.world.footprints import slab
from mjris.world.office import GROUP_BLOCKERS, PERSON_HEIGHT_M, PERSON_RADIUS_M, Boxes, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Sight:
    """Counts the obstacles on straight links.

    An obstacle is a body, however many of its bricks the link meets. MuJoCo's rays (`mj_ray`) find the same ones, one
    a call; here all are found in one pass.
    """

    def __init__(self, offices: list[Office], people_xy: FloatArray | None = None):
        """For one office or one a cell. People who count as well stand at `people_xy` [E, K, 2] [m], read anew."""
        self.bricks = Boxes(*map(np.stack, zip(*(office.boxes(GROUP_BLOCKERS) for office in offices), strict=True)))
        """All that count, with a leading axis of offices."""
        self._people_xy = np.empty((1, 0, 2)) if people_xy is None else people_xy

    def blockers(
        self, start: FloatArray, end: FloatArray, own: IntArray | None = None, ids: IntArray | None = None
    ) -> IntArray:
        """Obstacles between `start` and `end`, both [E, L, 3] [m]: [E, L].

        `own` [L] is a person who never counts for that link, -1 for nobody; `ids` are the cells, all by default.
        """
        cells, links = start.shape[:2]
        own = np.full(links, -1) if own is None else own
        ids = np.arange(cells) if ids is None else ids
        return _blockers(self.bricks, self._people_xy, np.ascontiguousarray(start), np.ascontiguousarray(end), own, ids)


@compiled
def _blockers(
    bricks: Boxes, people: FloatArray, start: FloatArray, end: FloatArray, own: IntArray, ids: IntArray
) -> IntArray:
    count = np.zeros(start.shape[:2], np.int64)
    for e in range(start.shape[0]):
        office, crowd = ids[e] % bricks.centre.shape[0], ids[e] % people.shape[0]
        for link in range(start.shape[1]):
            x, y, z = start[e, link, 0], start[e, link, 1], start[e, link, 2]
            u, v, w = end[e, link, 0] - x, end[e, link, 1] - y, end[e, link, 2] - z
            count[e, link] = obstacles(bricks, office, x, y, z, u, v, w)
            for k in range(people.shape[1]):
                if k != own[link] and _meets_person(x - people[crowd, k, 0], y - people[crowd, k, 1], z, u, v, w):
                    count[e, link] += 1
    return count


@compiled
def obstacles(bricks: Boxes, office: int, x: float, y: float, z: float, u: float, v: float, w: float) -> int:
    """How many bodies a way (u, v, w) from (x, y, z) in an office goes through."""
    count, last = 0, -1
    for b in range(bricks.body.shape[1]):
        if bricks.body[office, b] != last and _meets_brick(bricks, office, b, x, y, z, u, v, w):
            last = bricks.body[office, b]
            count += 1
    return count


@compiled
def _meets_brick(
    bricks: Boxes, office: int, b: int, x: float, y: float, z: float, u: float, v: float, w: float
) -> bool:
    """Whether a way (u, v, w) from (x, y, z) goes through a brick."""
    half_z, dz = bricks.half[office, b, 2], z - bricks.centre[office, b, 2]
    if min(dz, dz + w) > half_z or max(dz, dz + w) < -half_z:
        return False
    dx, dy = x - bricks.centre[office, b, 0], y - bricks.centre[office, b, 1]
    ax, ay = bricks.axis[office, b, 0], bricks.axis[office, b, 1]
    enter, leave = slab(dx * ax + dy * ay, u * ax + v * ay, bricks.half[office, b, 0], 0.0, 1.0)
    if enter >= leave:
        return False
    enter, leave = slab(dy * ax - dx * ay, v * ax - u * ay, bricks.half[office, b, 1], enter, leave)
    if enter >= leave:
        return False
    enter, leave = slab(dz, w, half_z, enter, leave)
    return enter < leave


@compiled
def _meets_person(x: float, y: float, z: float, u: float, v: float, w: float) -> bool:
    """Whether a way (u, v, w) from (x, y, z), seen from a person's feet, goes through the person's capsule.

    Then it comes within the radius of the capsule's upright axis: of one of its ends, or of the part between.
    """
    low, high = PERSON_RADIUS_M, PERSON_HEIGHT_M - PERSON_RADIUS_M
    flat = u * u + v * v
    nearest = np.inf
    for end in (low, high):
        # Nearest to an end of the axis, as to a ball.
        length = flat + w * w
        share = 0.0 if length == 0 else min(max(-(x * u + y * v + (z - end) * w) / length, 0.0), 1.0)
        dx, dy, dz = x + share * u, y + share * v, z + share * w - end
        nearest = min(nearest, dx * dx + dy * dy + dz * dz)
    # Nearest to the axis as to a cylinder, where the way is beside it.
    enter, leave = slab(z - (low + high) / 2, w, (high - low) / 2, 0.0, 1.0)
    if enter < leave:
        share = enter if flat == 0 else min(max(-(x * u + y * v) / flat, enter), leave)
        dx, dy = x + share * u, y + share * v
        nearest = min(nearest, dx * dx + dy * dy)
    return nearest < PERSON_RADIUS_M * PERSON_RADIUS_M
