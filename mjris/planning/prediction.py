"""What the rover's panel would give at places, from geometry alone: mean amplitudes, no fading, no interference."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Radio
from mjris.jit.compiled import compiled, inlined
from mjris.radio.decoding import ascending
from mjris.radio.equations import cancelled_sinr, needed_share, qos_power_w, rate_bps
from mjris.radio.serving import System
from mjris.radio.surface import Mean, mean_coefficient

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class Arrays(NamedTuple):
    """The antennas and the rover's panel."""

    antennas: int
    elements: int
    element: Mean
    """What elements do on average."""

    @classmethod
    def of(cls, radio: Radio) -> "Arrays":
        """With the numbers of a config."""
        return cls(radio.num_antennas, radio.num_elements, mean_coefficient(radio))


def predicted_rates(
    direct: FloatArray, incident: FloatArray, reflected: FloatArray, clusters: IntArray, radio: Radio, qos_bps: float
) -> FloatArray:
    """Rates [..., K] [bit/s] under QoS-first powers or, where these leave somebody without QoS, all to the strongest.

    `direct` [..., K], `incident` [...] and `reflected` [..., K] are power gains of the links AP–user, AP–RIS and
    RIS–user, element patterns included. A beam is made for the strongest user of its cluster, less the dimensions that
    the other clusters' take, so that its mean gain is M - V + 1 times that of one antenna; to the others in the cluster
    it is a beam in a random direction. With OMA every user has a beam. The panel is shared by clusters, of which each
    has N/V elements in phase for the user that counts, and the other elements add up at random. Clusters are taken as
    perfectly separated.
    """
    shape = (-1, direct.shape[-1])
    rates = _predict_all(
        System.of(radio, clusters, qos_bps),
        Arrays.of(radio),
        np.ascontiguousarray(direct).reshape(shape),
        np.ascontiguousarray(incident).reshape(-1),
        np.ascontiguousarray(reflected).reshape(shape),
    )
    return rates.reshape(direct.shape)


@compiled
def _predict_all(
    system: System, arrays: Arrays, direct: FloatArray, incident: FloatArray, reflected: FloatArray
) -> FloatArray:
    no_others = np.empty((len(direct), 0)), np.empty((len(direct), 0, direct.shape[1])), np.empty(0, np.int64)
    beside = beside_rover(system, arrays, direct, *no_others)
    rates, gains, sorted_rates = np.empty(direct.shape), np.empty((direct.shape[1], 1)), np.empty((direct.shape[1], 1))
    for place in range(len(direct)):
        gains[:, 0] = reflected[place]
        with_panel(system, arrays, beside.coherent[place], beside.scattered[place], incident[place : place + 1], gains)
        users = system.clusters if system.oma else ascending(system.clusters, gains[:, 0])
        predict(system, arrays, gains, sorted_rates)
        for v in range(len(users)):
            for rank in range(users.shape[1]):
                rates[place, users[v, rank]] = sorted_rates[system.clusters[v, rank], 0]
    return rates


class Beside(NamedTuple):
    """What reaches users beside the paths over the rover's panel."""

    coherent: FloatArray
    """Mean amplitude of what is in phase [E, K]."""
    scattered: FloatArray
    """Mean power of what adds up at random [E, K]."""


@compiled
def beside_rover(
    system: System,
    arrays: Arrays,
    direct: FloatArray,
    incident: FloatArray,
    reflected: FloatArray,
    elements: IntArray,
) -> Beside:
    """`Beside` for power gains `direct` [E, K], and `incident` [E, S] and `reflected` [E, S, K] of the fixed panels.

    Panels with `elements` [S] are shared by clusters, as the rover's is.
    """
    beside = Beside(np.sqrt(direct), np.zeros(direct.shape))
    for e in range(direct.shape[0]):
        for s in range(len(elements)):
            in_phase = elements[s] / len(system.clusters)
            for k in range(direct.shape[1]):
                gain = incident[e, s] * reflected[e, s, k]
                amplitude, power = _over_panel(arrays.element, elements[s], in_phase, gain)
                beside.coherent[e, k] += amplitude
                beside.scattered[e, k] += power
    return beside


@compiled
def with_panel(
    system: System,
    arrays: Arrays,
    coherent: FloatArray,
    scattered: FloatArray,
    incident: FloatArray,
    reflected: FloatArray,
) -> None:
    """Write the users' gains over noise with the panel at P places, of one antenna each, over `reflected` [K, P].

    For power gains `incident` [P] and `reflected`, and for what is `Beside` them, [K] each.
    """
    in_phase = arrays.elements / len(system.clusters)
    for k in range(len(coherent)):
        alone, diffuse, gains = coherent[k], scattered[k], reflected[k]
        for p in range(len(gains)):
            amplitude, power = _over_panel(arrays.element, arrays.elements, in_phase, incident[p] * gains[p])
            amplitude += alone
            gains[p] = (amplitude * amplitude + power + diffuse) / system.noise_w


@inlined
def _over_panel(element: Mean, elements: float, in_phase: float, gain: float) -> tuple[float, float]:
    """Amplitude of what adds up in phase over a panel, and power of the rest, for the `gain` over one of its elements.

    Those that are to be in phase are so on average; what they miss adds up at random, as all of the others do.
    """
    squared = element.coherent * element.coherent
    return in_phase * element.coherent * math.sqrt(gain), (elements * element.power - in_phase * squared) * gain


@compiled
def predict(system: System, arrays: Arrays, gains: FloatArray, rates: FloatArray) -> None:
    """Write `predicted_rates` of P places to `rates` [K, P], for the users' gains over noise [K, P] with the panel.

    With NOMA, gains are sorted, and rates are of users by their gains: in the rows of a cluster's users come those of
    its weakest, of its second, and so on. Every loop over places is done in vectors.
    """
    num_clusters, size = system.clusters.shape
    places, beam_gain = gains.shape[1], arrays.antennas - num_clusters + 1
    later, powers = np.empty(places), np.empty((size, places))
    if system.oma:
        # A user has K/V of a cluster's bands' noise, and P/K of the power.
        for k in range(len(gains)):
            later[:], powers[0] = 0, beam_gain * size * system.tx_power_w / len(gains)
            _cancel(system.bandwidth_hz / size, gains[k], powers[0], later, rates[k])
        return
    needed, left = needed_share(system.bandwidth_hz, system.qos_bps), powers[-1]
    for users in system.clusters:
        _sort(gains, users)
        for p in range(places):
            gains[users[-1], p] *= beam_gain
        left[:], later[:] = system.tx_power_w / num_clusters, 0
        for rank in range(size - 1):
            _take(gains[users[rank]], needed, left, powers[rank])
        for rank in range(size - 1, -1, -1):
            _cancel(system.bandwidth_hz, gains[users[rank]], powers[rank], later, rates[users[rank]])
    _give_up_qos(system, gains, rates)


@compiled
def _give_up_qos(system: System, gains: FloatArray, rates: FloatArray) -> None:
    """Where somebody misses QoS in `rates` [K, P], give all of a cluster's power to its strongest, the last one."""
    budget, least = system.tx_power_w / len(system.clusters), rates[0].copy()
    for k in range(1, len(rates)):
        for p in range(len(least)):
            least[p] = min(least[p], rates[k, p])
    for users in system.clusters:
        for user in users[:-1]:
            for p in range(len(least)):
                rates[user, p] = rates[user, p] if least[p] >= system.qos_bps else 0.0
        strongest, gain = rates[users[-1]], gains[users[-1]]
        for p in range(len(least)):
            alone = rate_bps(system.bandwidth_hz, gain[p] * budget)
            strongest[p] = strongest[p] if least[p] >= system.qos_bps else alone


@compiled
def _sort(gains: FloatArray, users: IntArray) -> None:
    """Sort the gains of some users [K, P] at every place."""
    for last in range(len(users) - 1, 0, -1):
        for rank in range(last):
            lower, upper = gains[users[rank]], gains[users[rank + 1]]
            for p in range(len(lower)):
                lower[p], upper[p] = min(lower[p], upper[p]), max(lower[p], upper[p])


@compiled
def _take(gains: FloatArray, needed: float, left: FloatArray, powers: FloatArray) -> None:
    """Write the powers [P] that users need over all later ones' to `powers`, where there is as much `left` [P]."""
    for p in range(len(gains)):
        powers[p] = qos_power_w(gains[p], left[p], needed)
        left[p] -= powers[p]


@compiled
def _cancel(bandwidth_hz: float, gains: FloatArray, powers: FloatArray, later: FloatArray, rates: FloatArray) -> None:
    """Write rates [P] where only the powers of `later` users [P] interfere, to which these users' are added then."""
    for p in range(len(gains)):
        rates[p] = rate_bps(bandwidth_hz, cancelled_sinr(gains[p], powers[p], later[p]))
        later[p] += powers[p]
