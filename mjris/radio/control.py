"""From actions to phases and powers, and the closed forms that serve as their references."""

import math
from typing import NamedTuple

from array_api_compat import device

from mjris.radio.access import (
    arranged,
    band_beams,
    cancellation_rates,
    cluster_beams,
    cluster_of,
    decodable_gains,
    effective_gains,
    later_users,
    oma_rates,
    partition,
    resolve_order,
)
from mjris.radio.channel import Channels, effective_channel
from mjris.radio.namespace import array_namespace
from mjris.radio.propagation import Array

_MORE_THAN_ANY_BPS = 1e12
_LINEAR_ITERATIONS = 2
"""How often `qos_aligned_phases` goes for the sum of the gains, before it cares for every user."""


def aligned_phases(channels: Channels, weights: Array | None = None, iterations: int = 3) -> Array:
    """Phases [..., N] [rad] that raise the channel gain Σ_k w_k ‖h_k‖², with `weights` [..., K] >= 0, or None for one.

    Aligned to the direct channel at first, which is optimal for one user and one antenna: (|h_d| + Σ_n |h_n g_n|)².
    Then every iteration aligns all elements to the whole channel. The gain is a convex function of the reflection
    coefficients φ and this maximises its tangent over |φ_n| = 1, so that it never falls. A modulus other than one
    belongs into `channels.reflected`.
    """
    xp = array_namespace(*channels)
    response = xp.ones_like(channels.incident[..., 0])
    response = _aligned_response(channels, channels.direct, weights, response)
    for _ in range(iterations):
        response = _aligned_response(channels, effective_channel(channels, response), weights, response)
    return xp.atan2(xp.imag(response), xp.real(response))


def qos_aligned_phases(
    channels: Channels,
    clusters: Array,
    scheme: str,
    tx_power_w: float,
    bandwidth_hz: float,
    noise_w: float,
    qos_bps: float,
    weights: Array | None = None,
    iterations: int = 7,
) -> Array:
    """Phases [..., N] [rad] for a high sum rate with QoS, under the powers of `qos_or_sum`.

    Starts, for every rank among a cluster's users, from the phases for the users of that rank and against the others:
    a cluster's beam follows its strongest user, and the phases choose who that is. Then every iteration aligns all
    elements to Σ_k w_k |h_k g_k|², the users' gains through their present beams, with `weights` [..., K] > 0, None for
    one. From the third iteration on it is the sum of the logarithms that counts, so that weak users do, too, and
    whoever misses QoS has his weight doubled. Of all that it meets from any start, it keeps the phases with QoS for
    every user, and among those the highest sum rate. Other arguments as in `qos_or_sum`.
    """
    xp = array_namespace(*channels)
    phases = aligned_phases(channels, _for_each_rank(channels.direct, clusters, weights), iterations=0)
    response = xp.exp(1j * phases)
    raised = xp.ones(channels.direct.shape[:-1], dtype=phases.dtype) if weights is None else weights
    best = xp.full(phases.shape[:-1], -math.inf, dtype=phases.dtype)
    for iteration in range(iterations):
        channel = effective_channel(channels, response)
        _, rates, beams = _serve(channel, clusters, scheme, tx_power_w, bandwidth_hz, noise_w, qos_bps)
        missed = rates < qos_bps
        score = xp.sum(rates, axis=-1) + xp.where(xp.any(missed, axis=-1), 0.0, _MORE_THAN_ANY_BPS)
        phases = xp.where((score > best)[..., None], xp.atan2(xp.imag(response), xp.real(response)), phases)
        best = xp.maximum(best, score)
        own = xp.sum(channel * xp.matrix_transpose(beams), axis=-1)
        if iteration < _LINEAR_ITERATIONS:
            pull = raised * xp.conj(own)
        else:
            raised = xp.where(missed, 2.0 * raised, raised)
            pull = raised / own  # conj(own) / |own|²
        response = _beam_aligned_response(channels, beams, pull, response)
    return xp.take_along_axis(phases, xp.argmax(best, axis=0)[None, ..., None], axis=0)[0, ...]


def _for_each_rank(direct: Array, clusters: Array, weights: Array | None) -> Array:
    """Weights [K/V, ..., K] for the users of one rank each, and against the others, per power that they receive."""
    xp = array_namespace(direct)
    clusters = partition(clusters, direct.shape[-2], direct)
    strength = xp.real(xp.vecdot(direct, direct))
    rank = xp.argsort(xp.argsort(-arranged(strength, clusters), axis=-1), axis=-1)
    rank = xp.take(xp.reshape(rank, strength.shape), xp.argsort(xp.reshape(clusters, (-1,))), axis=-1)
    chosen = xp.stack([rank == place for place in range(clusters.shape[1])])
    liked = xp.ones_like(strength) if weights is None else weights
    return xp.where(chosen, liked, -1 / liked) / xp.where(strength > 0, strength, 1.0)


def split_powers(shares: Array, clusters: Array, scheme: str, tx_power_w: float) -> Array:
    """Powers of the users [..., K] [W] for `shares` [..., K] in [0, 1] of what they may have, in all P at most.

    "noma": a cluster has P/V, and shares that add up to more than one are scaled down to it, eq. (OPPE); "oma": a user
    has P/K. `clusters` are int [V, K/V]. Raises `ValueError` for another scheme and for clusters that do not hold
    every user once.
    """
    xp = array_namespace(shares)
    clusters = partition(clusters, shares.shape[-1], shares)
    if _is_oma(scheme):
        return tx_power_w / shares.shape[-1] * shares
    in_cluster = arranged(shares, clusters)
    asked = xp.sum(in_cluster, axis=-1, keepdims=True)
    powers = tx_power_w / clusters.shape[0] * in_cluster / xp.where(asked > 1, asked, 1.0)
    return xp.take(xp.reshape(powers, shares.shape), xp.argsort(xp.reshape(clusters, (-1,))), axis=-1)


def qos_first_powers(
    channel: Array,
    clusters: Array,
    scheme: str,
    tx_power_w: float,
    bandwidth_hz: float,
    noise_w: float,
    qos_bps: float,
    order: Array | None = None,
) -> Array:
    """Powers of the users [..., K] [W] with the highest sum rate where every user has `qos_bps`, in closed form.

    "noma": every cluster spends P/V. In decoding order a user gets just what its QoS takes, t/(1+t) (P_left + 1/e)
    with t = 2^(R/B) - 1 and the effective gain e, or nothing where all that is left would not be enough; the last one
    gets the rest. "oma": every user has P/K. Other arguments and errors as in `noma_rates` and `split_powers`.
    """
    xp = array_namespace(channel)
    num_users = channel.shape[-2]
    clusters = partition(clusters, num_users, channel)
    if _is_oma(scheme):
        return xp.full(channel.shape[:-1], tx_power_w / num_users, dtype=xp.float64, device=device(channel))
    decoding = _decoding(channel, clusters, tx_power_w, noise_w, order)
    return _first_split(decoding, clusters, tx_power_w, bandwidth_hz, qos_bps)


def qos_or_sum(
    channel: Array,
    clusters: Array,
    scheme: str,
    tx_power_w: float,
    bandwidth_hz: float,
    noise_w: float,
    qos_bps: float,
    wanted_bps: Array | None = None,
) -> tuple[Array, Array]:
    """Powers of the users [..., K] [W], and their rates [..., K] [bit/s], for the most in eq. (R).

    Those of `qos_first_powers` where they give every user its QoS: for `wanted_bps` [..., K] >= QoS if that can be had,
    or else for the QoS itself. If not, it is missed anyhow, and only the sum counts: then the strongest user of a
    cluster has all of its power. With "oma" every user has P/K.
    """
    powers, rates, _ = _serve(channel, clusters, scheme, tx_power_w, bandwidth_hz, noise_w, qos_bps, wanted_bps)
    return powers, rates


def _serve(
    channel: Array,
    clusters: Array,
    scheme: str,
    tx_power_w: float,
    bandwidth_hz: float,
    noise_w: float,
    qos_bps: float,
    wanted_bps: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Powers and rates of `qos_or_sum`, and the beam of every user [..., M, K]."""
    xp = array_namespace(channel)
    clusters = partition(clusters, channel.shape[-2], channel)
    if _is_oma(scheme):
        powers = qos_first_powers(channel, clusters, scheme, tx_power_w, bandwidth_hz, noise_w, qos_bps)
        rates = oma_rates(channel, powers, clusters, bandwidth_hz, noise_w)
        return powers, rates, band_beams(channel, clusters)
    beams = cluster_beams(channel, clusters)
    decoding = _decoding(channel, clusters, tx_power_w, noise_w, beams=beams)
    least = xp.full_like(decoding.gains, qos_bps)
    # What is asked for from last to first choice, all of them tried at once.
    choices = [
        xp.zeros_like(least),
        least,
        *(() if wanted_bps is None else (xp.broadcast_to(wanted_bps, least.shape),)),
    ]
    tried = _first_split(decoding, clusters, tx_power_w, bandwidth_hz, xp.stack(choices))
    reached = cancellation_rates(decoding.gains, tried, decoding.later, bandwidth_hz)
    powers, rates = tried[0, ...], reached[0, ...]
    for choice in range(1, len(choices)):
        met = xp.all(reached[choice, ...] >= qos_bps, axis=-1, keepdims=True)
        powers = xp.where(met, tried[choice, ...], powers)
        rates = xp.where(met, reached[choice, ...], rates)
    return powers, rates, xp.take(beams, cluster_of(clusters), axis=-1)


class _Decoding(NamedTuple):
    """Who decodes what where every cluster spends all it has."""

    gains: Array
    """Effective gains [..., K]."""
    later: Array
    """`later_users` [..., K, K]."""
    sequence: Array
    """Users in decoding order, cluster by cluster, int [..., K]."""


def _decoding(
    channel: Array,
    clusters: Array,
    tx_power_w: float,
    noise_w: float,
    order: Array | None = None,
    beams: Array | None = None,
) -> _Decoding:
    xp = array_namespace(channel)
    budgets = xp.full((clusters.shape[0],), tx_power_w / clusters.shape[0], dtype=xp.float64, device=device(channel))
    gains = effective_gains(channel, budgets, clusters, noise_w, beams)
    resolved = resolve_order(gains, clusters, order)
    sequence = xp.broadcast_to(xp.reshape(resolved, (*resolved.shape[:-2], gains.shape[-1])), gains.shape)
    return _Decoding(gains, later_users(resolved), sequence)


def _first_split(decoding: _Decoding, clusters: Array, tx_power_w: float, bandwidth_hz: float, qos_bps: Array) -> Array:
    """`qos_first_split` of all clusters, powers [..., K] [W], for one QoS or that of every user [..., K].

    The QoS may have further leading axes, and then the powers have them, too.
    """
    xp = array_namespace(decoding.gains)

    def decoded(values: Array) -> Array:
        in_order = _along(values, decoding.sequence)
        return xp.reshape(in_order, (*in_order.shape[:-1], *clusters.shape))

    gains = decoded(decodable_gains(decoding.gains, decoding.later))
    least = decoded(xp.asarray(qos_bps, dtype=gains.dtype, device=device(gains)))
    budgets = xp.full_like(least[..., 0], tx_power_w / clusters.shape[0])
    powers = qos_first_split(xp.broadcast_to(gains, least.shape), budgets, bandwidth_hz, least)
    return _along(xp.reshape(powers, (*powers.shape[:-2], -1)), xp.argsort(decoding.sequence, axis=-1))


def _along(values: Array, index: Array) -> Array:
    """`values` [..., K] in the order of `index` [..., K], each broadcast to the other."""
    xp = array_namespace(index)
    shape = values.shape if values.ndim > index.ndim else index.shape
    return xp.take_along_axis(xp.broadcast_to(values, shape), xp.broadcast_to(index, shape), axis=-1)


def qos_first_split(gains: Array, budget_w: Array, bandwidth_hz: float, qos_bps: Array) -> Array:
    """How a cluster's users share its power, [..., K/V] [W], for effective gains [..., K/V] [1/W] in decoding order.

    `budget_w` [...] [W] is what the cluster spends, `qos_bps` one number or [..., K/V]. See `qos_first_powers`, which
    applies it to all clusters.
    """
    xp = array_namespace(gains)
    qos = xp.broadcast_to(xp.asarray(qos_bps, dtype=gains.dtype, device=device(gains)), gains.shape)
    # t/(1+t) = 1 - 2^(-R/B), a hair above it so that rounding never leaves a rate below its QoS.
    needed = -xp.expm1(-math.log(2) / bandwidth_hz * qos) * (1 + 1e-12)
    left = xp.broadcast_to(budget_w, gains.shape[:-1])
    powers = []
    for position in range(gains.shape[-1] - 1):
        wanted = needed[..., position] * (left + 1 / gains[..., position])
        power = xp.where(wanted <= left, wanted, 0.0)
        left = left - power
        powers.append(power)
    return xp.stack([*powers, left], axis=-1)


def _aligned_response(channels: Channels, channel: Array, weights: Array | None, response: Array) -> Array:
    """Coefficients [..., N] aligned to `channel` [..., K, M]: φ_n = exp(-j angle Σ_km w_k conj(h_km) c_knm).

    c is the cascade. An element that reaches no user keeps its coefficient in `response`.
    """
    xp = array_namespace(channel)
    towards = xp.conj(channel)
    if weights is not None:
        towards = weights[..., :, None] * towards
    pull = xp.sum(channels.reflected * (towards @ xp.matrix_transpose(channels.incident)), axis=-2)
    return _opposite_phase(pull, response)


def _beam_aligned_response(channels: Channels, beams: Array, pull: Array, response: Array) -> Array:
    """Coefficients [..., N] aligned to Σ_k pull_k h_k g_k for `beams` g [..., M, K] that are held, `pull` [..., K].

    With w_k conj(h_k g_k) of the present channel, the tangent of Σ_k w_k |h_k g_k|² as in `_aligned_response`.
    """
    xp = array_namespace(beams)
    through = channels.reflected * xp.matrix_transpose(channels.incident @ beams)
    return _opposite_phase(xp.sum(pull[..., None] * through, axis=-2), response)


def _opposite_phase(pull: Array, response: Array) -> Array:
    """Unit coefficients [..., N] that turn `pull` [..., N] real; `response` where there is no pull."""
    xp = array_namespace(pull)
    modulus = xp.abs(pull)
    return xp.where(modulus > 0, xp.conj(pull) / xp.where(modulus > 0, modulus, 1.0), response)


def _is_oma(scheme: str) -> bool:
    """Whether the scheme is OMA. Raises `ValueError` for one that is neither that nor NOMA."""
    if scheme not in ("noma", "oma"):
        raise ValueError(f"scheme: {scheme!r} is not known: it is one of noma, oma")
    return scheme == "oma"
