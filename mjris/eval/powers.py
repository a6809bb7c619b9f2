"""The best powers of a slot for channels that are given: what clusters spend, and how their users share it."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mjris.config import Radio
from mjris.eval.gradients import Problem, cluster_merit, effective_gains, merit, qos_budgets, weakest_first
from mjris.radio.powers import qos_first_powers
from mjris.radio.serving import System

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_HALVINGS = 6
"""How finely the budgets of clusters are chosen: to P/V over two to the power of this."""


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
        needed = qos_budgets(problem, weakest_first(problem, constant + trial @ slope))
        trial = torch.minimum(torch.maximum(trial, needed * (1 + 1e-12)), full)
        scores = scored(*cluster_merit(problem, constant + trial @ slope, trial))
        best = scores.argmax(-1, keepdim=True)
        budgets, scores = torch.take_along_dim(trial, best[..., None], -2), torch.take_along_dim(scores, best, -1)
    return budgets[..., 0, :], scores[..., 0]


def _qos_first(problem: Problem, channel: Tensor, budgets: Tensor) -> Tensor:
    """QoS-first powers [B, K] [W] where clusters spend `budgets` [B, V] [W]."""
    system = System.of(problem.radio, problem.clusters.numpy(), problem.qos_bps)._replace(oma=False)
    order = None if problem.order is None else problem.order.numpy()
    return torch.as_tensor(qos_first_powers(system, channel.numpy(), budgets.numpy(), order))


def scored(sum_rate: Tensor, shortfall: Tensor) -> Tensor:
    """The sum rate where QoS is met, else minus the shortfall."""
    return torch.where(shortfall > 0, -shortfall, sum_rate)
