"""Which obstacles block each link: rays from transmitter to receiver, one obstacle further each round."""

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.world.office import GROUP_BLOCKERS, GROUP_BODIES, Office

FloatArray = NDArray[np.float64]
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
        self._groups[GROUP_BODIES] = body_blockage
        self._hull_body = int(office.model.body("rover/chassis").id)

    def blockers(self, start: FloatArray, end: FloatArray, own_body: IntArray, ids: IntArray | None = None) -> IntArray:
        """Obstacles between `start` and `end`, both [E, L, 3] [m]: [E, L].

        `own_body` [L] is a body that never counts for that link, -1 for none; `ids` are the cells, all by default.
        """
        delta = end - start
        length = np.linalg.norm(delta, axis=-1)
        direction = delta / np.maximum(length, _NUDGE_M)[..., None]
        own = np.broadcast_to(own_body, length.shape)

        travelled = np.zeros_like(length)
        exclude = own
        seen: list[IntArray] = []
        count = np.zeros(length.shape, np.int64)
        links = np.broadcast_to(np.arange(length.shape[1]), length.shape)
        while links.shape[1]:
            origin = np.take_along_axis(start, links[..., None], 1)
            ray = np.take_along_axis(direction, links[..., None], 1)
            passed, whole = np.take_along_axis(travelled, links, 1), np.take_along_axis(length, links, 1)
            distance, geom = self._batch.ray(
                origin + passed[..., None] * ray,
                ray,
                geomgroup=self._groups,
                bodyexclude=np.take_along_axis(exclude, links, 1),
                ids=ids,
            )
            reach = passed + distance
            hit = (geom >= 0) & (reach < whole)
            body = np.where(hit, self._body_of_geom[geom], -1)
            new = hit & (body != np.take_along_axis(own, links, 1)) & (body != self._hull_body)
            for earlier in seen:
                new &= body != np.take_along_axis(earlier, links, 1)
            seen.append(_scattered(np.where(new, body, -1), links, length.shape, fill=-1))
            np.put_along_axis(count, links, np.take_along_axis(count, links, 1) + new, 1)
            exclude = np.array(exclude)
            np.put_along_axis(exclude, links, body, 1)
            np.put_along_axis(travelled, links, np.where(hit, reach + _NUDGE_M, whole), 1)
            links = _still_open(links, hit)
        return count


def _scattered(values: IntArray, links: IntArray, shape: tuple[int, ...], fill: int) -> IntArray:
    full = np.full(shape, fill, np.int64)
    np.put_along_axis(full, links, values, 1)
    return full


def _still_open(links: IntArray, hit: NDArray[np.bool_]) -> IntArray:
    """The links that met something, first in each row, the rows padded with finished ones to equal length.

    A finished link that is cast again meets nothing before its end, so padding changes no count.
    """
    order = np.argsort(~hit, axis=1, kind="stable")[:, : int(hit.sum(1).max(initial=0))]
    return np.take_along_axis(links, order, 1)
