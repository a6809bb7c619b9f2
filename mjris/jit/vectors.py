"""Elementary functions for compiled loops over many numbers, which are done in vectors with these.

A loop that calls the C library's functions is done number by number; with polynomials it takes a half to a quarter of
the time. Errors are those of rounding.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from mjris.jit.compiled import inlined

_LN2_HIGH = 0.6931471803691238
"""ln 2 to 33 bits, so that its products with whole numbers are exact."""
_LN2_LOW = 1.9082149292705877e-10
"""The rest of it."""
_HALF_ROOT = 0x3FE6A09E667F3BCD
"""The bits of √½."""
_MANTISSA_BITS, _BIAS = 52, 1023

_EXP = tuple(1 / math.factorial(k) for k in range(13, -1, -1))
"""Terms of the series of e^x, the highest first."""
_LOG = tuple(2 / (2 * k + 1) for k in range(11, -1, -1))
"""Terms of that of log((1 + x) / (1 - x)) / x in x²."""
_PHASOR = tuple(
    (sign * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1), sign * math.pi ** (2 * k) / math.factorial(2 * k))
    for k, sign in ((k, (-1) ** k) for k in range(10, -1, -1))
)
"""Terms of those of sin(πx) / x and cos(πx) in x²."""


def _reinterpret(source: types.Float | types.Integer, target: types.Float | types.Integer, kind: ir.Type) -> Callable:
    """A compiled function that takes the bits of one type for another."""

    def typed(_context: Any, _value: Any) -> Any:
        return target(source), lambda _context, builder, _types, values: builder.bitcast(values[0], kind)

    return intrinsic(typed)


_bits = _reinterpret(types.float64, types.int64, ir.IntType(64))
_number = _reinterpret(types.int64, types.float64, ir.DoubleType())


@inlined
def exp(x: float) -> float:
    """e^x for |x| < 700."""
    power = np.rint(x * (1 / math.log(2)))
    rest = x - power * _LN2_HIGH - power * _LN2_LOW
    total = 0.0
    for term in _EXP:
        total = total * rest + term
    return total * _number((np.int64(power) + _BIAS) << _MANTISSA_BITS)


@inlined
def log(x: float) -> float:
    """log x for x from 10^-307 on."""
    bits = _bits(x)
    power = (bits - _HALF_ROOT) >> _MANTISSA_BITS
    mantissa = _number(bits - (power << _MANTISSA_BITS))  # from √½ to √2
    ratio = (mantissa - 1) / (mantissa + 1)
    square, total = ratio * ratio, 0.0
    for term in _LOG:
        total = total * square + term
    return power * _LN2_HIGH + (power * _LN2_LOW + ratio * total)


@inlined
def log1p(x: float) -> float:
    """log(1 + x) for x >= 0."""
    one_more = 1 + x
    return log(one_more) + (x - (one_more - 1)) / one_more


@inlined
def tanh(x: float) -> float:
    """tanh x."""
    squared = exp(2 * min(max(x, -20.0), 20.0))  # beyond ±20 it is ±1
    return (squared - 1) / (squared + 1)


@inlined
def phasor(turns: float) -> complex:
    """e^(-2πi t) for t turns, |t| < 10^15."""
    half = turns - np.rint(turns)  # an angle of π times this, within ±π/2, is half the angle sought
    square, sine, cosine = half * half, 0.0, 0.0
    for of_sine, of_cosine in _PHASOR:
        sine, cosine = sine * square + of_sine, cosine * square + of_cosine
    sine *= half
    return complex(1 - 2 * sine * sine, -2 * sine * cosine)
