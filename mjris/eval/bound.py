"""What the sum rate of a slot cannot exceed, whatever phases and powers are chosen."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.radio.closed_forms import aligned_phases
from mjris.radio.links import Channels
from mjris.radio.surface import Surface, cascade, effective_channel

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.integer]

_TANGENTS = 2
"""Tangents that are tried; each of them gives a bound, and the least one counts."""
_ALIGNMENTS = 20
"""Iterations of the alignment at whose phases a tangent touches: the closer to the best, the tighter the bound."""


def upper_bound(channels: Channels, clusters: IntArray, radio: Radio) -> FloatArray:
    """A bound [...] [bit/s] on the sum rate of every slot, over all phases and all powers that `radio` allows.

    `channels` have the leading axes [...] of the slots, `clusters` are int [V, K/V]. Time and memory grow with the
    number of ways to choose one user from each cluster. Proof, with x_k = ‖h_k‖² at some phases and c = P/(V σ²), or
    P/σ² where clusters share:

    1. Beams have unit norm and interference only harms, so that no effective gain e_k exceeds x_k/σ².
       NOMA: the rates B log2((1 + e_k (p_k + I_k)) / (1 + e_k I_k)) of a cluster grow with every e_k, and if all have
       the largest one they add up to B log2(1 + e Σ_k p_k), which is at most B log2(1 + c x_k) for its best user k.
       OMA: a user has P/K at most, and V/K of band and noise: B V/K log2(1 + c x_k).
       So the sum rate is at most a B Σ_k log2(1 + c x_k): for NOMA with a = 1, over one user from each cluster,
       whichever give most; for OMA with a = V/K, over all users.
    2. The logarithm is concave: ln(1 + c x) <= ln(1 + c y) + w c (x - y) with w = 1/(1 + c y), for any y >= 0.
    3. The users share the phases, so that Σ_k w_k x_k has the bound of `_most_gain`.
    """
    clusters = np.asarray(clusters)
    num_clusters, size = clusters.shape
    # A scheduler that selects users may give all bands to one of each cluster, as in NOMA's bound, which exceeds OMA's.
    oma = radio.scheme == "oma" and not radio.oma_selection
    chosen = clusters.reshape(1, -1) if oma else np.stack(np.meshgrid(*clusters), -1).reshape(-1, num_clusters)
    # Any one cluster may have all where they share.
    shares = num_clusters if oma or radio.cluster_power == "equal" else 1
    snr = radio.tx_power_w / (shares * radio.noise_w)
    surface = Surface.of(radio).ideal  # as no surface gives more
    alone = _of_users(channels, np.arange(clusters.size)[:, None])
    everybody = np.ones(alone.direct.shape[:-1])
    # The first tangent touches at what each user could have for itself, so that the bound is not above their sum.
    touched = snr * _most_gain(surface, alone, everybody, _aligned(surface, alone, everybody))[..., chosen]
    links = _of_users(channels, chosen)
    bound = np.full(touched.shape[:-1], np.inf)
    for _ in range(_TANGENTS):
        weights = 1 / (1 + touched)
        phases = _aligned(surface, links, weights)
        tangent = (np.log1p(touched) - weights * touched).sum(-1) + snr * _most_gain(surface, links, weights, phases)
        bound = np.minimum(bound, tangent)
        touched = snr * (abs(effective_channel(surface, links, phases)) ** 2).sum(-1)
    return radio.bandwidth_hz / math.log(2) * (1 / size if oma else 1) * bound.max(-1)


def _of_users(channels: Channels, users: IntArray) -> Channels:
    """The channels of `users` [C, U] alone, [..., C, U, M] and so on: C choices of U users."""
    incident = np.repeat(channels.incident[..., None, :, :], len(users), axis=-3)
    return Channels(channels.direct[..., users, :], incident, channels.reflected[..., users, :])


def _aligned(surface: Surface, channels: Channels, weights: FloatArray) -> FloatArray:
    """Phases [..., N] [rad] that nearly maximise Σ_k w_k ‖h_k‖²."""
    return aligned_phases(surface, channels, weights, _ALIGNMENTS)


def _most_gain(surface: Surface, channels: Channels, weights: FloatArray, phases_rad: FloatArray) -> FloatArray:
    """A bound [...] on Σ_k w_k ‖h_k‖² over all phases, tight where `phases_rad` [..., N] are nearly the best.

    With ψ = (1, φ) the sum is ‖A ψ‖², where a row of A has the weighted paths to one user from one antenna. For any
    positive diagonal matrix D it is at most λ_max(D^-½ Aᴴ A D^-½) ψᴴ D ψ, and ψᴴ D ψ = tr D because of |ψ_n| = 1. At
    the best phases Aᴴ A ψ = D ψ for some D, which is what is taken; if the eigenvalue is one, nothing is lost. By the
    triangle inequality the sum is at most Σ_ij |Aᴴ A|_ij, too.
    """
    paths = np.concatenate([channels.direct[..., None, :, :], surface.amplitude * cascade(channels)], -3)
    paths = np.sqrt(weights)[..., None, :, None] * paths
    # Rows for users and antennas, columns for the direct path and the elements.
    rows = np.moveaxis(paths, -3, -1)
    rows = rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])
    columns = np.conj(rows.swapaxes(-2, -1))
    turns = np.exp(1j * np.concatenate([np.zeros_like(phases_rad[..., :1]), phases_rad], -1))
    received = rows @ turns[..., None]
    diagonal = abs(columns @ received)[..., 0]
    total = diagonal.sum(-1)
    diagonal = diagonal + 1e-9 * total[..., None] + np.finfo(float).tiny
    # The other product of the two factors has the same largest eigenvalue, and is smaller for many elements.
    largest = np.linalg.eigvalsh((rows / diagonal[..., None, :]) @ columns)[..., -1]
    triangle = abs(columns @ rows).sum((-2, -1))
    return np.minimum(largest * diagonal.sum(-1), triangle) * (1 + 1e-12)
