"""Products of matrices in compiled loops, by the BLAS that PyTorch brings with it where it brings one (MKL)."""

import ctypes
from pathlib import Path

import numpy as np
import torch
from llvmlite import binding
from numba import types
from numpy.typing import NDArray

from mjris.jit.compiled import compiled

Matrix = NDArray[np.float32]

_NAME = "mjris_sgemm"
_POINTERS = 13
"""Fortran hands everything over by its address."""
_MODES = np.array([ord("N"), ord("T")], np.uint8)
"""As it is, transposed."""
_FACTORS = np.array([1, 0], np.float32)
"""Of the product, and of what `out` held before."""


def _found() -> bool:
    """Whether PyTorch has a BLAS for others to call; then it goes by our own name in compiled loops from now on."""
    for library in (Path(torch.__file__).parent / "lib").glob("libtorch_cpu.so"):
        if function := getattr(ctypes.CDLL(str(library)), "sgemm_", None):
            binding.add_symbol(_NAME, ctypes.cast(function, ctypes.c_void_p).value)
            return True
    return False


AVAILABLE = _found()
_sgemm = types.ExternalFunction(_NAME, types.void(*[types.intp] * _POINTERS))


@compiled
def product(left: Matrix, right: Matrix, out: Matrix, left_turned: bool = False, right_turned: bool = False) -> None:
    """Write the product of two matrices, or of the transposes of those that are turned, to `out`.

    The rows of each may be apart in memory, the numbers of a row may not. Needs `AVAILABLE`.
    """
    sizes = np.empty(6, np.int32)
    sizes[0], sizes[1], sizes[2] = out.shape[1], out.shape[0], left.shape[0] if left_turned else left.shape[1]
    sizes[3], sizes[4], sizes[5] = right.strides[0] // 4, left.strides[0] // 4, out.strides[0] // 4
    mode, size, factor = _MODES.ctypes.data, sizes.ctypes.data, _FACTORS.ctypes.data
    # Fortran takes rows for columns, and thus sees the transposes: outᵀ = rightᵀ leftᵀ.
    _sgemm(
        mode + right_turned,
        mode + left_turned,
        size,
        size + 4,
        size + 8,
        factor,
        right.ctypes.data,
        size + 12,
        left.ctypes.data,
        size + 16,
        factor + 4,
        out.ctypes.data,
        size + 20,
    )
    sizes[0] = 0  # an array is kept until it is used for the last time, and addresses do not count
