"""Who gets the rate: what stands beside every sum rate, for slots [T] of scenes [S] with K users."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]


def user_qos_share(rates_bps: FloatArray, qos_bps: float) -> FloatArray:
    """Share of the users' slots with QoS [S], for rates [T, S, K] [bit/s]."""
    return (rates_bps >= qos_bps).mean((0, 2))


def low_rate_bps(rates_bps: FloatArray) -> FloatArray:
    """5th percentile of the rates of a scene, over its users and slots together, [S] [bit/s], for rates [T, S, K]."""
    return np.percentile(rates_bps, 5, axis=(0, 2))


def jain_index(rates_bps: FloatArray) -> FloatArray:
    """Jain's index (Σ r)² / (K Σ r²) over the users of a slot, and the mean of that over slots [S], for [T, S, K].

    From 1/K, where one user has everything, to 1, where all have the same: also where all have nothing.
    """
    squares = rates_bps.shape[-1] * (rates_bps**2).sum(-1)
    index = np.divide(rates_bps.sum(-1) ** 2, squares, out=np.ones_like(squares), where=squares > 0)
    return index.mean(0)


def superposing_share(powers_w: FloatArray, clusters: IntArray, scheme: str) -> FloatArray:
    """Share of the clusters' slots that superpose [S], for powers [T, S, K] [W] and clusters int [V, K/V].

    That is where at least two users of a cluster have power; never with OMA, which gives them a band each.
    """
    if scheme == "oma":
        return np.zeros(powers_w.shape[1])
    return ((powers_w[..., clusters] > 0).sum(-1) >= 2).mean((0, 2))
