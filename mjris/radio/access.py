"""Zero forcing, decoding order, and the rates of NOMA and OMA.

Rows of a channel are received as `channel @ beams`, without conjugation. Equation labels are those of the paper.
"""

import itertools
import math

from array_api_compat import device

from mjris.radio.namespace import Array, array_namespace

SINGULAR, REGULAR = 1e-13, 1e-7
"""Channels whose matrix of inner products has a pivot below the first are taken for dependent, and have the second
added to its diagonal."""


def zero_forcing(channel: Array) -> Array:
    """Unit-norm beams [..., M, S] that null every row of `channel` [..., S, M] but their own, eq. (ZF).

    The paper's G = H (HᴴH)⁻¹ normalises the received gain to one instead, which would make the transmit power depend
    on the channel; with unit norm the powers are what is transmitted. No beam can tell linearly dependent rows
    apart: theirs are the regularised ones, (H Hᴴ + ε I)⁻¹ H for rows of norm one, for equal rows the matched filter.
    Raises `ValueError` where S > M.
    """
    xp = array_namespace(channel)
    rows, antennas = channel.shape[-2:]
    if rows > antennas:
        raise ValueError(f"channel: zero forcing of {rows} users needs as many antennas, and there are {antennas}")
    # The scale of a row does not change the beams; unit rows keep users with very different losses well conditioned.
    directions = _unit_rows(channel)
    conjugate = xp.conj(directions)
    gram = conjugate @ xp.matrix_transpose(directions)
    added = REGULAR * xp.astype(_least_pivot(gram) < SINGULAR, xp.float64)
    gram = gram + added[..., None, None] * xp.eye(rows, device=device(channel))
    return xp.matrix_transpose(_unit_rows(xp.linalg.solve(gram, conjugate)))


def _least_pivot(gram: Array) -> Array:
    """The least pivot [...] of Hermitian matrices [..., S, S] of inner products of unit vectors: zero if dependent."""
    xp = array_namespace(gram)
    least = xp.real(gram[..., 0, 0])
    for i in range(gram.shape[-1] - 1):
        # A pivot of zero leaves nothing to eliminate, and is the least one already.
        pivot = xp.where(xp.abs(gram[..., i, i]) > 0, gram[..., i, i], 1.0)
        gram = gram - gram[..., :, i, None] * gram[..., None, i, :] / pivot[..., None, None]
        least = xp.minimum(least, xp.real(gram[..., i + 1, i + 1]))
    return least


def noma_rates(
    channel: Array, power_w: Array, clusters: Array, bandwidth_hz: float, noise_w: float, order: Array | None = None
) -> Array:
    """Rates of the users [..., K] [bit/s] where clusters share the whole band and their users cancel each other.

    `channel` [..., K, M] is the effective channel, `power_w` [..., K] [W], `clusters` int [V, K/V] the users of every
    cluster, `noise_w` the noise in the whole band [W], and `order` int [..., V, K/V] the users of every cluster from
    first decoded to last, None for the order by gain. A signal has the least rate of all users that must decode it;
    who is sent nothing decodes for nobody. Raises `ValueError` for negative powers, and for clusters or an order that
    do not hold every user once.
    """
    clusters = partition(clusters, channel.shape[-2], channel)
    gains = _loaded_gains(channel, power_w, clusters, noise_w)
    return cancellation_rates(gains, power_w, later_users(resolve_order(gains, clusters, order)), bandwidth_hz)


def oma_rates(channel: Array, power_w: Array, clusters: Array, bandwidth_hz: float, noise_w: float) -> Array:
    """Rates of the users [..., K] [bit/s] where each of a cluster's K/V users has a band of B·V/K.

    Column i of `clusters` is the users of band i, who are zero-forced, and a band has its share of the noise.
    Arguments and errors as in `noma_rates`.
    """
    xp = array_namespace(channel, power_w)
    _check_powers(power_w)
    bands = xp.matrix_transpose(partition(clusters, channel.shape[-2], channel))
    num_bands, size = bands.shape
    users = xp.reshape(bands, (-1,))
    in_band = xp.reshape(xp.take(channel, users, axis=-2), (*channel.shape[:-2], num_bands, size, channel.shape[-1]))
    received = xp.abs(in_band @ zero_forcing(in_band)) ** 2 * arranged(power_w, bands)[..., None, :]
    position = xp.arange(size, device=device(channel))
    own = position == position[:, None]
    interference = xp.sum(xp.where(own, 0.0, received), axis=-1)
    sinr = xp.sum(xp.where(own, received, 0.0), axis=-1) / (interference + noise_w / num_bands)  # eq. (SINROMA)
    rates = _rates(sinr, bandwidth_hz / num_bands)
    return xp.take(xp.reshape(rates, (*rates.shape[:-2], -1)), xp.argsort(users), axis=-1)


def decoding_order(channel: Array, power_w: Array, clusters: Array, noise_w: float) -> Array:
    """Users of every cluster from first decoded to last, int [..., V, K/V]: by ascending effective gain.

    For any powers, no other order has a higher sum rate. Arguments and errors as in `noma_rates`.
    """
    clusters = partition(clusters, channel.shape[-2], channel)
    return resolve_order(_loaded_gains(channel, power_w, clusters, noise_w), clusters)


def partition(clusters: Array, num_users: int, like: Array) -> Array:
    """`clusters` int [V, K/V] as an array of the library of `like`.

    Raises `ValueError` where they do not hold each of the `num_users` users once.
    """
    clusters = array_namespace(like).asarray(clusters, device=device(like))
    # Lists, because as arrays so few numbers would take most of the time of the rates.
    members = itertools.chain(*clusters.tolist()) if clusters.ndim == 2 else ()
    if sorted(members) != list(range(num_users)):
        raise ValueError(f"clusters: {clusters} is not allowed: [V, K/V] must hold each of {num_users} users once")
    return clusters


def arranged(values: Array, clusters: Array) -> Array:
    """Values of the users [..., K] in the places of `clusters` [V, K/V]: [..., V, K/V]."""
    xp = array_namespace(values)
    return xp.reshape(xp.take(values, xp.reshape(clusters, (-1,)), axis=-1), (*values.shape[:-1], *clusters.shape))


def cluster_beams(channel: Array, clusters: Array) -> Array:
    """The beam of every cluster [..., M, V], zero-forced on its strongest user, eq. (ZFNOMA)."""
    xp = array_namespace(channel)
    strength = xp.real(xp.vecdot(channel, channel))
    strongest = xp.argmax(arranged(strength, clusters), axis=-1, keepdims=True)
    heads = xp.take_along_axis(xp.broadcast_to(clusters, (*strength.shape[:-1], *clusters.shape)), strongest, axis=-1)
    return zero_forcing(xp.take_along_axis(channel, heads, axis=-2))


def effective_gains(channel: Array, cluster_power_w: Array, clusters: Array, noise_w: float) -> Array:
    """e_k = |h_k g_v|² / (inter-cluster interference + noise) of every user [..., K] [1/W], eq. (SINROMA).

    `cluster_power_w` [..., V] [W] is what each cluster transmits in all, `clusters` as from `partition`, and
    g_v one of the `cluster_beams`.
    """
    xp = array_namespace(channel)
    received = xp.abs(channel @ cluster_beams(channel, clusters)) ** 2
    cluster_of_user = xp.argsort(xp.reshape(clusters, (-1,))) // clusters.shape[1]
    own = cluster_of_user[:, None] == xp.arange(clusters.shape[0], device=device(channel))
    interference = xp.sum(xp.where(own, 0.0, received) * cluster_power_w[..., None, :], axis=-1)
    return xp.sum(xp.where(own, received, 0.0), axis=-1) / (interference + noise_w)


def resolve_order(gains: Array, clusters: Array, order: Array | None = None) -> Array:
    """The decoding order int [..., V, K/V] for `gains` [..., K]: ascending, or `order` where one is given.

    Raises `ValueError` where a row of `order` does not hold the users of its cluster.
    """
    xp = array_namespace(gains)
    if order is None:
        ranking = xp.argsort(arranged(gains, clusters), axis=-1)
        return xp.take_along_axis(xp.broadcast_to(clusters, ranking.shape), ranking, axis=-1)
    given = xp.asarray(order, device=device(gains))
    if given.shape[-2:] != clusters.shape or not xp.all(xp.sort(given, axis=-1) == xp.sort(clusters, axis=-1)):
        raise ValueError("order: every row must hold the users of its cluster once")
    return given


def later_users(order: Array) -> Array:
    """Whether user j is decoded after user k in the same cluster, bool [..., K, K] over k and j.

    Then j must decode the signal of k first, and its own signal interferes with that of k.
    """
    xp = array_namespace(order)
    size = order.shape[-1]
    place = xp.argsort(xp.reshape(order, (*order.shape[:-2], -1)), axis=-1)
    after = place[..., None, :] > place[..., :, None]
    return after & (place[..., None, :] // size == place[..., :, None] // size)


def decodable_gains(gains: Array, later: Array) -> Array:
    """Least effective gain [..., K] of all users that must decode a signal: its own, and `later` ones [..., K, K]."""
    xp = array_namespace(gains)
    return xp.minimum(gains, xp.min(xp.where(later, gains[..., None, :], math.inf), axis=-1))


def cancellation_rates(gains: Array, power_w: Array, later: Array, bandwidth_hz: float) -> Array:
    """Rates [..., K] [bit/s] for effective gains and powers [..., K] where only `later` users interfere, eq. (inuk).

    Of these, who has power must decode a signal first.
    """
    xp = array_namespace(gains, power_w)
    interference = xp.sum(xp.where(later, power_w[..., None, :], 0.0), axis=-1)
    gains = decodable_gains(gains, later & (power_w[..., None, :] > 0))
    return _rates(gains * power_w / (gains * interference + 1), bandwidth_hz)


def _loaded_gains(channel: Array, power_w: Array, clusters: Array, noise_w: float) -> Array:
    """Effective gains [..., K] where the users have the powers `power_w` [..., K], which are checked."""
    xp = array_namespace(channel, power_w)
    _check_powers(power_w)
    return effective_gains(channel, xp.sum(arranged(power_w, clusters), axis=-1), clusters, noise_w)


def _rates(sinr: Array, bandwidth_hz: float) -> Array:
    """R = B log2(1 + γ) [bit/s]."""
    return bandwidth_hz / math.log(2) * array_namespace(sinr).log1p(sinr)


def _unit_rows(matrix: Array) -> Array:
    """`matrix` [..., S, M] with its rows scaled to norm one."""
    xp = array_namespace(matrix)
    return matrix / xp.sqrt(xp.real(xp.vecdot(matrix, matrix)))[..., None]


def _check_powers(power_w: Array) -> None:
    """Raises `ValueError` unless every power is zero or more."""
    if not array_namespace(power_w).all(power_w >= 0):
        raise ValueError(f"power_w: {power_w} is not allowed: every power must be at least 0 W")
