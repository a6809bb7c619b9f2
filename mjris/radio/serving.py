"""What users get in a slot: beams and decoding orders from the channels that are known, rates over those that are."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled
from mjris.radio.beams import band_beams, cluster_beams, received
from mjris.radio.decoding import ascending, cancelled
from mjris.radio.equations import rate_bps

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class System(NamedTuple):
    """Who is served with what."""

    clusters: IntArray
    """Users of every cluster [V, K/V]; with OMA, column i is the users of band i."""
    oma: bool
    tx_power_w: float
    """P_max [W]"""
    bandwidth_hz: float
    noise_w: float
    """In the whole band [W]."""
    qos_bps: float
    """R_QoS [bit/s]"""
    selects: bool
    """Whether the scheduler of OMA may select users: a cluster's bands are all of the one who has power, if only one
    in every cluster has."""
    shares_power: bool = False
    """Whether clusters share P_max, rather than that each has P_max/V."""

    @classmethod
    def of(cls, radio: Radio, clusters: IntArray, qos_bps: float) -> "System":
        """With the numbers of a config."""
        return cls(
            clusters,
            radio.scheme == "oma",
            radio.tx_power_w,
            radio.bandwidth_hz,
            radio.noise_w,
            qos_bps,
            radio.oma_selection,
            radio.cluster_power == "shared",
        )

    def no_order(self, cells: int) -> IntArray:
        """What stands for a decoding order [E, V, K/V] where users are decoded in that of their gains."""
        return np.full((cells, *self.clusters.shape), -1)


def rates(
    system: System,
    channel: ComplexArray,
    powers_w: FloatArray,
    order: IntArray | None = None,
    known: ComplexArray | None = None,
) -> FloatArray:
    """Rates [..., K] [bit/s] over effective channels [..., K, M], for powers [..., K] [W].

    Beams, and the decoding order where none is given, follow from the channels that are `known`, by default the very
    same. `order` [B, V, K/V] is that of every cell, or negative: `System.no_order`. Raises `ValueError` for a negative
    power.
    """
    if not (powers_w >= 0).all():
        raise ValueError(f"power_w: {powers_w} is not allowed: every power must be at least 0 W")
    channels, shape, perfect = flat(channel, 2), channel.shape[:-1], known is None or known is channel
    beams_from = channels if known is None or perfect else flat(known, 2)
    powers, decoded = flat(filling(powers_w, shape), 1), orders(system, len(channels), order)
    return _rates(system, channels, beams_from, perfect, powers, decoded).reshape(shape)


def decoding_order(system: System, known: ComplexArray, powers_w: FloatArray) -> IntArray:
    """Users of every cluster from first decoded to last [E, V, K/V], by gain over known channels [E, K, M]."""
    return _all_orders(system, np.ascontiguousarray(known), powers_w)


def effective_gains(system: System, channel: ComplexArray, known: ComplexArray, powers_w: FloatArray) -> FloatArray:
    """e_k = |h_k g_v|² / (inter-cluster interference + noise) of every user [E, K] [1/W], eq. (SINROMA), with NOMA.

    Over channels [E, K, M] with beams that follow from `known` ones.
    """
    return _all_gains(system, np.ascontiguousarray(channel), np.ascontiguousarray(known), powers_w)


def orders(system: System, cells: int, order: IntArray | None) -> IntArray:
    """Decoding orders [E, V, K/V], for every cell one."""
    if order is None:
        return system.no_order(cells)
    if order.shape != (cells, *system.clusters.shape):
        raise ValueError(f"order: an array of shape {order.shape} is not allowed: there are {cells} cells")
    return order


def filling(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """`values` broadcast to a shape, at no cost where they have it."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


def flat(values: np.ndarray, axes: int) -> np.ndarray:
    """`values` with all leading axes but the last `axes` in one, contiguous."""
    return np.ascontiguousarray(values).reshape(-1, *values.shape[values.ndim - axes :])


@compiled
def _rates(
    system: System, channel: ComplexArray, known: ComplexArray, perfect: bool, powers: FloatArray, order: IntArray
) -> FloatArray:
    """`rates`; whether the knowledge is perfect spares working out the same gains twice."""
    found = np.empty(powers.shape)
    for cell in range(len(channel)):
        if system.oma and not (system.selects and _selected(system, powers[cell])):
            found[cell] = oma_rates(system, channel[cell], band_beams(known[cell], system.clusters), powers[cell])
        else:
            beams, budgets = cluster_beams(known[cell], system.clusters), _spent(system, powers[cell])
            gains, decoded = gains_over(system, known[cell], beams, budgets), order[cell]
            if decoded[0, 0] < 0:
                decoded = ascending(system.clusters, gains)
            if not perfect:
                gains = gains_over(system, channel[cell], beams, budgets)
            cancelled(system.bandwidth_hz, gains, powers[cell], decoded, found[cell])
    return found


@compiled
def _all_orders(system: System, known: ComplexArray, powers: FloatArray) -> IntArray:
    gains = _all_gains(system, known, known, powers)
    orders = np.empty((len(known), *system.clusters.shape), np.int64)
    for cell in range(len(known)):
        orders[cell] = ascending(system.clusters, gains[cell])
    return orders


@compiled
def _all_gains(system: System, channel: ComplexArray, known: ComplexArray, powers: FloatArray) -> FloatArray:
    gains = np.empty(powers.shape)
    for cell in range(len(channel)):
        beams = cluster_beams(known[cell], system.clusters)
        gains[cell] = gains_over(system, channel[cell], beams, _spent(system, powers[cell]))
    return gains


@compiled
def _spent(system: System, powers: FloatArray) -> FloatArray:
    """What clusters spend [V] [W]."""
    budgets = np.zeros(len(system.clusters))
    for v in range(len(budgets)):
        for user in system.clusters[v]:
            budgets[v] += powers[user]
    return budgets


@compiled
def _selected(system: System, powers: FloatArray) -> bool:
    """Whether one user of every cluster has power, and nobody else."""
    for users in system.clusters:
        served = 0
        for user in users:
            served += powers[user] > 0
        if served != 1:
            return False
    return True


@compiled
def gains_over(system: System, channel: ComplexArray, beams: ComplexArray, budgets: FloatArray) -> FloatArray:
    """`effective_gains` [K] over the users' beams [K, M], for clusters that spend `budgets` [V] [W]."""
    gains = np.empty(len(channel))
    for v in range(len(system.clusters)):
        for user in system.clusters[v]:
            interference = system.noise_w
            for other in range(len(system.clusters)):
                if other != v:
                    interference += received(channel, user, beams, system.clusters[other, 0]) * budgets[other]
            gains[user] = received(channel, user, beams, user) / interference
    return gains


@compiled
def oma_rates(system: System, channel: ComplexArray, beams: ComplexArray, powers: FloatArray) -> FloatArray:
    """Rates [K] [bit/s] with OMA over the users' beams [K, M]; bands share the noise."""
    found = np.empty(len(channel))
    bands = system.clusters.shape[1]
    for band in range(bands):
        users = system.clusters[:, band]
        for user in users:
            unwanted = system.noise_w / bands
            for other in users:
                if other != user:
                    unwanted += received(channel, user, beams, other) * powers[other]
            sinr = received(channel, user, beams, user) * powers[user] / unwanted  # eq. (SINROMA)
            found[user] = rate_bps(system.bandwidth_hz / bands, sinr)
    return found
