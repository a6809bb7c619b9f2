"""The merit of a slot once more in torch, with gradients by autograd: what the compiled ascent is held against.

For an independent optimiser (pymanopt, in bench and tests) and for tests of the compiled gradients.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from mjris.config import Radio
from mjris.radio.beams import REGULAR, SINGULAR


class Problem(NamedTuple):
    """What powers are chosen for."""

    clusters: Tensor
    radio: Radio
    qos_bps: float

    @property
    def full_budgets(self) -> Tensor:
        """What clusters may spend: P/V each, [V] [W]."""
        return torch.full((len(self.clusters),), self.radio.tx_power_w / len(self.clusters), dtype=torch.float64)

    @property
    def least_sinr(self) -> float:
        """SINR that QoS takes in the whole band; a hair more, so that rounding never leaves a rate below it."""
        return math.expm1(math.log(2) * self.qos_bps / self.radio.bandwidth_hz) * (1 + 1e-9)


def merit(problem: Problem, channel: Tensor, budgets: Tensor) -> tuple[Tensor, Tensor]:
    """Sum rate [...] [bit/s] and how far users fall short of QoS [...], logarithmic, zero if met.

    Over channels [..., K, M] where clusters spend `budgets` [..., V] [W], QoS first; with OMA, which has no budgets,
    everybody has full power.
    """
    radio = problem.radio
    if radio.scheme == "oma":
        rates = oma_rates(problem, channel)
        missing = problem.qos_bps / torch.clamp(rates, min=1e-300)
        return rates.sum(-1), torch.log(torch.clamp(missing, min=1.0)).sum(-1)
    return cluster_merit(problem, 1 / effective_gains(channel, budgets, problem.clusters, radio.noise_w), budgets)


def cluster_merit(problem: Problem, inverse_gains: Tensor, budgets: Tensor) -> tuple[Tensor, Tensor]:
    """`merit` of NOMA where clusters spend `budgets` [..., V] [W], for 1/e [..., K] [W].

    With t the SINR of QoS and users from weakest to strongest, QoS takes Σ_i t (1+t)^(i-1) / e_i of a cluster. What it
    has beyond that adds log2(1 + e_n ΔP / (1+t)^n) to its n rates of QoS: the sum of QoS-first powers.
    """
    ordered = arranged(inverse_gains, problem.clusters).sort(-1, descending=True).values
    steps = (1 + problem.least_sinr) ** torch.arange(ordered.shape[-1], dtype=torch.float64)
    needed = problem.least_sinr * (steps * ordered).sum(-1)
    growth = (1 + problem.least_sinr) ** ordered.shape[-1]
    spare = budgets - needed
    met = spare >= 0
    bits = torch.log1p(torch.where(met, spare, 0.0) / (ordered[..., -1] * growth)) / math.log(2)
    sum_rate = (ordered.shape[-1] * problem.qos_bps + problem.radio.bandwidth_hz * bits).sum(-1)
    return sum_rate, torch.log(torch.where(met, 1.0, needed / budgets)).sum(-1)


def arranged(values: Tensor, clusters: Tensor) -> Tensor:
    """Values of the users [..., K] in the places of `clusters` [V, K/V]: [..., V, K/V]."""
    return values[..., clusters.flatten()].unflatten(-1, clusters.shape)


def effective_gains(channel: Tensor, budgets: Tensor, clusters: Tensor, noise_w: float) -> Tensor:
    """e_k = |h_k g_v|² / (inter-cluster interference + noise) of every user [..., K] [1/W], eq. (SINROMA).

    `budgets` [..., V] [W] is what each cluster spends.
    """
    received = (channel @ cluster_beams(channel, clusters)).abs() ** 2
    own = (clusters.flatten().argsort() // clusters.shape[1])[:, None] == torch.arange(len(clusters))
    interference = (torch.where(own, 0.0, received) * budgets[..., None, :]).sum(-1)
    return torch.where(own, received, 0.0).sum(-1) / (interference + noise_w)


def oma_rates(problem: Problem, channel: Tensor) -> Tensor:
    """Rates [..., K] [bit/s] with OMA where everybody has P/K."""
    radio, bands = problem.radio, problem.clusters.T
    power_w, (num_bands, size) = radio.tx_power_w / bands.numel(), bands.shape
    in_band = channel[..., bands.flatten(), :].unflatten(-2, bands.shape)
    received = (in_band @ zero_forcing(in_band)).abs() ** 2 * power_w
    own = torch.eye(size, dtype=torch.bool)
    interference = torch.where(own, 0.0, received).sum(-1)
    sinr = torch.where(own, received, 0.0).sum(-1) / (interference + radio.noise_w / num_bands)
    rates = radio.bandwidth_hz / num_bands / math.log(2) * torch.log1p(sinr)
    return rates.flatten(-2)[..., bands.flatten().argsort()]


def cluster_beams(channel: Tensor, clusters: Tensor) -> Tensor:
    """The beam of every cluster [..., M, V], zero-forced on its strongest user, eq. (ZFNOMA)."""
    strength = torch.linalg.vecdot(channel, channel).real
    strongest = arranged(strength, clusters).argmax(-1, keepdim=True)
    heads = torch.take_along_dim(clusters.expand(*strength.shape[:-1], *clusters.shape), strongest, -1)
    return zero_forcing(torch.take_along_dim(channel, heads, -2))


def zero_forcing(channel: Tensor) -> Tensor:
    """Unit-norm beams [..., M, S] of rows [..., S, M], eq. (ZF), regularised where these are dependent."""
    directions = _unit_rows(channel)
    conjugate = directions.conj()
    gram = conjugate @ directions.mT
    added = REGULAR * (_least_pivot(gram) < SINGULAR).to(torch.float64)
    gram = gram + added[..., None, None] * torch.eye(channel.shape[-2])
    return _unit_rows(torch.linalg.solve(gram, conjugate)).mT


def _least_pivot(gram: Tensor) -> Tensor:
    """The least pivot [...] of Hermitian matrices [..., S, S] of inner products of unit vectors: zero if dependent."""
    least = gram[..., 0, 0].real
    for i in range(gram.shape[-1] - 1):
        # A pivot of zero leaves nothing to eliminate, and is the least one already.
        pivot = torch.where(gram[..., i, i].abs() > 0, gram[..., i, i], 1.0)
        gram = gram - gram[..., :, i, None] * gram[..., None, i, :] / pivot[..., None, None]
        least = torch.minimum(least, gram[..., i + 1, i + 1].real)
    return least


def _unit_rows(matrix: Tensor) -> Tensor:
    """`matrix` [..., S, M] with its rows scaled to norm one."""
    return matrix / torch.sqrt(torch.linalg.vecdot(matrix, matrix).real)[..., None]
