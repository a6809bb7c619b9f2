"""Multiple access over NumPy arrays: a face of `beams` and `serving` with all that is checked about arguments.

Rows of a channel are received as `channel @ beams`, without conjugation. Equation labels are those of the paper.
"""

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjris.jit.compiled import compiled
from mjris.radio import beams, serving
from mjris.radio.serving import System

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


def zero_forcing(channel: ArrayLike) -> ComplexArray:
    """Unit-norm beams [..., M, S] that null every row of `channel` [..., S, M] but their own: `beams.zero_forcing`.

    Raises `ValueError` where S > M.
    """
    rows = np.asarray(channel, np.complex128)
    users, antennas = rows.shape[-2:]
    if users > antennas:
        raise ValueError(f"channel: zero forcing of {users} users needs as many antennas, and there are {antennas}")
    made = _zero_forcing_all(np.ascontiguousarray(rows).reshape(-1, users, antennas))
    return np.swapaxes(made.reshape(rows.shape), -1, -2)


def noma_rates(
    channel: ArrayLike,
    power_w: ArrayLike,
    clusters: ArrayLike,
    bandwidth_hz: float,
    noise_w: float,
    order: ArrayLike | None = None,
) -> FloatArray:
    """Rates of the users [..., K] [bit/s] where clusters share the whole band and their users cancel each other.

    `channel` [..., K, M] is the effective channel, `power_w` [..., K] [W], `clusters` int [V, K/V] the users of every
    cluster, `noise_w` the noise in the whole band [W], and `order` int [..., V, K/V] the users of every cluster from
    first decoded to last, None for the order by gain. A signal has the least rate of all users that must decode it;
    who is sent nothing decodes for nobody. Raises `ValueError` for negative powers, and for clusters or an order that
    do not hold every user once.
    """
    system, channels, powers = _arguments(channel, power_w, clusters, bandwidth_hz, noise_w, oma=False)
    given = None if order is None else _given(np.asarray(order), system.clusters, channels.shape[:-2])
    return serving.rates(system, channels, powers, given)


def oma_rates(
    channel: ArrayLike, power_w: ArrayLike, clusters: ArrayLike, bandwidth_hz: float, noise_w: float
) -> FloatArray:
    """Rates of the users [..., K] [bit/s] where each of a cluster's K/V users has a band of B·V/K.

    Column i of `clusters` is the users of band i, who are zero-forced, and a band has its share of the noise.
    Arguments and errors as in `noma_rates`.
    """
    system, channels, powers = _arguments(channel, power_w, clusters, bandwidth_hz, noise_w, oma=True)
    return serving.rates(system, channels, powers)


def decoding_order(channel: ArrayLike, power_w: ArrayLike, clusters: ArrayLike, noise_w: float) -> IntArray:
    """Users of every cluster from first decoded to last, int [..., V, K/V]: by ascending effective gain.

    For any powers, no other order has a higher sum rate. Arguments and errors as in `noma_rates`.
    """
    system, channels, powers = _arguments(channel, power_w, clusters, 1.0, noise_w, oma=False)
    users, antennas = channels.shape[-2:]
    flat = channels.reshape(-1, users, antennas), np.ascontiguousarray(powers).reshape(-1, users)
    return serving.decoding_order(system, *flat).reshape(*channels.shape[:-2], *system.clusters.shape)


def _arguments(
    channel: ArrayLike, power_w: ArrayLike, clusters: ArrayLike, bandwidth_hz: float, noise_w: float, *, oma: bool
) -> tuple[System, ComplexArray, FloatArray]:
    """The system, channels [..., K, M] and powers [..., K], checked and broadcast."""
    channels, powers = np.asarray(channel, np.complex128), np.asarray(power_w, np.float64)
    if not (powers >= 0).all():
        raise ValueError(f"power_w: {powers} is not allowed: every power must be at least 0 W")
    system = System(_partition(clusters, channels.shape[-2]), oma, 0.0, bandwidth_hz, noise_w, 0.0, False)
    batch = np.broadcast_shapes(channels.shape[:-2], powers.shape[:-1])
    together = np.broadcast_to(channels, (*batch, *channels.shape[-2:]))
    return system, np.ascontiguousarray(together), np.broadcast_to(powers, together.shape[:-1])


def _partition(clusters: ArrayLike, num_users: int) -> IntArray:
    """`clusters` int [V, K/V]. Raises `ValueError` where they do not hold each of the users once."""
    made = np.ascontiguousarray(clusters, np.int64)
    members = itertools.chain(*made.tolist()) if made.ndim == 2 else ()
    if sorted(members) != list(range(num_users)):
        raise ValueError(f"clusters: {clusters} is not allowed: [V, K/V] must hold each of {num_users} users once")
    return made


def _given(order: IntArray, clusters: IntArray, batch: tuple[int, ...]) -> IntArray:
    """A decoding order [B, V, K/V] for every cell. Raises `ValueError` where a row lacks a user of its cluster."""
    if order.shape[-2:] != clusters.shape or not np.all(np.sort(order, -1) == np.sort(clusters, -1)):
        raise ValueError("order: every row must hold the users of its cluster once")
    return np.ascontiguousarray(np.broadcast_to(order, (*batch, *clusters.shape)), np.int64).reshape(
        -1, *clusters.shape
    )


@compiled
def _zero_forcing_all(channel: ComplexArray) -> ComplexArray:
    made, everybody = np.empty_like(channel), np.arange(channel.shape[1])
    for cell in range(len(channel)):
        made[cell] = beams.zero_forcing(channel[cell], everybody)
    return made
