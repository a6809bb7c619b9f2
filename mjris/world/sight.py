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
        own = np.broadcast_to(own_body, start.shape[:2])
        if self._all_alike:
            rows = [part.reshape(1, -1, *part.shape[2:]) for part in (start, end, own)]
            return self._count(*rows, ids=np.zeros(1, np.int64)).reshape(own.shape)
        return self._count(start, end, own, ids)

    def _count(self, start: FloatArray, end: FloatArray, own: IntArray, ids: IntArray | None) -> IntArray:
        """`blockers` for `own` [E, L]."""
        delta = end - start
        left = np.sqrt((delta * delta).sum(-1))
        direction = delta / np.maximum(left, _NUDGE_M)[..., None]
        count = np.zeros(left.shape, np.int64)
        row = np.arange(left.shape[0])[:, None]
        link = np.broadcast_to(np.arange(left.shape[1]), left.shape)
        # The open links' last hits and directions, and the bodies that do not count (again), the last met first.
        ray = np.concatenate([start, direction], -1)
        passed = own[..., None]
        while link.shape[1]:
            distance, geom = self._batch.ray(
                ray[..., :3], ray[..., 3:], geomgroup=self._groups, bodyexclude=passed[..., 0], ids=ids
            )
            hit = np.logical_and(geom >= 0, distance < left)
            body = np.where(hit, self._body_of_geom[geom], -1)
            new = np.logical_and(hit, (body[..., None] != passed).all(-1))
            count[row, link] += new
            order = _open_first(hit)
            # A finished link that is cast again, to fill a row, has nothing left to meet.
            step = np.where(hit, distance + _NUDGE_M, left)
            left = np.take_along_axis(left - step, order, 1)
            link = np.take_along_axis(link, order, 1)
            ray = np.take_along_axis(ray, order[..., None], 1)
            ray[..., :3] += np.take_along_axis(step, order, 1)[..., None] * ray[..., 3:]
            passed = np.take_along_axis(np.concatenate([body[..., None], passed], -1), order[..., None], 1)
        return count


def _open_first(hit: NDArray[np.bool_]) -> IntArray:
    """Places of the links that met something, first in each row, with others behind to make rows of equal length."""
    most = int(hit.sum(1).max(initial=0))
    return np.argsort(~hit, axis=1, kind="stable")[:, :most]
