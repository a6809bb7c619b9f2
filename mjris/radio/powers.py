"""Powers in closed form, from what is known of a slot's channels."""

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.beams import band_beams, cluster_beams
from mjris.radio.budgets import best_budgets, equal_budgets
from mjris.radio.decoding import ascending, cancelled, decodable, qos_first
from mjris.radio.equations import needed_share
from mjris.radio.merit import amplitudes, powers_of, sinr_of
from mjris.radio.serving import System, filling, flat, gains_over, oma_rates, orders

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


def qos_or_sum(
    system: System,
    known: ComplexArray,
    wanted_bps: FloatArray | None = None,
    order: IntArray | None = None,
    *,
    searched: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Powers [..., K] [W] for known channels [..., K, M], and the rates [..., K] [bit/s] that they promise.

    The most in eq. (R) with a budget of P/V for each cluster, or with the best budgets that a search finds
    (`best_budgets`): QoS-first powers where they give every user its QoS, for
    `wanted_bps` [..., K] >= QoS if that can be had, or else for the QoS itself. If not, it is missed anyhow, and only
    the sum counts: then the strongest user of a cluster has all of its power. With OMA every user has P/K; a scheduler
    that selects gives a cluster's all to its strongest user where somebody has no QoS and that gives more. `order` as
    in `rates`; in one that is not that of the gains a user has the gain of the weakest that decodes its signal.
    """
    shape, channels = known.shape[:-1], flat(known, 2)
    wanted = np.full(shape, system.qos_bps) if wanted_bps is None else filling(wanted_bps, shape)
    decoded = orders(system, len(channels), order)
    powers, reached = _serve_all(system, channels, flat(wanted, 1), decoded, searched)
    return powers.reshape(shape), reached.reshape(shape)


def best_powers(system: System, known: ComplexArray, order: IntArray | None = None) -> FloatArray:
    """The powers [..., K] [W] with the highest sum rate known, with QoS where that can be had: `qos_or_sum`."""
    return qos_or_sum(system, known, None, order, searched=True)[0]


def qos_first_powers(
    system: System, known: ComplexArray, budgets_w: FloatArray, order: IntArray | None = None
) -> FloatArray:
    """Powers [..., K] [W] of clusters that spend `budgets_w` [..., V] [W], for known channels [..., K, M] and NOMA.

    QoS first, then the last decoded has the rest; without QoS all goes to the strongest user in any order.
    """
    channels = flat(known, 2)
    budgets = flat(filling(budgets_w, (*known.shape[:-2], len(system.clusters))), 1)
    return _all_qos_first(system, channels, budgets, orders(system, len(channels), order)).reshape(known.shape[:-1])


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


@compiled
def _serve_all(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray, searched: bool
) -> tuple[FloatArray, FloatArray]:
    powers, reached = np.empty(wanted.shape), np.empty(wanted.shape)
    for cell in range(len(known)):
        powers[cell], reached[cell], _ = serve(system, known[cell], wanted[cell], order[cell], searched)
    return powers, reached


@compiled
def serve(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray, searched: bool = False
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Powers and rates [K] of `qos_or_sum` in one cell, and the beam of every user [K, M].

    In a decoding order [V, K/V], or that of the gains if it begins with a negative number.
    """
    if not system.oma:
        return _serve_noma(system, known, wanted, order, system.qos_bps, searched)
    beams = band_beams(known, system.clusters)
    powers = np.full(len(known), system.tx_power_w / len(known))
    reached = oma_rates(system, known, beams, powers)
    if system.selects and reached.min() < system.qos_bps:
        alone = _serve_noma(system, known, wanted, order, 0.0, searched)
        if alone[1].sum() > reached.sum():
            return alone
    return powers, reached, beams


@compiled
def _serve_noma(
    system: System, known: ComplexArray, wanted: FloatArray, order: IntArray, qos_bps: float, searched: bool
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """`serve` with superposed users, who are to have `qos_bps`."""
    beams = cluster_beams(known, system.clusters)
    budgets = equal_budgets(system)
    if searched:
        _search(system, known, beams, qos_bps, order, budgets)
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
        if searched:
            _search(system, known, beams, 0.0, np.full(order.shape, -1), budgets)
            gains = gains_over(system, known, beams, budgets)
            by_gain = ascending(system.clusters, gains)
        needed[:] = 0
        qos_first(gains, by_gain, budgets, needed, powers)
        cancelled(system.bandwidth_hz, gains, powers, by_gain, reached)
    return powers, reached, beams


@compiled
def _search(
    system: System, known: ComplexArray, beams: ComplexArray, qos_bps: float, order: IntArray, budgets: FloatArray
) -> None:
    """Write the best `budgets` [V] [W] for users who are to have `qos_bps` over their beams [K, M]."""
    received, equal = powers_of(amplitudes(system, known, beams)), np.ones(len(known))
    best_budgets(system, sinr_of(system.bandwidth_hz, qos_bps), received, equal, order, budgets)


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
