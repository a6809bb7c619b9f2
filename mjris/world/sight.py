"""What is in the way of each link: the segment from end to end against every brick, and people and rovers if asked."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mjris.config import BODY_DB, MATERIALS
from mjris.jit.compiled import compiled
from mjris.world.footprints import slab
from mjris.world.office import GROUP_BLOCKERS, PERSON_HEIGHT_M, PERSON_RADIUS_M, Boxes, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Sight:
    """Counts the obstacles on straight links, or adds up what is lost in them.

    An obstacle is a body, however many of its bricks the link meets; what is lost, is lost in every brick. MuJoCo's
    rays (`mj_ray`) find the same ones, one a call; here all are found in one pass.
    """

    def __init__(
        self,
        offices: list[Office],
        people_xy: FloatArray | None = None,
        rovers: Callable[[], Boxes] | None = None,
        *,
        in_db: bool = False,
    ):
        """For one office or one a cell. People who count as well stand at `people_xy` [E, K, 2] [m], read anew.

        So do `rovers`, boxes with a leading axis of cells. `in_db` adds up losses [dB].
        """
        boxes = [office.losses(GROUP_BLOCKERS) if in_db else office.boxes(GROUP_BLOCKERS) for office in offices]
        self.bricks = Boxes(*map(np.stack, zip(*boxes, strict=True)))
        """All that count, with a leading axis of offices."""
        self._people_xy = np.empty((1, 0, 2)) if people_xy is None else people_xy
        self._person = BODY_DB if in_db else 1.0
        self._rover = MATERIALS["metal"].constant_db if in_db else 1.0
        self._rovers = rovers

    def blockers(
        self,
        start: FloatArray,
        end: FloatArray,
        own: IntArray | None = None,
        ids: IntArray | None = None,
        over_rover: NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """What is in the way from `start` to `end`, both [E, L, 3] [m]: [E, L].

        `own` [L] is a person who never counts for that link, -1 for nobody; `ids` are the cells, all by default.
        Rovers do not count for links that are `over_rover` [L], nor where that is not told.
        """
        cells, links = start.shape[:2]
        own = np.full(links, -1) if own is None else own
        ids = np.arange(cells) if ids is None else ids
        start, end = np.ascontiguousarray(start), np.ascontiguousarray(end)
        found = _blockers(self.bricks, self._people_xy, self._person, start, end, own, ids)
        if self._rovers is not None and over_rover is not None:
            _add_rovers(self._rovers(), self._rover, start, end, over_rover, found)
        return found


@compiled
def _blockers(
    bricks: Boxes, people: FloatArray, person: float, start: FloatArray, end: FloatArray, own: IntArray, ids: IntArray
) -> FloatArray:
    count = np.zeros(start.shape[:2])
    for e in range(start.shape[0]):
        office, crowd = ids[e] % bricks.centre.shape[0], ids[e] % people.shape[0]
        for link in range(start.shape[1]):
            x, y, z = start[e, link, 0], start[e, link, 1], start[e, link, 2]
            u, v, w = end[e, link, 0] - x, end[e, link, 1] - y, end[e, link, 2] - z
            count[e, link] = obstacles(bricks, office, x, y, z, u, v, w)
            for k in range(people.shape[1]):
                if k != own[link] and _meets_person(x - people[crowd, k, 0], y - people[crowd, k, 1], z, u, v, w):
                    count[e, link] += person
    return count


@compiled
def _add_rovers(
    rovers: Boxes, rover: float, start: FloatArray, end: FloatArray, over_rover: NDArray[np.bool_], count: FloatArray
) -> None:
    for e in range(start.shape[0]):
        for link in range(start.shape[1]):
            if not over_rover[link]:
                x, y, z = start[e, link, 0], start[e, link, 1], start[e, link, 2]
                u, v, w = end[e, link, 0] - x, end[e, link, 1] - y, end[e, link, 2] - z
                count[e, link] += rover * obstacles(rovers, e, x, y, z, u, v, w)


@compiled
def obstacles(bricks: Boxes, office: int, x: float, y: float, z: float, u: float, v: float, w: float) -> float:
    """What a way (u, v, w) from (x, y, z) in an office goes through: the weights of all bodies."""
    count, last = 0.0, -1
    for b in range(bricks.body.shape[1]):
        if bricks.body[office, b] != last and _meets_brick(bricks, office, b, x, y, z, u, v, w):
            last = bricks.body[office, b]
            count += bricks.weight[office, b]
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
