"""NOMA within clusters, compiled: who decodes whose signals, with which powers and rates."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


@compiled
def needed_share(bandwidth_hz: float, least_bps: float) -> float:
    """What part t/(1+t) = 1 - 2^(-R/B) of its SINR t a rate takes."""
    # A hair above it, so that rounding never leaves a rate below its QoS.
    return -math.expm1(-math.log(2) / bandwidth_hz * least_bps) * (1 + 1e-12)


@compiled
def qos_first(gains: FloatArray, order: IntArray, budget: float, needed: FloatArray, powers: FloatArray) -> None:
    """Write `control.qos_first_split` of every cluster to `powers` [K], for users decoded in `order` [V, K/V].

    `gains` [K] are those that count in this order, see `decodable`, and `needed` [K] the users' `needed_share`.
    """
    for v in range(len(order)):
        left = budget
        for place in range(order.shape[1] - 1):
            user = order[v, place]
            wanted = needed[user] * (left + 1 / gains[user])
            powers[user] = wanted if wanted <= left else 0.0
            left -= powers[user]
        powers[order[v, -1]] = left


@compiled
def decodable(gains: FloatArray, order: IntArray) -> FloatArray:
    """The least gain [K] of every user and those later in `order` [V, K/V], who all decode its signal."""
    least = np.empty(len(gains))
    for v in range(len(order)):
        weakest = np.inf
        for place in range(order.shape[1] - 1, -1, -1):
            user = order[v, place]
            weakest = least[user] = min(weakest, gains[user])
    return least


@compiled
def cancelled(bandwidth_hz: float, gains: FloatArray, powers: FloatArray, order: IntArray, found: FloatArray) -> None:
    """Write rates to `found` [K] where only users later in `order` [V, K/V] interfere, eq. (inuk).

    Each is also decodable by those of them who have power: who is sent nothing decodes for nobody.
    """
    for v in range(len(order)):
        later, weakest = 0.0, np.inf
        for place in range(order.shape[1] - 1, -1, -1):
            user = order[v, place]
            gain = min(weakest, gains[user])
            sinr = gain * powers[user] / (gain * later + 1)
            found[user] = bandwidth_hz / math.log(2) * math.log1p(sinr)
            if powers[user] > 0:
                weakest = gain
                later += powers[user]


@compiled
def ascending(clusters: IntArray, gains: FloatArray) -> IntArray:
    """Users of every cluster [V, K/V] by ascending gain [V, K/V]."""
    order = np.empty_like(clusters)
    for v in range(len(order)):
        for place in range(order.shape[1]):
            user, free = clusters[v, place], place
            while free > 0 and gains[order[v, free - 1]] > gains[user]:
                order[v, free] = order[v, free - 1]
                free -= 1
            order[v, free] = user
    return order
