"""The channels of a slot from where everything stands, compiled: `channel` and `propagation` in one pass."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.radio.channel import Channels

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]


def channels(
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    amplitude: FloatArray,
    k_factor: FloatArray,
    diffuse: ComplexArray,
    wavelength_m: float,
) -> Channels:
    """Channels of E cells with K users, M antennas and N elements.

    `antennas` [E, M, 3], `receivers` [E, K, 3] and `elements` [E, N, 3] are places [m], so that every entry has the
    phase of its own distance, `channel.phase_ramp`. `amplitude` and the linear Rician `k_factor` [E, 2K + 1] are those
    of the links AP–users, RIS–users, AP–RIS; `diffuse` [E, K M + N M + K N] is the diffuse part of h_d, G and h_r, for
    `propagation.rician`.
    """
    cells, users, rows = len(receivers), receivers.shape[1], elements.shape[1]
    columns = antennas.shape[1]
    made = Channels(
        np.empty((cells, users, columns), np.complex128),
        np.empty((cells, rows, columns), np.complex128),
        np.empty((cells, users, rows), np.complex128),
    )
    _fill(*made, antennas, receivers, elements, amplitude, k_factor, diffuse, 2 * math.pi / wavelength_m)
    return made


@compiled
def _fill(
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    antennas: FloatArray,
    receivers: FloatArray,
    elements: FloatArray,
    amplitude: FloatArray,
    k_factor: FloatArray,
    diffuse: ComplexArray,
    wavenumber: float,
) -> None:
    users, rows, columns = receivers.shape[1], elements.shape[1], antennas.shape[1]
    for e in range(len(receivers)):
        entry = 0
        for k in range(users):
            los, scattered = _shares(amplitude[e, k], k_factor[e, k])
            for m in range(columns):
                ramp = _ramp(receivers, e, k, antennas, m, wavenumber)
                direct[e, k, m] = los * ramp + scattered * diffuse[e, entry]
                entry += 1
        los, scattered = _shares(amplitude[e, 2 * users], k_factor[e, 2 * users])
        for n in range(rows):
            for m in range(columns):
                incident[e, n, m] = los * _ramp(elements, e, n, antennas, m, wavenumber) + scattered * diffuse[e, entry]
                entry += 1
        for k in range(users):
            los, scattered = _shares(amplitude[e, users + k], k_factor[e, users + k])
            for n in range(rows):
                ramp = _ramp(receivers, e, k, elements, n, wavenumber)
                reflected[e, k, n] = los * ramp + scattered * diffuse[e, entry]
                entry += 1


@compiled
def _shares(amplitude: float, k_factor: float) -> tuple[float, float]:
    """Amplitudes of the line of sight and of the diffuse part, h of eq. (PL)."""
    diffuse = amplitude / math.sqrt(k_factor + 1)
    return math.sqrt(k_factor) * diffuse, diffuse


@compiled
def _ramp(ends: FloatArray, cell: int, end: int, starts: FloatArray, start: int, wavenumber: float) -> complex:
    """Spherical-wave phase between two places of [E, A, 3] and [E, B, 3]."""
    x = ends[cell, end, 0] - starts[cell, start, 0]
    y = ends[cell, end, 1] - starts[cell, start, 1]
    z = ends[cell, end, 2] - starts[cell, start, 2]
    angle = wavenumber * math.sqrt(x * x + y * y + z * z)
    return complex(math.cos(angle), -math.sin(angle))
