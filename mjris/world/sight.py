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

    def __init__(self, office: Office, batch: Batch, body_blockage: bool):
        self._batch = batch
        self._body_of_geom = office.model.geom_bodyid.astype(np.int64)
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[GROUP_BLOCKERS] = 1
        self._groups[GROUP_PEOPLE] = body_blockage

    def blockers(self, start: FloatArray, end: FloatArray, own_body: IntArray, ids: IntArray | None = None) -> IntArray:
        """Obstacles between `start` and `end`, both [E, L, 3] [m]: [E, L].

        `own_body` [L] is a body that never counts for that link, -1 for none; `ids` are the cells, all by default.
        """
        delta = end - start
        length = np.sqrt((delta * delta).sum(-1))
        direction = delta / np.maximum(length, _NUDGE_M)[..., None]
        own = np.broadcast_to(own_body, length.shape)

        row = np.arange(length.shape[0])[:, None]
        link = np.broadcast_to(np.arange(length.shape[1]), length.shape)
        travelled = np.zeros_like(length)
        exclude = np.array(own)
        seen: list[IntArray] = []
        count = np.zeros(length.shape, np.int64)
        while link.shape[1]:
            at = (row, link)
            distance, geom = self._batch.ray(
                start[at] + travelled[at][..., None] * direction[at],
                direction[at],
                geomgroup=self._groups,
                bodyexclude=exclude[at],
                ids=ids,
            )
            reach = travelled[at] + distance
            hit = (geom >= 0) & (reach < length[at])
            body = np.where(hit, self._body_of_geom[geom], -1)
            new = hit & (body != own[at])
            for earlier in seen:
                new &= body != earlier[at]
            met = np.full(length.shape, -1)
            met[at] = np.where(new, body, -1)
            seen.append(met)
            count[at] += new
            exclude[at] = body
            # A finished link that is cast again starts at its end and meets nothing.
            travelled[at] = np.where(hit, reach + _NUDGE_M, length[at])
            link = _still_open(link, hit)
        return count


def _still_open(link: IntArray, hit: NDArray[np.bool_]) -> IntArray:
    """The links that met something, first in each row, the rows padded with finished ones to equal length."""
    most = int(hit.sum(1).max(initial=0))
    return np.take_along_axis(link, np.argsort(~hit, axis=1, kind="stable")[:, :most], 1)
