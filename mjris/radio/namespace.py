"""The array library of some arrays, looked up once for each kind of array: radio functions are called very often."""

from typing import Any, TypeAlias

import array_api_compat
import numpy as np

Array: TypeAlias = Any
"""An array of any library that follows the Python array API; real ones are float64, complex ones complex128."""

# NumPy follows the standard by itself.
_KNOWN: dict[type, Any] = {np.ndarray: np}


def array_namespace(*arrays: Any) -> Any:
    """`array_api_compat.array_namespace`: the one library that all `arrays` belong to. Raises `TypeError` for two."""
    kind = type(arrays[0])
    for array in arrays:
        if type(array) is not kind:
            return array_api_compat.array_namespace(*arrays)
    if kind not in _KNOWN:
        _KNOWN[kind] = array_api_compat.array_namespace(arrays[0])
    return _KNOWN[kind]
