"""Beams, from what is known of the channels, and what users receive over beams.

Rows of a channel are received as h g, without conjugation.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled

ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

SINGULAR, REGULAR = 1e-13, 1e-7
"""Channels whose matrix of inner products has a pivot below the first are taken for dependent, and have the second
added to its diagonal."""


@compiled
def cluster_beams(known: ComplexArray, clusters: IntArray) -> ComplexArray:
    """The beam of every user [K, M]: that of its cluster of `clusters` [V, K/V], eqs. (xuNOMA), (ZFNOMA).

    Zero-forced on the strongest user of each cluster by the channels [K, M] that are known.
    """
    heads = clusters[:, 0].copy()
    for v in range(len(heads)):
        for user in clusters[v]:
            if strength(known, user) > strength(known, heads[v]):
                heads[v] = user
    of_heads = zero_forcing(known, heads)
    beams = np.empty_like(known)
    for v in range(len(heads)):
        for user in clusters[v]:
            beams[user] = of_heads[v]
    return beams


@compiled
def band_beams(known: ComplexArray, clusters: IntArray) -> ComplexArray:
    """The beam of every user [K, M], zero-forced among those of its band, a column of `clusters` [V, K/V]."""
    beams = np.empty_like(known)
    for band in range(clusters.shape[1]):
        own = zero_forcing(known, clusters[:, band])
        for place in range(len(own)):
            beams[clusters[place, band]] = own[place]
    return beams


@compiled
def zero_forcing(channel: ComplexArray, users: IntArray) -> ComplexArray:
    """Unit-norm beams [S, M] of some users, each of which nulls the channels of the others, eq. (ZF).

    The paper's G = H (HᴴH)⁻¹ normalises the received gain to one instead, which would make the transmit power depend
    on the channel; with unit norm the powers are what is transmitted. No beam can tell linearly dependent rows
    apart: theirs are the regularised ones, (H Hᴴ + ε I)⁻¹ H for rows of norm one, for equal rows the matched filter.
    """
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

    The scale of a row does not change the beams; unit rows keep users with very different losses well conditioned.
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
