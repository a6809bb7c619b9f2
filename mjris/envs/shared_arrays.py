"""Arrays that one process writes and another reads: in memory of both, as a pipe would pack and copy them."""

from collections.abc import Sequence
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALIGNED = 64
"""Every array begins at a multiple of so many bytes."""

Spec = tuple[tuple[int, ...], str]
"""Shape and type of an array."""


class Board:
    """Arrays of these shapes and types in new memory, or in that with a name.

    A board that is sent to another process is the same memory there. Once is enough, because the name is gone then:
    the system takes the memory back when both processes have closed it or are dead.
    """

    def __init__(self, specs: Sequence[Spec], name: str | None = None):
        self._specs = list(specs)
        sizes = [-(-np.dtype(kind).itemsize * int(np.prod(shape)) // _ALIGNED) * _ALIGNED for shape, kind in specs]
        self._memory = SharedMemory(name, create=name is None, size=sum(sizes))
        if name is not None:
            self._memory.unlink()
        starts = np.cumsum([0, *sizes]).tolist()
        self._arrays = [
            np.ndarray(shape, kind, self._memory.buf, start)
            for (shape, kind), start in zip(self._specs, starts, strict=False)
        ]

    @classmethod
    def like(cls, arrays: Sequence[NDArray[Any]]) -> "Board":
        """With room for arrays like these."""
        return cls([(array.shape, array.dtype.str) for array in arrays])

    def __reduce__(self) -> tuple[type["Board"], tuple[list[Spec], str]]:
        return Board, (self._specs, self._memory.name)

    def write(self, arrays: Sequence[NDArray[Any]]) -> None:
        """Write all arrays over those before. Raises `ValueError` for other numbers or shapes of them."""
        for own, array in zip(self._arrays, arrays, strict=True):
            if own.shape != array.shape:
                raise ValueError(f"board: an array of shape {array.shape} does not fit into {own.shape}")
            own[...] = array

    def read(self) -> list[NDArray[Any]]:
        """Copies of all arrays."""
        return [array.copy() for array in self._arrays]

    def close(self) -> None:
        """Give the memory back."""
        self._arrays.clear()  # it cannot be closed while arrays lie in it
        self._memory.close()
