"""From actions to phases and powers, and the closed forms that serve as their references."""

import math

from array_api_compat import device

from mjris.radio.access import (
    arranged,
    decodable_gains,
    effective_gains,
    later_users,
    partition,
    resolve_order,
)
from mjris.radio.channel import Channels, effective_channel
from mjris.radio.namespace import Array, array_namespace


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
    gets the rest. In an `order` that is not that of the gains a user has the gain of the weakest that decodes its
    signal, and all are taken to be served. Where no QoS is asked for, all goes to the strongest user in any order.
    "oma": every user has P/K. Other arguments and errors as in `noma_rates` and `split_powers`.
    """
    xp = array_namespace(channel)
    num_users = channel.shape[-2]
    clusters = partition(clusters, num_users, channel)
    if _is_oma(scheme):
        return xp.full(channel.shape[:-1], tx_power_w / num_users, dtype=xp.float64, device=device(channel))
    budgets = xp.full((clusters.shape[0],), tx_power_w / clusters.shape[0], dtype=xp.float64, device=device(channel))
    gains = effective_gains(channel, budgets, clusters, noise_w)
    least = xp.asarray(qos_bps, dtype=gains.dtype, device=device(gains))
    # Whom nothing is sent decodes for nobody.
    resolved = resolve_order(gains, clusters, order if xp.any(least > 0) else None)
    sequence = xp.broadcast_to(xp.reshape(resolved, (*resolved.shape[:-2], num_users)), gains.shape)

    def decoded(values: Array) -> Array:
        in_order = xp.take_along_axis(xp.broadcast_to(values, gains.shape), sequence, axis=-1)
        return xp.reshape(in_order, (*gains.shape[:-1], *clusters.shape))

    decodable = decoded(decodable_gains(gains, later_users(resolved)))
    powers = qos_first_split(decodable, xp.broadcast_to(budgets, decodable.shape[:-1]), bandwidth_hz, decoded(least))
    return xp.take_along_axis(xp.reshape(powers, gains.shape), xp.argsort(sequence, axis=-1), axis=-1)


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
