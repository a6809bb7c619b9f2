"""What the sum rate of a slot cannot exceed, whatever phases and powers are chosen."""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.radio.channel import Channels, cascade, effective_channel, ris_response
from mjris.radio.control import aligned_phases

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.integer]

_TANGENTS = 3
"""Tangents tried for every choice of users; each one gives a bound, and the least counts."""


def upper_bound(channels: Channels, clusters: IntArray, radio: Radio) -> FloatArray:
    """A bound [...] [bit/s] on the sum rate of every slot, over all phases and all powers that `radio` allows.

    `channels` have the leading axes [...] of the slots, `clusters` are int [V, K/V]. Proof, with c = P/(V σ²) and
    x_k = ‖h_k‖² for the phases in question:

    1. Beams have unit norm and interference only harms, so user k has the SNR x_k p/σ² at most for a power p.
       NOMA: in a cluster with gains e_k <= x_k/σ² the rates add up to B log2(1 + P/V max_k e_k) at most: a sum of
       log2((1 + e_k (p_k + I_k)) / (1 + e_k I_k)) grows in each e_k, and telescopes where all are the same.
       OMA: a user has P/K, and V/K of band and noise, so B V/K log2(1 + c x_k).
       So the sum rate is at most B Σ_k a_k log2(1 + c x_k), for OMA with a_k = V/K, for NOMA with a_k = 1 for
       one user of each cluster and 0 for the others, whichever choice of users gives most.
    2. The logarithm is concave: log(1 + c x) <= log(1 + c y) + w (x - y) with w = c/(1 + c y), for any y >= 0.
    3. All phases are shared: Σ_k a_k w_k x_k <= T for all of them, with T from `_most_gain`.
    """
    loaded = channels._replace(reflected=radio.element_amplitude * channels.reflected)
    shares = _shares(np.asarray(clusters), radio)
    snr = radio.tx_power_w / (radio.num_clusters * radio.noise_w)
    links = Channels(*(link[..., None, :, :] for link in loaded))
    weights = np.broadcast_to(shares, (*channels.direct.shape[:-2], *shares.shape))
    bound = np.full(weights.shape[:-1], np.inf)
    for _ in range(_TANGENTS):
        phases = aligned_phases(_broadcast(links, len(shares)), weights, iterations=20)
        effective = effective_channel(links, ris_response(phases, np.ones(())))
        touch = snr * (abs(effective) ** 2).sum(-1)
        weights = shares / (1 + touch)
        most = snr * _most_gain(links, weights, phases)
        tangent = (shares * np.log1p(touch) - weights * touch).sum(-1) + most
        bound = np.minimum(bound, tangent)
    return radio.bandwidth_hz / math.log(2) * bound.max(-1)
