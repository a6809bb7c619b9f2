"""Where panels should face: between the AP and the users."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled, inlined

FloatArray = NDArray[np.floating]


@compiled
def bisector(aims: FloatArray, places: FloatArray) -> FloatArray:
    """Where panels at `places` [E, 2] [m] should face between `aims` [E, ., 2] [m], the AP last: [E] [rad]."""
    headings, x, y = np.empty(len(places)), places[:, 0].copy(), places[:, 1].copy()
    forward_x, forward_y = np.empty(len(x)), np.empty(len(x))
    for e in range(len(places)):
        own = slice(e, e + 1)
        bisectors(aims[e], x[own], y[own], forward_x[own], forward_y[own])
        headings[e] = math.atan2(forward_y[e], forward_x[e])
    return headings


@compiled
def bisectors(
    receivers: FloatArray, x: FloatArray, y: FloatArray, forward_x: FloatArray, forward_y: FloatArray
) -> None:
    """Write vectors in the directions that panels at P places should face: between the AP and the users' middle.

    `receivers` [K + 1, 2 or 3] [m] are the users and, last, the AP; all others are [P], places in m.
    """
    users = len(receivers) - 1
    forward_x[:], forward_y[:] = 0, 0
    for k in range(users):
        _add_units(receivers[k], x, y, forward_x, forward_y)
    for p in range(len(x)):
        forward_x[p], forward_y[p] = _unit(forward_x[p], forward_y[p])
    _add_units(receivers[users], x, y, forward_x, forward_y)


@compiled
def _add_units(end: FloatArray, x: FloatArray, y: FloatArray, forward_x: FloatArray, forward_y: FloatArray) -> None:
    """Add the unit vectors from places toward an end."""
    for p in range(len(x)):
        toward_x, toward_y = _unit(end[0] - x[p], end[1] - y[p])
        forward_x[p] += toward_x
        forward_y[p] += toward_y


@inlined
def _unit(x: float, y: float) -> tuple[float, float]:
    """The vector with length one; zero stays zero."""
    length = math.sqrt(x * x + y * y)
    return (x / length, y / length) if length > 0 else (0.0, 0.0)
