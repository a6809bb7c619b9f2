"""What users get in a slot, and the closed forms for powers, compiled cell by cell.

`access` says the same for arrays of any library. There a slot of one cell takes hundreds of operations on a few numbers
each, which cost many times the arithmetic.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import Radio
from mjris.radio.decoding import ascending, cancelled, needed_share, qos_first

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

    @classmethod
    def of(cls, radio: Radio, clusters: IntArray, qos_bps: float) -> "System":
        """With the numbers of a config."""
        oma = radio.scheme == "oma"
        return cls(clusters, oma, radio.tx_power_w, radio.bandwidth_hz, radio.noise_w, qos_bps)


def rates(system: System, channel: ComplexArray, powers_w: FloatArray, order: IntArray | None = None) -> FloatArray:
    """Rates [..., K] [bit/s] for effective channels [..., K, M] and powers [..., K] [W].

    `access.noma_rates`, in the given decoding order [..., V, K/V] or that of the slot's gains, or `access.oma_rates`.
    Raises `ValueError` for a negative power.
    """
    if not (powers_w >= 0).all():
        raise ValueError(f"power_w: {powers_w} is not allowed: every power must be at least 0 W")
    order = np.empty((0, *system.clusters.shape), np.int64) if order is None else order
    flat = _rates(system, _flat(channel, 2), _flat(_filling(powers_w, channel.shape[:-1]), 1), order)
    return flat.reshape(channel.shape[:-1])


def qos_or_sum(
    system: System, channel: ComplexArray, wanted_bps: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Powers [..., K] [W] for effective channels [..., K, M], and their rates [..., K] [bit/s]: the most in eq. (R).

    Those of `control.qos_first_powers` where they give every user its QoS: for `wanted_bps` [..., K] >= QoS if that can
    be had, or else for the QoS itself. If not, it is missed anyhow, and only the sum counts: then the strongest user of
    a cluster has all of its power. With OMA every user has P/K.
    """
    shape = channel.shape[:-1]
    wanted = np.full(shape, system.qos_bps) if wanted_bps is None else _filling(wanted_bps, shape)
    powers, reached = _serve_all(system, _flat(channel, 2), _flat(wanted, 1))
    return powers.reshape(shape), reached.reshape(shape)


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
        if system.oma:
            found[cell] = _oma(system, channel[cell], _band_beams(system, channel[cell]), powers[cell])
        else:
            budgets = np.zeros(len(system.clusters))
            for v in range(len(budgets)):
                for user in system.clusters[v]:
                    budgets[v] += powers[cell, user]
            gains = _effective_gains(system, channel[cell], _cluster_beams(system, channel[cell]), budgets)
            decoded = order[cell] if len(order) > 0 else ascending(system.clusters, gains)
            cancelled(system.bandwidth_hz, gains, powers[cell], decoded, found[cell])
    return found


@compiled
def _serve_all(system: System, channel: ComplexArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    powers, reached = np.empty(wanted.shape), np.empty(wanted.shape)
    for cell in range(len(channel)):
        powers[cell], reached[cell], _ = serve(system, channel[cell], wanted[cell])
    return powers, reached


@compiled
def serve(system: System, channel: ComplexArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Powers and rates [K] of `qos_or_sum` in one cell, and the beam of every user [K, M]."""
    users = len(channel)
    if system.oma:
        beams = _band_beams(system, channel)
        powers = np.full(users, system.tx_power_w / users)
        return powers, _oma(system, channel, beams, powers), beams
    heads = _cluster_beams(system, channel)
    budget = system.tx_power_w / len(system.clusters)
    gains = _effective_gains(system, channel, heads, np.full(len(heads), budget))
    order = ascending(system.clusters, gains)
    shares, powers, reached = np.empty(users), np.empty(users), np.empty(users)
    for user in range(users):
        shares[user] = needed_share(system.bandwidth_hz, wanted[user])
    qos_first(gains, order, budget, shares, powers)
    cancelled(system.bandwidth_hz, gains, powers, order, reached)
    for least in (system.qos_bps, 0.0):
        if reached.min() < system.qos_bps:
            shares[:] = needed_share(system.bandwidth_hz, least)
            qos_first(gains, order, budget, shares, powers)
            cancelled(system.bandwidth_hz, gains, powers, order, reached)
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
                    interference += _received(channel, user, beams, other) * budgets[other]
            gains[user] = _received(channel, user, beams, v) / interference
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
                    unwanted += _received(channel, user, beams, other) * powers[other]
            sinr = _received(channel, user, beams, user) * powers[user] / unwanted  # eq. (SINROMA)
            found[user] = system.bandwidth_hz / bands / math.log(2) * math.log1p(sinr)
    return found


@compiled
def _cluster_beams(system: System, channel: ComplexArray) -> ComplexArray:
    """The beam of every cluster [V, M], zero-forced on its strongest user, eq. (ZFNOMA)."""
    heads = np.empty(len(system.clusters), np.int64)
    for v in range(len(heads)):
        strongest = -1.0
        for user in system.clusters[v]:
            own = strength(channel, user)
            if own > strongest:
                heads[v], strongest = user, own
    return _zero_forcing(channel, heads)


@compiled
def _band_beams(system: System, channel: ComplexArray) -> ComplexArray:
    """The beam of every user [K, M], zero-forced among the users of its band."""
    beams = np.empty_like(channel)
    for band in range(system.clusters.shape[1]):
        own = _zero_forcing(channel, system.clusters[:, band])
        for place in range(len(own)):
            for m in range(own.shape[1]):
                beams[system.clusters[place, band], m] = own[place, m]
    return beams


@compiled
def _zero_forcing(channel: ComplexArray, users: IntArray) -> ComplexArray:
    """`access.zero_forcing` of some users: their beams as rows [S, M], eq. (ZF).

    Gauss and Jordan's elimination; a matrix of inner products needs no pivots.
    """
    size, antennas = len(users), channel.shape[1]
    beams = np.empty((size, antennas), np.complex128)
    gram = np.empty((size, size), np.complex128)
    for i in range(size):
        inverse = 1 / math.sqrt(strength(channel, users[i]))
        for m in range(antennas):
            beams[i, m] = inverse * channel[users[i], m].conjugate()
    for i in range(size):
        for j in range(size):
            gram[i, j] = 0
            for m in range(antennas):
                gram[i, j] += beams[i, m] * beams[j, m].conjugate()
    for i in range(size):
        if not gram[i, i].real > 1e-14:
            raise np.linalg.LinAlgError("the channels of users who are served together are linearly dependent")
        for j in range(size):
            if j != i:
                factor = 1 / gram[i, i].real * gram[j, i]
                for column in range(i, size):
                    gram[j, column] -= factor * gram[i, column]
                for m in range(antennas):
                    beams[j, m] -= factor * beams[i, m]
    for i in range(size):
        inverse = 1 / math.sqrt(strength(beams, i))
        for m in range(antennas):
            beams[i, m] *= inverse
    return beams


@compiled
def strength(rows: ComplexArray, row: int) -> float:
    """Squared norm of a row of [S, M]."""
    total = 0.0
    for m in range(rows.shape[1]):
        total += rows[row, m].real ** 2 + rows[row, m].imag ** 2
    return total


@compiled
def _received(channel: ComplexArray, user: int, beams: ComplexArray, beam: int) -> float:
    """|h g|² of a user's channel in [K, M] and a beam in [S, M]."""
    amplitude = 0j
    for m in range(channel.shape[1]):
        amplitude += channel[user, m] * beams[beam, m]
    return amplitude.real**2 + amplitude.imag**2
