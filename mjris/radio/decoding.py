"""NOMA within clusters: who decodes whose signals, with which powers and rates."""

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.equations import cancelled_sinr, qos_power_w, rate_bps

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


@compiled
def qos_first(gains: FloatArray, order: IntArray, budgets: FloatArray, needed: FloatArray, powers: FloatArray) -> None:
    """Write powers [K] [W] to `powers`: in decoding order what a user's rate takes, and the rest to the last one.

    Of the `budgets` [V] [W] of clusters, with users decoded in `order` [V, K/V]. `gains` [K] [1/W] are those that count
    in this order, see `decodable`, and `needed` [K] the users' `needed_share`. This has the highest sum rate with these
    rates; who cannot have his gets nothing.
    """
    for v in range(len(order)):
        left = budgets[v]
        for place in range(order.shape[1] - 1):
            user = int(order[v, place])
            powers[user] = qos_power_w(gains[user], left, needed[user])
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
    """Write rates [bit/s] to `found` [K] where only users later in `order` [V, K/V] interfere, eq. (inuk).

    Each is also decodable by those of them who have power: who is sent nothing decodes for nobody.
    """
    for v in range(len(order)):
        later, weakest = 0.0, np.inf
        for place in range(order.shape[1] - 1, -1, -1):
            user = int(order[v, place])
            gain = min(weakest, gains[user])
            found[user] = rate_bps(bandwidth_hz, cancelled_sinr(gain, powers[user], later))
            if powers[user] > 0:
                weakest = gain
                later += powers[user]


@compiled
def ascending(clusters: IntArray, gains: FloatArray) -> IntArray:
    """Users of every cluster [V, K/V] by ascending gain [V, K/V]: for any powers, no order has a higher sum rate."""
    order = np.empty_like(clusters)
    for v in range(len(order)):
        for place in range(order.shape[1]):
            user, free = clusters[v, place], place
            while free > 0 and gains[order[v, free - 1]] > gains[user]:
                order[v, free] = order[v, free - 1]
                free -= 1
            order[v, free] = user
    return order
