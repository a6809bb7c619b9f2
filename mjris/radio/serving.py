"""What users get in a slot, and the closed forms for powers.

Beams, decoding orders and powers follow from the channels that are known; rates are those of the channels that are.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled
from mjris.radio.beams import band_beams, cluster_beams, received
from mjris.radio.decoding import ascending, cancelled, decodable, qos_first
from mjris.radio.equations import needed_share, rate_bps

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

    @classmethod
    def of(cls, radio: Radio, clusters: IntArray, qos_bps: float) -> "System":
        """With the numbers of a config."""
        oma = radio.scheme == "oma"
        return cls(clusters, oma, radio.tx_power_w, radio.bandwidth_hz, radio.noise_w, qos_bps, radio.oma_selection)

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
    flat, shape, perfect = _flat(channel, 2), channel.shape[:-1], known is None or known is channel
    beams_from = flat if known is None or perfect else _flat(known, 2)
    powers, orders = _flat(_filling(powers_w, shape), 1), _orders(system, len(flat), order)
    return _rates(system, flat, beams_from, perfect, powers, orders).reshape(shape)


def decoding_order(system: System, known: ComplexArray, powers_w: FloatArray) -> IntArray:
    """Users of every cluster from first decoded to last [E, V, K/V], by gain over known channels [E, K, M]."""
    return _all_orders(system, np.ascontiguousarray(known), powers_w)


def effective_gains(system: System, channel: ComplexArray, known: ComplexArray, powers_w: FloatArray) -> FloatArray:
    """e_k = |h_k g_v|² / (inter-cluster interference + noise) of every user [E, K] [1/W], eq. (SINROMA), with NOMA.

    Over channels [E, K, M] with beams that follow from `known` ones.
    """
    return _all_gains(system, np.ascontiguousarray(channel), np.ascontiguousarray(known), powers_w)


def qos_or_sum(
    system: System, known: ComplexArray, wanted_bps: FloatArray | None = None, order: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Powers [..., K] [W] for known channels [..., K, M], and the rates [..., K] [bit/s] that they promise.

    The most in eq. (R) with a budget of P/V for each cluster: QoS-first powers where they give every user its QoS, for
    `wanted_bps` [..., K] >= QoS if that can be had, or else for the QoS itself. If not, it is missed anyhow, and only
    the sum counts: then the strongest user of a cluster has all of its power. With OMA every user has P/K; a scheduler
    that selects gives a cluster's all to its strongest user where somebody has no QoS and that gives more. `order` as
    in `rates`; in one that is not that of the gains a user has the gain of the weakest that decodes its signal.
    """
    shape, flat = known.shape[:-1], _flat(known, 2)
    wanted = np.full(shape, system.qos_bps) if wanted_bps is None else _filling(wanted_bps, shape)
    powers, reached = _serve_all(system, flat, _flat(wanted, 1), _orders(system, len(flat), order))
    return powers.reshape(shape), reached.reshape(shape)


def qos_first_powers(
    system: System, known: ComplexArray, budgets_w: FloatArray, order: IntArray | None = None
) -> FloatArray:
    """Powers [..., K] [W] of clusters that spend `budgets_w` [..., V] [W], for known channels [..., K, M] and NOMA.

    QoS first, then the last decoded has the rest; without QoS all goes to the strongest user in any order.
    """
    flat = _flat(known, 2)
    budgets = _flat(_filling(budgets_w, (*known.shape[:-2], len(system.clusters))), 1)
    return _all_qos_first(system, flat, budgets, _orders(system, len(flat), order)).reshape(known.shape[:-1])


def _orders(system: System, cells: int, order: IntArray | None) -> IntArray:
    """Decoding orders [E, V, K/V], for every cell one."""
    if order is None:
        return system.no_order(cells)
    if order.shape != (cells, *system.clusters.shape):
        raise ValueError(f"order: an array of shape {order.shape} is not allowed: there are {cells} cells")
    return order


@compiled
def split_powers(system: System, shares: FloatArray) -> FloatArray:
    """Powers [E, K] [W] for shares [E, K] in [0, 1] of what users may have, eq. (OPPE), in all P_max at most.

    With NOMA a cluster has P/V, and shares that add up to more than one are scaled down to it; with OMA a user has P/K.
    """
    powers = np.empty(shares.shape)
    for cell in range(len(shares)):
        for v in range(len(system.clusters)):
            asked = 0.0
            for user in system.clusters[v]:
                asked += shares[cell, user]
            for user in system.clusters[v]:
                if system.oma:
                    powers[cell, user] = system.tx_power_w / shares.shape[1] * shares[cell, user]
                else:
                    powers[cell, user] = system.tx_power_w / len(system.clusters) * shares[cell, user] / max(asked, 1.0)
    return powers


def _filling(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """`values` broadcast to a shape, at no cost where they have it."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


def _flat(values: np.ndarray, axes: int) -> np.ndarray:
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
            found[cell] = _oma(system, channel[cell], band_beams(known[cell], system.clusters), powers[cell])
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
def _serve_all(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray
) -> tuple[FloatArray, FloatArray]:
    powers, reached = np.empty(wanted.shape), np.empty(wanted.shape)
    for cell in range(len(known)):
        powers[cell], reached[cell], _ = serve(system, known[cell], wanted[cell], order[cell])
    return powers, reached


@compiled
def serve(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Powers and rates [K] of `qos_or_sum` in one cell, and the beam of every user [K, M].

    In a decoding order [V, K/V], or that of the gains if it begins with a negative number.
    """
    if not system.oma:
        return _serve_noma(system, known, wanted, order, system.qos_bps)
    beams = band_beams(known, system.clusters)
    powers = np.full(len(known), system.tx_power_w / len(known))
    reached = _oma(system, known, beams, powers)
    if system.selects and reached.min() < system.qos_bps:
        alone = _serve_noma(system, known, wanted, order, 0.0)
        if alone[1].sum() > reached.sum():
            return alone
    return powers, reached, beams


@compiled
def _serve_noma(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray, qos_bps: float
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """`serve` with superposed users, who are to have `qos_bps`."""
    beams = cluster_beams(known, system.clusters)
    budgets = np.full(len(system.clusters), system.tx_power_w / len(system.clusters))
    gains = gains_over(system, known, beams, budgets)
    by_gain = ascending(system.clusters, gains)
    decoded = order if order[0, 0] >= 0 else by_gain
    needed, powers, reached = np.empty(len(known)), np.empty(len(known)), np.full(len(known), -np.inf)
    least = decodable(gains, decoded)
    for attempt in range(2 if qos_bps > 0 else 0):
        if reached.min() < qos_bps:
            for user in range(len(needed)):
                needed[user] = needed_share(system.bandwidth_hz, wanted[user] if attempt == 0 else qos_bps)
            qos_first(least, decoded, budgets, needed, powers)
            cancelled(system.bandwidth_hz, gains, powers, decoded, reached)
    if qos_bps == 0 or reached.min() < qos_bps:
        # All to the strongest ones; who is sent nothing decodes for nobody, so that no order matters.
        needed[:] = 0
        qos_first(gains, by_gain, budgets, needed, powers)
        cancelled(system.bandwidth_hz, gains, powers, by_gain, reached)
    return powers, reached, beams


@compiled
def _all_qos_first(system: System, known: ComplexArray, budgets: FloatArray, order: IntArray) -> FloatArray:
    powers = np.empty(known.shape[:2])
    for cell in range(len(known)):
        gains = gains_over(system, known[cell], cluster_beams(known[cell], system.clusters), budgets[cell])
        decoded = ascending(system.clusters, gains)
        if system.qos_bps > 0 and order[cell, 0, 0] >= 0:
            decoded = order[cell]
        needed = np.full(known.shape[1], needed_share(system.bandwidth_hz, system.qos_bps))
        qos_first(decodable(gains, decoded), decoded, budgets[cell], needed, powers[cell])
    return powers


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
def _oma(system: System, channel: ComplexArray, beams: ComplexArray, powers: FloatArray) -> FloatArray:
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
