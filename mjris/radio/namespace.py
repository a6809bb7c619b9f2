"""The array library of some arrays, looked up once for each kind of array: radio functions are called very often."""

from typing import Any

import array_api_compat

_KNOWN: dict[type, Any] = {}


def array_namespace(*arrays: Any) -> Any:
    """`array_api_compat.array_namespace`: the one library that all `arrays` belong to. Raises `TypeError` for two."""
    kind = type(arrays[0])
    if kind not in _KNOWN:
        _KNOWN[kind] = array_api_compat.array_namespace(arrays[0])
    if all(type(array) is kind for array in arrays):
        return _KNOWN[kind]
    return array_api_compat.array_namespace(*arrays)
