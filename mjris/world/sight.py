"""Which obstacles block each link: rays from transmitter to receiver, one obstacle further each round."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.world.office import GROUP_BLOCKERS, GROUP_PEOPLE, Office

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_NUDGE_M = 1e-6
"""How far behind a hit the next ray starts, so that touching obstacles cannot hold it up."""


class Sight:
    """Counts the obstacles on straight links, for every cell of a batch in one call a round.

    An obstacle is a body, however many of its bricks the link meets. With `body_blockage` people count as well,
    except the link's own user.
    """

    def __init__(self, office: Office, batch: Batch, body_blockage: bool, own_furniture: bool):
        """`own_furniture` says that cells differ in it, and each has to cast its rays itself."""
        self._batch = batch
        self._body_of_geom = office.model.geom_bodyid.astype(np.int64)
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[GROUP_BLOCKERS] = 1
        self._groups[GROUP_PEOPLE] = body_blockage
        self._all_alike = not (body_blockage or own_furniture)

    def blockers(self, start: FloatArray, end: FloatArray, own_body: IntArray, ids: IntArray | None = None) -> IntArray:
        """Obstacles between `start` and `end`, both [E, L, 3] [m]: [E, L].

        `own_body` [L] is a body that never counts for that link, -1 for none; `ids` are the cells, all by default.
        """
        cells, links = start.shape[:2]
        ids = np.arange(cells) if ids is None else ids
        cell = np.repeat(ids, links)
        link = np.arange(cells * links)
        point, delta = start.reshape(-1, 3), (end - start).reshape(-1, 3)
        left = np.sqrt((delta * delta).sum(-1))
        direction = delta / np.maximum(left, _NUDGE_M)[:, None]
        # Bodies that do not count (again), the last met first.
        passed = np.broadcast_to(own_body, (cells, links)).reshape(-1, 1)
        count = np.zeros(cells * links, np.int64)
        while len(link):
            distance, geom = self._cast(point, direction, passed[:, 0], cell)
            hit = np.flatnonzero((geom >= 0) & (distance < left))
            body = self._body_of_geom[geom[hit]]
            link, cell, passed = link[hit], cell[hit], passed[hit]
            count[link] += (body[:, None] != passed).all(-1)
            step = distance[hit] + _NUDGE_M
            left = left[hit] - step
            direction = direction[hit]
            point = point[hit] + step[:, None] * direction
            passed = np.concatenate([body[:, None], passed], -1)
        return count.reshape(cells, links)

    def _cast(
        self, point: FloatArray, direction: FloatArray, exclude: IntArray, cell: IntArray
    ) -> tuple[FloatArray, IntArray]:
        """First hits of rays [n] in their cells, sorted by those: distances [n] [m] and geoms [n], -1 for none."""
        if self._all_alike:
            # One cell can cast for all.
            distance, geom = self._batch.ray(point, direction, self._groups, bodyexclude=exclude, ids=[0])
            return distance[0], geom[0]
        ids, first, size = np.unique(cell, return_index=True, return_counts=True)
        at = np.repeat(np.arange(len(ids)), size), np.arange(len(cell)) - np.repeat(first, size)
        shape = (len(ids), size.max())
        points, directions, excluded = np.zeros((*shape, 3)), np.tile([0.0, 0.0, 1.0], (*shape, 1)), np.full(shape, -1)
        points[at], directions[at], excluded[at] = point, direction, exclude
        distance, geom = self._batch.ray(points, directions, self._groups, bodyexclude=excluded, ids=ids)
        return distance[at], geom[at]
