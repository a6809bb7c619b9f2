"""Path loss and element gains of NumPy arrays: faces of `equations`."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled
from mjris.radio import equations
from mjris.radio.tables import LinkTable

FloatArray = NDArray[np.floating]


def path_loss_db(
    distance_m: ArrayLike, blockers: ArrayLike, carrier_hz: float, link_table: str = "paper"
) -> FloatArray:
    """Path loss of links with `blockers` obstacles in their way [dB], eqs. (PLLOS) and (PLNLOS) with the paper's table.

    `distance_m` [m] is clamped to 1 m, where the models begin. It and `blockers` may be plain numbers, and broadcast.
    Raises `ConfigError` for a table that is not known, and for a carrier where it does not hold.
    """
    return losses_db(LinkTable.of(Radio(link_table=link_table, carrier_hz=carrier_hz)), distance_m, blockers)


def losses_db(table: LinkTable, distance_m: ArrayLike, obstacles: ArrayLike) -> FloatArray:
    """`path_loss_db` by a table, with obstacles as it has them: counted, or in dB."""
    distance, behind = np.broadcast_arrays(np.asarray(distance_m, np.float64), np.asarray(obstacles, np.float64))
    return _losses(table, distance.ravel(), behind.ravel()).reshape(distance.shape)


def element_gain(radio: Radio, cosine: ArrayLike) -> FloatArray:
    """Power gain [...] of an element for the cosine [...] of the angle from boresight, linear.

    "isotropic" is 1 everywhere; "cosine" is 2(n+1) cos^n in front of the element and nothing behind it, which
    radiates all of the power (SimRIS: 2q = n = 0.57).
    """
    cosines = np.asarray(cosine, np.float64)
    return _element_gains(LinkTable.of(radio), cosines.ravel()).reshape(cosines.shape)


def db_to_linear(level_db: FloatArray) -> FloatArray:
    """Power ratios of levels [dB]."""
    return 10.0 ** (level_db / 10)


@compiled
def _losses(table: LinkTable, distance_m: FloatArray, obstacles: FloatArray) -> FloatArray:
    losses = np.empty(len(distance_m))
    for link in range(len(losses)):
        losses[link] = equations.path_loss_db(table, distance_m[link] ** 2, obstacles[link])
    return losses


@compiled
def _element_gains(table: LinkTable, cosine: FloatArray) -> FloatArray:
    gains = np.empty(len(cosine))
    for direction in range(len(gains)):
        gains[direction] = equations.db_to_linear(equations.element_gain_db(table, cosine[direction]))
    return gains
