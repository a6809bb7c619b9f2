"""What users get in a slot, and the closed forms for powers, compiled cell by cell.

`access` says the same for arrays of any library. There a slot of one cell takes hundreds of operations on a few numbers
each, which cost many times the arithmetic.
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


def rates(system: System, channel: ComplexArray, powers_w: FloatArray, order: IntArray | None = None) -> FloatArray:
    """Rates [..., K] [bit/s] for effective channels [..., K, M] and powers [..., K] [W].

    `access.noma_rates`, in the given decoding order [..., V, K/V] or that of the slot's gains, or `access.oma_rates`;
    an order may be `System.no_order` in some of the cells. Raises `ValueError` for a negative power.
    """
    if not (powers_w >= 0).all():
        raise ValueError(f"power_w: {powers_w} is not allowed: every power must be at least 0 W")
    flat = _flat(channel, 2)
    order = _orders(system, len(flat), order)
    return _rates(system, flat, _flat(_filling(powers_w, channel.shape[:-1]), 1), order).reshape(channel.shape[:-1])


def qos_or_sum(
    system: System, channel: ComplexArray, wanted_bps: FloatArray | None = None, order: IntArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Powers [..., K] [W] for effective channels [..., K, M], and their rates [..., K] [bit/s]: the most in eq. (R).

    Those of `control.qos_first_powers` where they give every user its QoS: for `wanted_bps` [..., K] >= QoS if that can
    be had, or else for the QoS itself. If not, it is missed anyhow, and only the sum counts: then the strongest user of
    a cluster has all of its power. With OMA every user has P/K; a scheduler that selects gives a cluster's all to its
    strongest user where somebody has no QoS and that gives more. `order` as in `rates`.
    """
    shape, flat = channel.shape[:-1], _flat(channel, 2)
    wanted = np.full(shape, system.qos_bps) if wanted_bps is None else _filling(wanted_bps, shape)
    powers, reached = _serve_all(system, flat, _flat(wanted, 1), _orders(system, len(flat), order))
    return powers.reshape(shape), reached.reshape(shape)


def _orders(system: System, cells: int, order: IntArray | None) -> IntArray:
    """Decoding orders [E, V, K/V], for every cell one."""
    if order is None:
        return system.no_order(cells)
    if order.shape != (cells, *system.clusters.shape):
        raise ValueError(f"order: an array of shape {order.shape} is not allowed: there are {cells} cells")
    return order


@compiled
def split_powers(system: System, shares: FloatArray) -> FloatArray:
    """`control.split_powers` of shares [E, K]: powers [E, K] [W]."""
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
def _rates(system: System, channel: ComplexArray, powers: FloatArray, order: IntArray) -> FloatArray:
    found = np.empty(powers.shape)
    for cell in range(len(channel)):
        if system.oma and not (system.selects and _selected(system, powers[cell])):
            found[cell] = _oma(system, channel[cell], band_beams(channel[cell], system.clusters), powers[cell])
        else:
            budgets = np.zeros(len(system.clusters))
            for v in range(len(budgets)):
                for user in system.clusters[v]:
                    budgets[v] += powers[cell, user]
            gains = _effective_gains(system, channel[cell], cluster_beams(channel[cell], system.clusters), budgets)
            decoded = order[cell] if order[cell, 0, 0] >= 0 else ascending(system.clusters, gains)
            cancelled(system.bandwidth_hz, gains, powers[cell], decoded, found[cell])
    return found


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
    system: System, channel: ComplexArray, wanted: FloatArray, order: IntArray
) -> tuple[FloatArray, FloatArray]:
    powers, reached = np.empty(wanted.shape), np.empty(wanted.shape)
    for cell in range(len(channel)):
        powers[cell], reached[cell], _ = serve(system, channel[cell], wanted[cell], order[cell])
    return powers, reached


@compiled
def serve(
    system: System, channel: ComplexArray, wanted: FloatArray, order: IntArray
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Powers and rates [K] of `qos_or_sum` in one cell, and the beam of every user [K, M].

    In a decoding order [V, K/V], or that of the gains if it begins with a negative number.
    """
    if not system.oma:
        return _serve_noma(system, channel, wanted, order, system.qos_bps)
    beams = band_beams(channel, system.clusters)
    powers = np.full(len(channel), system.tx_power_w / len(channel))
    reached = _oma(system, channel, beams, powers)
    if system.selects and reached.min() < system.qos_bps:
        alone = _serve_noma(system, channel, wanted, order, 0.0)
        if alone[1].sum() > reached.sum():
            return alone
    return powers, reached, beams


@compiled
def _serve_noma(
    system: System, channel: ComplexArray, wanted: FloatArray, order: IntArray, qos_bps: float
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """`serve` with superposed users, who are to have `qos_bps`."""
    users = len(channel)
    heads = cluster_beams(channel, system.clusters)
    budget = system.tx_power_w / len(system.clusters)
    gains = _effective_gains(system, channel, heads, np.full(len(heads), budget))
    by_gain = ascending(system.clusters, gains)
    decoded = order if order[0, 0] >= 0 else by_gain
    shares, powers, reached = np.empty(users), np.empty(users), np.empty(users)
    if qos_bps > 0:
        least = decodable(gains, decoded)
        for user in range(users):
            shares[user] = needed_share(system.bandwidth_hz, wanted[user])
        qos_first(least, decoded, budget, shares, powers)
        cancelled(system.bandwidth_hz, gains, powers, decoded, reached)
        if reached.min() < qos_bps:
            shares[:] = needed_share(system.bandwidth_hz, qos_bps)
            qos_first(least, decoded, budget, shares, powers)
            cancelled(system.bandwidth_hz, gains, powers, decoded, reached)
    if qos_bps == 0 or reached.min() < qos_bps:
        # All to the strongest ones; who is sent nothing decodes for nobody, so that no order matters.
        shares[:] = 0
        qos_first(gains, by_gain, budget, shares, powers)
        cancelled(system.bandwidth_hz, gains, powers, by_gain, reached)
    beams = np.empty_like(channel)
    for v in range(len(heads)):
        for user in system.clusters[v]:
            for m in range(heads.shape[1]):
                beams[user, m] = heads[v, m]
    return powers, reached, beams


@compiled
def _effective_gains(system: System, channel: ComplexArray, beams: ComplexArray, budgets: FloatArray) -> FloatArray:
    """`access.effective_gains` [K] for beams [V, M] of clusters that transmit `budgets` [V] [W]."""
    gains = np.empty(len(channel))
    for v in range(len(beams)):
        for user in system.clusters[v]:
            interference = system.noise_w
            for other in range(len(beams)):
                if other != v:
                    interference += received(channel, user, beams, other) * budgets[other]
            gains[user] = received(channel, user, beams, v) / interference
    return gains


@compiled
def _oma(system: System, channel: ComplexArray, beams: ComplexArray, powers: FloatArray) -> FloatArray:
    """`access.oma_rates` [K] for the beams of the users [K, M]."""
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
