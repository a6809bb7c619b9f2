"""What clusters best spend: they disturb each other's weaker users, so that less can be more."""

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.merit import counting, inverse_gains, noma_merit, score
from mjris.radio.serving import System

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]

_HALVINGS = 6
"""How finely budgets are chosen: to P/V over two to the power of this."""
_HAIR = 1 + 1e-12


@compiled
def equal_budgets(system: System) -> FloatArray:
    """P/V for each cluster [V] [W]."""
    return np.full(len(system.clusters), system.tx_power_w / len(system.clusters))


@compiled
def best_budgets(
    system: System, sinr: float, received: FloatArray, weights: FloatArray, order: IntArray, budgets: FloatArray
) -> float:
    """Write the best `budgets` [V] [W] known for users who `received` |h_k g_v|² [K, V], and return their `score`.

    For a least `sinr`, and QoS-first powers. One cluster after the other is tried with more and with less, first by all
    of P/V, then by halves of it, within P/V or, where clusters share, what others leave of P; none goes below what its
    QoS takes.
    """
    full = equal_budgets(system)
    budgets[:] = full
    best = _score(system, sinr, received, weights, order, budgets)
    if len(full) == 1:
        return best
    best = _improved(system, sinr, received, weights, order, budgets, best, False)
    return _improved(system, sinr, received, weights, order, budgets, best, True) if system.shares_power else best


@compiled
def _improved(
    system: System,
    sinr: float,
    received: FloatArray,
    weights: FloatArray,
    order: IntArray,
    budgets: FloatArray,
    best: float,
    shared: bool,
) -> float:
    """Improve `budgets` [V] [W] of score `best`, within P/V or, if `shared`, P in all; returns the score reached."""
    full = system.tx_power_w / len(budgets)
    for attempt in range(len(budgets) + _HALVINGS):
        step = min(1.0, 0.5 ** (attempt - len(budgets) + 1)) * full
        start, improved = budgets.copy(), budgets.copy()
        for up in range(-1, len(budgets)):
            for down in range(-1, len(budgets)):
                # Moves of one cluster, or from one to another where they share.
                if up == down or (up >= 0 and down >= 0 and not shared):
                    continue
                trial = start.copy()
                if down >= 0:
                    trial[down] = max(start[down] - step, 0.0)
                if up >= 0:
                    trial[up] = min(start[up] + step, _most(system, trial, up, shared))
                _raise_to_needed(system, sinr, received, order, trial, shared)
                found = _score(system, sinr, received, weights, order, trial)
                if found > best:
                    best = found
                    improved[:] = trial
        budgets[:] = improved
    return best


@compiled
def _most(system: System, budgets: FloatArray, cluster: int, shared: bool) -> float:
    """What a cluster can have at most [W]: P/V, or what others leave of P."""
    if shared:
        return system.tx_power_w - budgets.sum() + budgets[cluster]
    return system.tx_power_w / len(budgets)


@compiled
def _score(
    system: System, sinr: float, received: FloatArray, weights: FloatArray, order: IntArray, budgets: FloatArray
) -> float:
    inverse = inverse_gains(system, received, budgets)
    bits, shortfall, _ = noma_merit(system, sinr, inverse, budgets, weights, order)
    return score(bits, shortfall)


@compiled
def _raise_to_needed(
    system: System, sinr: float, received: FloatArray, order: IntArray, budgets: FloatArray, shared: bool
) -> None:
    """Raise `budgets` [V] [W] to what QoS takes of each where that can be had."""
    inverse = inverse_gains(system, received, budgets)
    counted = counting(system, inverse, order)
    for v in range(len(counted)):
        needed, factor = 0.0, sinr
        for user in counted[v]:
            needed += factor * inverse[user]
            factor *= 1 + sinr
        budgets[v] = min(max(budgets[v], needed * _HAIR), _most(system, budgets, v, shared))
