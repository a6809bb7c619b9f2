"""What phases and budgets are climbed for: the merit of a slot, and its slopes through the zero-forced beams.

In [bit/s/Hz]. Slopes of a real value by complex numbers z are such that it changes by Re Σ conj(slope) dz.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.beams import cluster_beams, strength, zero_forcing
from mjris.radio.decoding import ascending
from mjris.radio.serving import System

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_SHORTFALL_WEIGHT = 10.0
"""What a shortfall of one costs [bit/s/Hz]: more than what rates could gain by it."""
_HAIR = 1 + 1e-9
"""By how much the SINR that QoS takes is exceeded, so that rounding never leaves a rate below it."""


@compiled
def score(bits: float, shortfall: float) -> float:
    """What solutions are compared by: the sum rate where all have QoS, else minus the shortfall."""
    return -shortfall if shortfall > 0 else bits


@compiled
def sinr_of(bandwidth_hz: float, rate_bps: float) -> float:
    """SINR t that a rate takes in a band, and a hair more."""
    return math.expm1(math.log(2) / bandwidth_hz * rate_bps) * _HAIR


@compiled
def least_sinr(system: System) -> float:
    """SINR that QoS takes in the band of a user."""
    bands = system.clusters.shape[1] if system.oma else 1
    return sinr_of(system.bandwidth_hz / bands, system.qos_bps)


@compiled
def amplitudes(system: System, channel: ComplexArray, beams: ComplexArray) -> ComplexArray:
    """What users receive over the beams of clusters, h_k g_v [K, V]; `beams` [K, M] are those of the users."""
    made = np.zeros((len(channel), len(system.clusters)), np.complex128)
    for v in range(made.shape[1]):
        beam = beams[system.clusters[v, 0]]
        for k in range(len(channel)):
            for m in range(channel.shape[1]):
                made[k, v] += channel[k, m] * beam[m]
    return made


@compiled
def powers_of(received: ComplexArray) -> FloatArray:
    """Squared moduli."""
    return received.real**2 + received.imag**2


@compiled
def inverse_gains(system: System, received: FloatArray, budgets: FloatArray) -> FloatArray:
    """1/e [K] [W], eq. (SINROMA), of users who `received` |h_k g_v|² [K, V], where clusters spend `budgets` [V] [W]."""
    inverse = np.empty(len(received))
    for v in range(len(system.clusters)):
        for user in system.clusters[v]:
            unwanted = system.noise_w
            for other in range(len(system.clusters)):
                if other != v:
                    unwanted += received[user, other] * budgets[other]
            inverse[user] = unwanted / received[user, v]
    return inverse


@compiled
def counting(system: System, inverse: FloatArray, order: IntArray) -> IntArray:
    """Whose gain counts at every place of the decoding order [V, K/V]: of the users from there on, the weakest's.

    In an `order` [V, K/V], or that of the gains if it begins with a negative number, for 1/e [K].
    """
    counted = order.copy() if order[0, 0] >= 0 else ascending(system.clusters, -inverse)
    for v in range(len(counted)):
        for place in range(counted.shape[1] - 2, -1, -1):
            later = counted[v, place + 1]
            if inverse[later] > inverse[counted[v, place]]:
                counted[v, place] = later
    return counted


@compiled
def noma_merit(
    system: System, sinr: float, inverse: FloatArray, budgets: FloatArray, weights: FloatArray, order: IntArray
) -> tuple[float, float, FloatArray]:
    """Sum rate, shortfall, and the slopes of both together by 1/e [K], of QoS-first powers.

    With t the `sinr` of QoS and users from first to last decoded, QoS takes Σ_i t (1+t)^(i-1) / e_i of a cluster. What
    it has beyond that adds log2(1 + e_n ΔP / (1+t)^n), which counts with the weight of the last user, to its n rates of
    QoS. What it lacks is a shortfall of ln(needed/P).
    """
    counted, slopes = counting(system, inverse, order), np.zeros(len(inverse))
    size = counted.shape[1]
    bits, shortfall, growth = 0.0, 0.0, (1 + sinr) ** size
    for v in range(len(counted)):
        needed, factor = 0.0, sinr
        for user in counted[v]:
            needed += factor * inverse[user]
            factor *= 1 + sinr
        last, spare = counted[v, -1], budgets[v] - needed
        if spare >= 0:
            more = spare / (inverse[last] * growth)
            bits += size * math.log1p(sinr) / math.log(2) + weights[last] * math.log1p(more) / math.log(2)
            by_more = weights[last] / ((1 + more) * math.log(2))
            by_needed = -by_more / (inverse[last] * growth)
            slopes[last] -= by_more * more / inverse[last]
        else:
            shortfall += math.log(needed / budgets[v])
            by_needed = -_SHORTFALL_WEIGHT / needed
        factor = sinr
        for user in counted[v]:
            slopes[user] += by_needed * factor
            factor *= 1 + sinr
    return bits, shortfall, slopes


@compiled
def slot_score(
    system: System, channel: ComplexArray, budgets: FloatArray, weights: FloatArray, order: IntArray
) -> float:
    """`score` of a channel [K, M] where clusters spend `budgets` [V] [W]."""
    if system.oma:
        bits, shortfall = _oma_merit(system, channel, weights, np.empty_like(channel))
    else:
        received = powers_of(amplitudes(system, channel, cluster_beams(channel, system.clusters)))
        inverse = inverse_gains(system, received, budgets)
        bits, shortfall, _ = noma_merit(system, least_sinr(system), inverse, budgets, weights, order)
    return score(bits, shortfall)


@compiled
def merit(
    system: System,
    channel: ComplexArray,
    budgets: FloatArray,
    weights: FloatArray,
    order: IntArray,
    barrier: float,
    slopes: ComplexArray,
) -> float:
    """The sum rate less what a shortfall costs; writes its slopes by the channel [K, M] to `slopes`.

    The merit jumps where another user of a cluster becomes the strongest; a `barrier` before those cliffs lets the
    ascent go along them, where it would get stuck.
    """
    if system.oma:
        bits, shortfall = _oma_merit(system, channel, weights, slopes)
        return bits - _SHORTFALL_WEIGHT * shortfall
    beams = cluster_beams(channel, system.clusters)
    amplitude = amplitudes(system, channel, beams)
    received = powers_of(amplitude)
    inverse = inverse_gains(system, received, budgets)
    bits, shortfall, by_inverse = noma_merit(system, least_sinr(system), inverse, budgets, weights, order)
    num_clusters = len(system.clusters)
    by_amplitude = np.empty_like(amplitude)
    for v in range(num_clusters):
        for user in system.clusters[v]:
            for w in range(num_clusters):
                by_power = -inverse[user] if w == v else budgets[w]
                by_amplitude[user, w] = 2 * by_inverse[user] * by_power / received[user, v] * amplitude[user, w]
    heads, seconds = _strongest(system, channel)
    of_beams = np.zeros((num_clusters, channel.shape[1]), np.complex128)
    own_beams = np.empty_like(of_beams)
    for w in range(num_clusters):
        own_beams[w] = beams[system.clusters[w, 0]]
    for k in range(len(channel)):
        for m in range(channel.shape[1]):
            slopes[k, m] = 0
            for w in range(num_clusters):
                slopes[k, m] += by_amplitude[k, w] * own_beams[w, m].conjugate()
                of_beams[w, m] += by_amplitude[k, w] * channel[k, m].conjugate()
    _through_zero_forcing(channel, heads, own_beams, of_beams, slopes)
    value = bits - _SHORTFALL_WEIGHT * shortfall
    if barrier > 0 and system.clusters.shape[1] > 1:
        value += _lead(channel, heads, seconds, barrier, slopes)
    return value


@compiled
def _oma_merit(system: System, channel: ComplexArray, weights: FloatArray, slopes: ComplexArray) -> tuple[float, float]:
    """Sum rate and shortfall with OMA, where everybody has P/K; writes `slopes` [K, M] as `merit`.

    Zero forcing leaves no interference.
    """
    users, bands = len(channel), system.clusters.shape[1]
    snr = system.tx_power_w / users * bands / system.noise_w
    needed = least_sinr(system)
    bits, shortfall = 0.0, 0.0
    slopes[:] = 0
    for band in range(bands):
        heads = system.clusters[:, band]
        beams = zero_forcing(channel, heads)
        of_beams = np.empty_like(beams)
        for place in range(len(heads)):
            user, own = heads[place], 0j
            for m in range(channel.shape[1]):
                own += channel[user, m] * beams[place, m]
            sinr = snr * (own.real**2 + own.imag**2)
            bits += weights[user] / bands * math.log1p(sinr) / math.log(2)
            by_sinr = weights[user] / bands / ((1 + sinr) * math.log(2))
            if sinr < needed:
                short = math.log(math.log1p(needed) / math.log1p(sinr))
                shortfall += short
                by_sinr += _SHORTFALL_WEIGHT / (math.log1p(sinr) * (1 + sinr))
            by_own = 2 * by_sinr * snr * own
            for m in range(channel.shape[1]):
                slopes[user, m] += by_own * beams[place, m].conjugate()
                of_beams[place, m] = by_own * channel[user, m].conjugate()
        _through_zero_forcing(channel, heads, beams, of_beams, slopes)
    return bits, shortfall


@compiled
def _through_zero_forcing(
    channel: ComplexArray, heads: IntArray, beams: ComplexArray, of_beams: ComplexArray, slopes: ComplexArray
) -> None:
    """Add to `slopes` [K, M] what those `of_beams` [V, M] mean for the channels of the users they are made for.

    W = Hᴴ (H Hᴴ)⁻¹ has columns g_v / (h_v g_v), W ᴴW = (H Hᴴ)⁻¹, and dW = -W dH W + (I - W H) dHᴴ Wᴴ W.
    """
    size, antennas = beams.shape
    columns, of_columns = np.empty_like(beams), np.empty_like(beams)
    for v in range(size):
        own, along = 0j, 0.0
        for m in range(antennas):
            own += channel[heads[v], m] * beams[v, m]
            along += (beams[v, m].conjugate() * of_beams[v, m]).real
        for m in range(antennas):
            columns[v, m] = beams[v, m] / own.real
            of_columns[v, m] = (of_beams[v, m] - along * beams[v, m]) * own.real
    for v in range(size):
        for i in range(size):
            inner, gram = 0j, 0j
            for m in range(antennas):
                inner += columns[v, m].conjugate() * of_columns[i, m]
                gram += columns[v, m].conjugate() * columns[i, m]
            for m in range(antennas):
                slopes[heads[v], m] += gram * of_columns[i, m].conjugate() - inner * columns[i, m].conjugate()
            for j in range(size):
                across = 0j
                for m in range(antennas):
                    across += of_columns[i, m].conjugate() * columns[j, m]
                for m in range(antennas):
                    slopes[heads[v], m] -= gram * across * channel[heads[j], m]


@compiled
def _strongest(system: System, channel: ComplexArray) -> tuple[IntArray, IntArray]:
    """The strongest and the second user of every cluster [V]; in a cluster of one the second is the same."""
    heads, seconds = system.clusters[:, 0].copy(), system.clusters[:, -1].copy()
    for v in range(len(heads)):
        first, second = -1.0, -1.0
        for user in system.clusters[v]:
            own = strength(channel, user)
            if own > first:
                second, seconds[v] = first, heads[v]
                first, heads[v] = own, user
            elif own > second:
                second, seconds[v] = own, user
    return heads, seconds


@compiled
def _lead(channel: ComplexArray, heads: IntArray, seconds: IntArray, barrier: float, slopes: ComplexArray) -> float:
    """How clearly one user is the strongest of its cluster, Σ_v ln(1 - ‖h_second‖²/‖h_first‖²); adds its slopes."""
    value = 0.0
    for v in range(len(heads)):
        first, second = strength(channel, heads[v]), strength(channel, seconds[v])
        ratio = min(second / first, 1 - 1e-9)
        value += barrier * math.log1p(-ratio)
        factor = 2 * barrier / ((1 - ratio) * first)
        for m in range(channel.shape[1]):
            slopes[seconds[v], m] -= factor * channel[seconds[v], m]
            slopes[heads[v], m] += factor * ratio * channel[heads[v], m]
    return value
