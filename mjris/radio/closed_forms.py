"""Closed-form phases of a slot, from what is known of its channels."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.beams import strength
from mjris.radio.decoding import ascending
from mjris.radio.links import Channels
from mjris.radio.powers import serve
from mjris.radio.serving import System
from mjris.radio.surface import Parts, Surface, effective, flattened, parts, pulled

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_LINEAR_ITERATIONS = 2
"""How often `qos_aligned_phases` goes for the sum of the gains, before it cares for every user."""
_MORE_THAN_ANY_BPS = 1e12
ITERATIONS = 7
"""Of `qos_aligned_phases`."""


def aligned_phases(
    surface: Surface, known: Channels, weights: FloatArray | None = None, iterations: int = 3
) -> FloatArray:
    """Phases [..., N] [rad] that raise the channel gain Σ_k w_k ‖h_k‖², with `weights` [..., K], None for one.

    Aligned to the direct channel at first, which is optimal for one user and one antenna: (|h_d| + Σ_n |h_n g_n|)².
    Then every iteration aligns all elements to the whole channel. For weights >= 0 the gain is a convex function of the
    reflection coefficients φ and this maximises its tangent over |φ_n| = 1, so that it never falls.
    """
    given = np.broadcast_to(np.ones(()) if weights is None else weights, known.direct.shape[:-1])
    given = np.ascontiguousarray(given).reshape(-1, known.direct.shape[-2])
    phases = _gain_aligned(surface, *flattened(known), given, iterations)
    return phases.reshape(known.incident.shape[:-1])


def qos_aligned_phases(
    system: System,
    surface: Surface,
    known: Channels,
    weights: FloatArray | None = None,
    order: IntArray | None = None,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """Phases [E, N] [rad] for a high sum rate with QoS, under the powers of `qos_or_sum` in a decoding `order`.

    Starts, for every rank among a cluster's users, from the phases for the users of that rank and against the others:
    a cluster's beam follows its strongest user, and the phases choose who that is. Then every iteration aligns all
    elements to Σ_k w_k |h_k g_k|², the users' gains through their present beams, with `weights` [E, K] > 0, None for
    one. From the third iteration on it is the sum of the logarithms that counts, so that weak users do, too, and
    whoever misses QoS has his weight doubled. Of all that it meets from any start, it keeps the phases with QoS for
    every user, and among those the highest sum rate.
    """
    weights = np.ones(known.direct.shape[:-1]) if weights is None else np.ascontiguousarray(weights)
    order = system.no_order(len(known.direct)) if order is None else order
    return _qos_aligned(system, surface, *flattened(known), weights, order, iterations)


@compiled
def _gain_aligned(
    surface: Surface,
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    weights: FloatArray,
    iterations: int,
) -> FloatArray:
    phases = np.empty((len(incident), incident.shape[1]))
    for cell in range(len(phases)):
        turns, over = unturned(incident.shape[1]), parts(incident[cell], reflected[cell])
        align(over, direct[cell].conj(), weights[cell], turns)
        for _ in range(iterations):
            channel = effective(surface, direct[cell], over, turns)
            align(over, channel.conj(), weights[cell], turns)
        write_phases(turns, phases[cell])
    return phases


@compiled
def unturned(elements: int) -> FloatArray:
    """The parts [2, N] of e^{jθ} for phase zero."""
    turns = np.zeros((2, elements))
    turns[0] = 1
    return turns


@compiled
def write_phases(turns: FloatArray, phases: FloatArray) -> None:
    """Write the angles [N] [rad] of e^{jθ} to `phases`."""
    for n in range(len(phases)):
        phases[n] = math.atan2(turns[1, n], turns[0, n])


@compiled
def _qos_aligned(
    system: System,
    surface: Surface,
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    weights: FloatArray,
    order: IntArray,
    iterations: int,
) -> FloatArray:
    phases = np.zeros(incident.shape[:2])
    for cell in range(len(phases)):
        over = parts(incident[cell], reflected[cell])
        turns = best_alignment(system, surface, direct[cell], over, weights[cell], order[cell], iterations)
        write_phases(turns, phases[cell])
    return phases


@compiled
def best_alignment(
    system: System,
    surface: Surface,
    direct: ComplexArray,
    over: Parts,
    weights: FloatArray,
    order: IntArray,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """The parts [2, N] of e^{jθ} of `qos_aligned_phases` in one cell."""
    best, found = -np.inf, unturned(over.incident.shape[2])
    for rank in range(system.clusters.shape[1]):
        score, turns = _climb(system, surface, direct, over, weights, order, rank, iterations)
        if score > best:
            best, found = score, turns
    return found


@compiled
def _climb(
    system: System,
    surface: Surface,
    direct: ComplexArray,
    over: Parts,
    weights: FloatArray,
    order: IntArray,
    rank: int,
    iterations: int,
) -> tuple[float, FloatArray]:
    """The best score of `qos_aligned_phases` from the start for one rank, and the parts [2, N] of e^{jθ} there."""
    users, elements = over.reflected.shape[1:]
    turns, best_turns, best = unturned(elements), unturned(elements), -np.inf
    raised, least = weights.copy(), np.full(users, system.qos_bps)
    align(over, direct.conj(), _for_rank(system, direct, weights, rank), turns)
    for iteration in range(iterations):
        channel = effective(surface, direct, over, turns)
        _, reached, beams = serve(system, channel, least, order)
        score = reached.sum()
        if reached.min() >= system.qos_bps:
            score += _MORE_THAN_ANY_BPS
        if score > best:
            best = score
            best_turns[:] = turns
        toward = np.empty(users, np.complex128)
        for k in range(users):
            own = 0j
            for m in range(beams.shape[1]):
                own += channel[k, m] * beams[k, m]
            # The tangent of Σ_k w_k |h_k g_k|², or that of its logarithms.
            if iteration < _LINEAR_ITERATIONS:
                toward[k] = raised[k] * own.conjugate()
            else:
                if reached[k] < system.qos_bps:
                    raised[k] *= 2
                toward[k] = raised[k] / (own.real**2 + own.imag**2) * own.conjugate()
        align(over, beams, toward, turns)
    return best, best_turns


@compiled
def align(over: Parts, beams: ComplexArray, weights: np.ndarray, turns: FloatArray) -> None:
    """Turn Σ_k w_k (h_r,k)_n (G g_k)_n real for every element n, for beams g [K, M]; without any it stays as it is."""
    toward = np.empty(beams.shape, np.complex128)
    for k in range(len(beams)):
        for m in range(beams.shape[1]):
            toward[k, m] = weights[k] * beams[k, m]
    pull = pulled(over, toward)
    for n in range(turns.shape[1]):
        squared = pull[0, n] ** 2 + pull[1, n] ** 2
        inverse = 1 / math.sqrt(squared)
        turns[0, n] = pull[0, n] * inverse if squared > 0 else turns[0, n]
        turns[1, n] = -pull[1, n] * inverse if squared > 0 else turns[1, n]


@compiled
def _for_rank(system: System, direct: ComplexArray, weights: FloatArray, rank: int) -> FloatArray:
    """Weights [K] for the users of one rank, and against the others, per power that they receive."""
    gains, liked = np.empty(len(direct)), np.empty(len(direct))
    for user in range(len(direct)):
        gains[user] = strength(direct, user)
    order = ascending(system.clusters, gains)
    for v in range(len(order)):
        for place in range(order.shape[1]):
            user = order[v, place]
            weight = weights[user] if place == order.shape[1] - 1 - rank else -1 / weights[user]
            liked[user] = weight / (gains[user] if gains[user] > 0 else 1.0)
    return liked
