"""What comes into the simulator from outside: arrays of the right shape, of finite numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


def checked(name: str, values: Any, *shapes: tuple[int, ...]) -> FloatArray:
    """`values` as float64, of one of these shapes, [A] or with a leading axis of cells [E, ...].

    Raises `ValueError` for any other shape, and for a number that is not finite, with its cell and entry. Compiled
    loops check no indices, and a NaN would go on through networks and averages into other cells.
    """
    array = np.asarray(values, np.float64)
    if array.shape not in shapes:
        allowed = " or ".join(str(shape) for shape in shapes)
        raise ValueError(f"{name}: an array of shape {array.shape} is not allowed: it must be {allowed}")
    if not np.isfinite(array).all():
        *cell, entry = (int(i) for i in np.argwhere(~np.isfinite(np.atleast_2d(array)))[0])
        value = np.atleast_2d(array)[*cell, entry]
        where = f"entry {entry} of cell {cell[0]}"
        raise ValueError(f"{name}: {value} in {where} is not allowed: every entry must be a finite number")
    return array
