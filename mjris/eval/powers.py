"""The best powers of a slot for channels that are given: what clusters spend, and how their users share it."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mjris.config import Radio
from mjris.radio.access import arranged, effective_gains, oma_rates, resolve_order
from mjris.radio.control import qos_first_split

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_HALVINGS = 6
"""How finely the budgets of clusters are chosen: to P/V over two to the power of this."""


class Problem(NamedTuple):
    """What powers are chosen for."""

    clusters: Tensor
    radio: Radio
    qos_bps: float
    order: Tensor | None = None
    """Decoding orders that are given [B, V, K/V], negative where they are those of the gains."""

    @property
    def without_qos(self) -> "Problem":
        """For the sum rate alone: then one user of a cluster has all, and no order matters, nor any band."""
        radio = replace(self.radio, scheme="noma") if self.radio.oma_selection else self.radio
        return self._replace(qos_bps=0.0, order=None, radio=radio)

    @property
    def full_budgets(self) -> Tensor:
        """What clusters may spend: P/V each, [V] [W]."""
        return torch.full((len(self.clusters),), self.radio.tx_power_w / len(self.clusters), dtype=torch.float64)

    @property
    def least_sinr(self) -> float:
        """SINR that QoS takes in the whole band; a hair more, so that rounding never leaves a rate below it."""
        return math.expm1(math.log(2) * self.qos_bps / self.radio.bandwidth_hz) * (1 + 1e-9)


def best_powers(
    effective: ComplexArray, clusters: IntArray, radio: Radio, qos_bps: float, order: IntArray | None = None
) -> FloatArray:
    """The powers [..., K] [W] with the highest sum rate known for effective channels [..., K, M].

    "oma": zero forcing leaves no interference, so that everybody best has P/K. "noma": for what a cluster spends,
    QoS-first is optimal in it. Clusters disturb each other's weaker users, so that it can pay to spend less than P/V;
    how much is searched numerically. Where QoS is out of reach for somebody, it is given up for all, and the power goes
    to where it gives the highest sum rate; with OMA only if its scheduler selects users. `order` as in `best_known`.
    """
    shape = effective.shape[:-1]
    if radio.scheme == "oma" and not radio.oma_selection:
        return np.full(shape, radio.tx_power_w / shape[-1])
    channel = torch.as_tensor(effective).reshape(-1, *effective.shape[-2:])
    problem = Problem(torch.as_tensor(clusters), radio, qos_bps, given_orders(order, clusters))
    alone = problem.without_qos
    budgets, sum_rate = best_budgets(alone, channel)
    unserved = _qos_first(alone, channel, budgets)
    if radio.scheme == "oma":
        everybody = torch.full(channel.shape[:-1], radio.tx_power_w / shape[-1], dtype=torch.float64)
        rate, shortfall = merit(problem, channel, problem.full_budgets)
        # Users are selected where somebody has no QoS and that gives more.
        powers = torch.where(((shortfall > 0) & (rate < sum_rate))[..., None], unserved, everybody)
    else:
        budgets, score = best_budgets(problem, channel)
        powers = torch.where((score >= 0)[..., None], _qos_first(problem, channel, budgets), unserved)
    return powers.reshape(shape).numpy()


def given_orders(order: IntArray | None, clusters: IntArray) -> Tensor | None:
    """Decoding orders [B, V, K/V], None where no slot has one of its own."""
    if order is None or (order < 0).all():
        return None
    return torch.as_tensor(order).reshape(-1, *clusters.shape)


def merit(problem: Problem, channel: Tensor, budgets: Tensor) -> tuple[Tensor, Tensor]:
    """Sum rate [...] [bit/s] and how far users fall short of QoS [...], logarithmic, zero if met.

    Where clusters spend `budgets` [..., V] [W]; with OMA, which has none, everybody has full power.
    """
    radio, clusters = problem.radio, problem.clusters
    if radio.scheme == "oma":
        powers = channel.new_full(channel.shape[:-1], radio.tx_power_w / channel.shape[-2], dtype=torch.float64)
        rates = oma_rates(channel, powers, clusters, radio.bandwidth_hz, radio.noise_w)
        missing = problem.qos_bps / torch.clamp(rates, min=1e-300)
        return rates.sum(-1), torch.log(torch.clamp(missing, min=1.0)).sum(-1)
    return _cluster_merit(problem, 1 / effective_gains(channel, budgets, clusters, radio.noise_w), budgets)


def _cluster_merit(problem: Problem, inverse_gains: Tensor, budgets: Tensor) -> tuple[Tensor, Tensor]:
    """`merit` of NOMA where clusters spend `budgets` [..., V] [W], for 1/e [..., K] [W].

    With t the SINR of QoS and users from weakest to strongest, QoS takes Σ_i t (1+t)^(i-1) / e_i of a cluster. What it
    has beyond that adds log2(1 + e_n ΔP / (1+t)^n) to its n rates of QoS: the sum of QoS-first powers.
    """
    ordered = _weakest_first(problem, inverse_gains)
    needed = _needed(problem, ordered)
    growth = (1 + problem.least_sinr) ** ordered.shape[-1]
    spare = budgets - needed
    met = spare >= 0
    bits = torch.log1p(torch.where(met, spare, 0.0) / (ordered[..., -1] * growth)) / math.log(2)
    sum_rate = (ordered.shape[-1] * problem.qos_bps + problem.radio.bandwidth_hz * bits).sum(-1)
    return sum_rate, torch.log(torch.where(met, 1.0, needed / budgets)).sum(-1)


def best_budgets(problem: Problem, channel: Tensor) -> tuple[Tensor, Tensor]:
    """What clusters best spend [..., V] [W], and its score [...]; see `scored`.

    One cluster after the other is tried with more and with less, first by all of P/V, then by halves of it; none
    goes below what its QoS takes.
    """
    radio, clusters, full = problem.radio, problem.clusters, problem.full_budgets
    budgets = full.expand(*channel.shape[:-2], 1, -1)
    scores = scored(*merit(problem, channel, full))[..., None]
    if radio.scheme == "oma" or len(clusters) == 1:
        return budgets[..., 0, :], scores[..., 0]
    # 1/e is affine in what the clusters spend; found are its constant and its slopes.
    moves = torch.cat([torch.zeros_like(full)[None], torch.diag(full), -torch.diag(full)])
    inverse = 1 / effective_gains(channel[..., None, :, :], moves[: len(full) + 1], clusters, radio.noise_w)
    constant, slope = inverse[..., :1, :], (inverse[..., 1:, :] - inverse[..., :1, :]) / full[:, None]
    for step in [1.0] * len(full) + [0.5**i for i in range(1, _HALVINGS + 1)]:
        trial = torch.clamp(budgets + step * moves, min=torch.zeros_like(full), max=full)
        needed = _needed(problem, _weakest_first(problem, constant + trial @ slope))
        trial = torch.minimum(torch.maximum(trial, needed * (1 + 1e-12)), full)
        scores = scored(*_cluster_merit(problem, constant + trial @ slope, trial))
        best = scores.argmax(-1, keepdim=True)
        budgets, scores = torch.take_along_dim(trial, best[..., None], -2), torch.take_along_dim(scores, best, -1)
    return budgets[..., 0, :], scores[..., 0]


def _qos_first(problem: Problem, channel: Tensor, budgets: Tensor) -> Tensor:
    """QoS-first powers [..., K] [W] where clusters spend `budgets` [..., V] [W]."""
    radio, clusters = problem.radio, problem.clusters
    inverse = 1 / effective_gains(channel, budgets, clusters, radio.noise_w)
    order = _decoded(problem, inverse).flatten(-2)
    powers = qos_first_split(1 / _weakest_first(problem, inverse), budgets, radio.bandwidth_hz, problem.qos_bps)
    return torch.take_along_dim(powers.flatten(-2), order.argsort(-1), -1)


def scored(sum_rate: Tensor, shortfall: Tensor) -> Tensor:
    """The sum rate where QoS is met, else minus the shortfall."""
    return torch.where(shortfall > 0, -shortfall, sum_rate)


def _decoded(problem: Problem, inverse_gains: Tensor) -> Tensor:
    """The decoding order [B, ..., V, K/V] for 1/e [B, ..., K]: that of the gains, or the problem's where it has one."""
    by_gain = resolve_order(1 / inverse_gains, problem.clusters)
    if problem.order is None:
        return by_gain
    slots, *shape = problem.order.shape
    given = problem.order.reshape(slots, *[1] * (inverse_gains.ndim - 2), *shape)
    return torch.where(given < 0, by_gain, given)


def _weakest_first(problem: Problem, inverse_gains: Tensor) -> Tensor:
    """1/e of the users [B, ..., K] by cluster, the first decoded first, [B, ..., V, K/V].

    In the order of the gains that is sorted; in another one a user counts with the weakest of those that decode it.
    """
    if problem.order is None:
        return arranged(inverse_gains, problem.clusters).sort(-1, descending=True).values
    order = _decoded(problem, inverse_gains)
    ordered = torch.take_along_dim(inverse_gains, order.flatten(-2), -1).unflatten(-1, order.shape[-2:])
    return ordered.flip(-1).cummax(-1).values.flip(-1)


def _needed(problem: Problem, ordered: Tensor) -> Tensor:
    """What QoS takes of each cluster [..., V] [W], for 1/e from `_weakest_first`."""
    growth = (1 + problem.least_sinr) ** torch.arange(ordered.shape[-1], dtype=torch.float64)
    return problem.least_sinr * (growth * ordered).sum(-1)
