"""Zero-forced beams of one cell, compiled, and what users receive over beams."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.access import REGULAR, SINGULAR

ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


@compiled
def cluster_beams(channel: ComplexArray, clusters: IntArray) -> ComplexArray:
    """The beam of every cluster of `clusters` [V, K/V], zero-forced on its strongest user, eq. (ZFNOMA): [V, M]."""
    heads = clusters[:, 0].copy()
    for v in range(len(heads)):
        for user in clusters[v]:
            if strength(channel, user) > strength(channel, heads[v]):
                heads[v] = user
    return _zero_forcing(channel, heads)


@compiled
def band_beams(channel: ComplexArray, clusters: IntArray) -> ComplexArray:
    """The beam of every user [K, M], zero-forced among those of its band, a column of `clusters` [V, K/V]."""
    beams = np.empty_like(channel)
    for band in range(clusters.shape[1]):
        own = _zero_forcing(channel, clusters[:, band])
        for place in range(len(own)):
            for m in range(own.shape[1]):
                beams[clusters[place, band], m] = own[place, m]
    return beams


@compiled
def _zero_forcing(channel: ComplexArray, users: IntArray) -> ComplexArray:
    """`access.zero_forcing` of some users: their beams as rows [S, M], eq. (ZF)."""
    beams = np.empty((len(users), channel.shape[1]), np.complex128)
    if not _eliminated(channel, users, 0.0, beams):
        _eliminated(channel, users, REGULAR, beams)
    for i in range(len(users)):
        inverse = 1 / math.sqrt(strength(beams, i))
        for m in range(beams.shape[1]):
            beams[i, m] *= inverse
    return beams


@compiled
def _eliminated(channel: ComplexArray, users: IntArray, added: float, beams: ComplexArray) -> bool:
    """Write (H Hᴴ + ε I)⁻¹ H to `beams` [S, M] for unit rows H; False where rows are dependent and ε = 0.

    Gauss and Jordan's elimination; a matrix of inner products needs no pivots.
    """
    size, antennas = beams.shape
    gram = np.empty((size, size), np.complex128)
    for i in range(size):
        inverse = 1 / math.sqrt(strength(channel, users[i]))
        for m in range(antennas):
            beams[i, m] = inverse * channel[users[i], m].conjugate()
    for i in range(size):
        for j in range(size):
            gram[i, j] = added if i == j else 0.0
            for m in range(antennas):
                gram[i, j] += beams[i, m] * beams[j, m].conjugate()
    for i in range(size):
        if added == 0 and not gram[i, i].real >= SINGULAR:
            return False
        for j in range(size):
            if j != i:
                factor = 1 / gram[i, i].real * gram[j, i]
                for column in range(i, size):
                    gram[j, column] -= factor * gram[i, column]
                for m in range(antennas):
                    beams[j, m] -= factor * beams[i, m]
    return True


@compiled
def strength(rows: ComplexArray, row: int) -> float:
    """Squared norm of a row of [S, M]."""
    total = 0.0
    for m in range(rows.shape[1]):
        total += rows[row, m].real ** 2 + rows[row, m].imag ** 2
    return total


@compiled
def received(channel: ComplexArray, user: int, beams: ComplexArray, beam: int) -> float:
    """|h g|² of a user's channel in [K, M] and a beam in [S, M]."""
    amplitude = 0j
    for m in range(channel.shape[1]):
        amplitude += channel[user, m] * beams[beam, m]
    return amplitude.real**2 + amplitude.imag**2
