"""Reference optimum of a slot: the best phases and powers that a search from many starts finds."""

import itertools
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mjris.config import Radio
from mjris.radio.access import arranged, effective_gains, noma_rates, oma_rates, resolve_order
from mjris.radio.channel import Channels, effective_channel, ris_response
from mjris.radio.control import aligned_phases, qos_first_split

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.integer]

_BATCH = 4096
"""Phase vectors that climb together: many enough to hide the cost of a call, few enough for the cache."""
_MEMORY = 6
"""Steps that the quasi-Newton ascent remembers."""
_FIRST_STEP, _LONGEST_STEP = 0.3, 1.5
"""How far a phase moves in the first step, and at most in any other [rad]."""
_SHORTFALL_WEIGHT = 10.0
"""What a shortfall of one costs in the ascent [bit/s/Hz]: more than what rates could gain by it."""
_CLIMB_MARGIN = 1e-4
"""The ascent aims this much above QoS, relatively, so that it ends inside where QoS bounds it."""
_MOST_CHOICES = 16
"""Choices of one user from each cluster that are tried as starts."""
_HALVINGS = 12
"""How finely the budgets of clusters are chosen: to P/V over two to the power of this."""


@dataclass(frozen=True)
class Optimum:
    """The best known solution of every slot."""

    phases_rad: FloatArray
    """[..., N] [rad]"""
    powers_w: FloatArray
    """[..., K] [W]"""
    rates_bps: FloatArray
    """[..., K] [bit/s]"""


class _Problem(NamedTuple):
    """What powers are chosen for."""

    clusters: Tensor
    radio: Radio
    qos_bps: float

    @property
    def least_sinr(self) -> float:
        """SINR that QoS takes in the whole band; a hair more, so that rounding never leaves a rate below it."""
        return math.expm1(math.log(2) * self.qos_bps / self.radio.bandwidth_hz) * (1 + 1e-9)


def best_known(
    channels: Channels,
    clusters: IntArray,
    radio: Radio,
    qos_bps: float,
    rng: np.random.Generator,
    *,
    random_starts: int = 4,
    screening_steps: int = 4,
    finalists: int = 4,
    final_steps: int = 20,
) -> Optimum:
    """The highest sum rate known for every slot, over all phases and all powers that `radio.scheme` allows.

    `channels` have the leading axes [...] of the slots, `clusters` are int [V, K/V]. A solution in which every user
    has `qos_bps` beats one in which somebody has not; among equals the sum rate decides. Users are decoded in the
    order of the slot's gains ("dynamic"), whatever `radio.decoding_order` says. This is the best of a search, not a
    proven optimum; `mjris.eval.bound` has what nothing can exceed.

    The search starts from phases aligned to each user, to all users, and to one user of each cluster with and against
    the others, and from `random_starts` random ones. All of them climb `screening_steps`, and the best `finalists`
    another `final_steps`, by quasi-Newton ascent on the phases with QoS-first powers.
    """
    batch = channels.direct.shape[:-2]
    loaded = channels._replace(reflected=radio.element_amplitude * channels.reflected)
    links = Channels(*(torch.as_tensor(link).reshape(-1, *link.shape[-2:]) for link in loaded))
    problem = _Problem(torch.as_tensor(clusters), radio, qos_bps)
    phases = torch.zeros(links.incident.shape[:-1], dtype=torch.float64)
    unserved = torch.arange(len(phases))
    # Where QoS is out of reach for somebody, the sum rate alone decides.
    for target in (problem, problem._replace(qos_bps=0.0)):
        for slots in filter(len, torch.split(unserved, _BATCH // 16)):
            some = Channels(*(link[slots] for link in links))
            random = torch.as_tensor(rng.uniform(-np.pi, np.pi, (len(slots), random_starts, phases.shape[-1])))
            tried = torch.cat([_aligned_starts(some, target.clusters, rng), random], 1)
            tried = _leaders(target, some, _climb(target, some, tried, screening_steps), finalists)
            phases[slots] = _leaders(target, some, _climb(target, some, tried, final_steps), 1)[:, 0]
        met = _best_budgets(target, _effective(links, phases), _HALVINGS)[1] >= 0
        unserved = torch.nonzero(~met)[:, 0]
    effective = _effective(links, phases).numpy()
    powers = best_powers(effective, clusters, radio, qos_bps)
    rates = (oma_rates if radio.scheme == "oma" else noma_rates)(
        effective, powers, clusters, radio.bandwidth_hz, radio.noise_w
    )
    return Optimum(*(values.reshape(*batch, -1) for values in (phases.numpy(), powers, rates)))


def best_powers(effective: ComplexArray, clusters: IntArray, radio: Radio, qos_bps: float) -> FloatArray:
    """The powers [..., K] [W] with the highest sum rate known for effective channels [..., K, M].

    "oma": zero forcing leaves no interference, so that everybody best has P/K. "noma": for what a cluster spends,
    QoS-first is optimal in it. Clusters disturb each other's weaker users, so that it can pay to spend less: here each
    spends either all of P/V or just what its QoS takes. Where QoS is out of reach for somebody, it is given up for
    all, and the power goes to where it gives the highest sum rate.
    """
    if radio.scheme == "oma":
        return np.full(effective.shape[:-1], radio.tx_power_w / effective.shape[-2])
    channel = torch.as_tensor(effective)
    problem = _Problem(torch.as_tensor(clusters), radio, qos_bps)
    without_qos = problem._replace(qos_bps=0.0)
    budgets, score = _best_budgets(problem, channel, _HALVINGS)
    served = _qos_first(problem, channel, budgets)
    unserved = _qos_first(without_qos, channel, _best_budgets(without_qos, channel, _HALVINGS)[0])
    return torch.where((score >= 0)[..., None], served, unserved).numpy()


def _aligned_starts(channels: Channels, clusters: Tensor, rng: np.random.Generator) -> Tensor:
    """Phases [B, S, N] aligned for various weights of the users."""
    num_clusters, size = clusters.shape
    num_users = num_clusters * size
    choices = np.array(list(itertools.islice(itertools.product(range(size), repeat=num_clusters), _MOST_CHOICES + 1)))
    if len(choices) > _MOST_CHOICES:
        choices = rng.integers(size, size=(_MOST_CHOICES, num_clusters))
    users = torch.arange(num_users)
    heads = torch.take_along_dim(clusters[None], torch.as_tensor(choices)[..., None], -1)
    chosen = (heads == users).sum(-2).to(torch.float64)
    weights = torch.cat([torch.eye(num_users), torch.ones(1, num_users), chosen]).to(torch.float64)
    # The beam of a cluster follows its strongest user. Others become that where the present one is pushed down.
    against = 2 * chosen - 1
    return torch.cat(
        [
            aligned_phases(_repeated(channels, len(weights)), weights),
            aligned_phases(_repeated(channels, len(against)), against, iterations=0),
        ],
        1,
    )


def _climb(problem: _Problem, channels: Channels, phases: Tensor, steps: int) -> Tensor:
    """Limited-memory BFGS ascent of many phase vectors [B, S, N] at once; every one has a step length of its own.

    A step that does not gain enough is not taken, and a quarter of it is tried next.
    """
    channels = _repeated(channels, phases.shape[1])
    aimed = problem._replace(qos_bps=problem.qos_bps * (1 + _CLIMB_MARGIN))

    def evaluate(phases: Tensor) -> tuple[Tensor, Tensor]:
        phases = phases.detach().requires_grad_()
        sum_rate, shortfall = _merit(aimed, _effective(channels, phases))
        value = sum_rate / problem.radio.bandwidth_hz - _SHORTFALL_WEIGHT * shortfall
        return value.detach(), torch.autograd.grad(value.sum(), phases)[0]

    value, gradient = evaluate(phases)
    # Inverse curvature along the last step; at first, such that the steepest phase moves by _FIRST_STEP.
    scale = _FIRST_STEP / _nonzero(gradient.abs().amax(-1, keepdim=True))
    direction = scale * gradient
    length = torch.ones_like(value)[..., None]
    memory: deque[tuple[Tensor, Tensor, Tensor]] = deque(maxlen=_MEMORY)
    for _ in range(steps):
        step = length * direction
        new_value, new_gradient = evaluate(phases + step)
        taken = (new_value > value + 1e-4 * _dot(gradient, step)[..., 0])[..., None]
        bend = gradient - new_gradient
        curvature = _dot(step, bend)
        curved = taken & (curvature > 1e-12 * torch.sqrt(_dot(step, step) * _dot(bend, bend)))
        memory.append((step, bend, torch.where(curved, 1 / _nonzero(curvature), 0.0)))
        scale = torch.where(curved, curvature / _nonzero(_dot(bend, bend)), scale)
        phases = torch.where(taken, phases + step, phases)
        value = torch.where(taken[..., 0], new_value, value)
        gradient = torch.where(taken, new_gradient, gradient)
        direction = _quasi_newton(gradient, scale, memory)
        length = torch.where(taken, 1.0, 0.25 * length)
    return phases


def _quasi_newton(gradient: Tensor, scale: Tensor, memory: deque[tuple[Tensor, Tensor, Tensor]]) -> Tensor:
    """Inverse curvature times gradient by the two-loop recursion, no longer than `_LONGEST_STEP` in any phase."""
    direction, parts = gradient, []
    for step, bend, inverse in reversed(memory):
        part = inverse * _dot(step, direction)
        direction = direction - part * bend
        parts.append(part)
    direction = scale * direction
    for (step, bend, inverse), part in zip(memory, reversed(parts), strict=True):
        direction = direction + (part - inverse * _dot(bend, direction)) * step
    return direction * torch.clamp(_LONGEST_STEP / _nonzero(direction.abs().amax(-1, keepdim=True)), max=1.0)


def _leaders(problem: _Problem, channels: Channels, phases: Tensor, count: int) -> Tensor:
    """The `count` best [B, count, N] of `phases` [B, S, N]."""
    scores = _best_budgets(problem, _effective(_repeated(channels, phases.shape[1]), phases), 0)[1]
    best = torch.topk(scores, min(count, phases.shape[1]), dim=1).indices
    return torch.take_along_dim(phases, best[..., None], 1)


def _merit(problem: _Problem, channel: Tensor) -> tuple[Tensor, Tensor]:
    """Sum rate [...] [bit/s] at full power, and how far users fall short of QoS [...], logarithmic; zero if met."""
    radio, clusters = problem.radio, problem.clusters
    if radio.scheme == "oma":
        powers = channel.new_full(channel.shape[:-1], radio.tx_power_w / channel.shape[-2], dtype=torch.float64)
        rates = oma_rates(channel, powers, clusters, radio.bandwidth_hz, radio.noise_w)
        missing = problem.qos_bps / torch.clamp(rates, min=1e-300)
        return rates.sum(-1), torch.log(torch.clamp(missing, min=1.0)).sum(-1)
    budgets = torch.full((len(clusters),), radio.tx_power_w / len(clusters), dtype=torch.float64)
    return _cluster_merit(problem, 1 / effective_gains(channel, budgets, clusters, radio.noise_w), budgets)


def _cluster_merit(problem: _Problem, inverse_gains: Tensor, budgets: Tensor) -> tuple[Tensor, Tensor]:
    """`_merit` of NOMA where clusters spend `budgets` [..., V] [W], for 1/e [..., K] [W].

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


def _best_budgets(problem: _Problem, channel: Tensor, halvings: int) -> tuple[Tensor, Tensor]:
    """What clusters best spend [..., V] [W], and its score [...]; see `_score`.

    One cluster after the other is tried with more and with less, first by all of P/V, then by halves of it; none
    goes below what its QoS takes.
    """
    radio, clusters = problem.radio, problem.clusters
    num_clusters = len(clusters)
    full = radio.tx_power_w / num_clusters
    if radio.scheme == "oma":
        return channel.new_full((*channel.shape[:-2], num_clusters), full), _score(*_merit(problem, channel))
    # 1/e is affine in what the clusters spend; found are its constant and its slopes.
    one = torch.eye(num_clusters, dtype=torch.float64)
    probes = full * torch.cat([torch.zeros_like(one[:1]), one])
    inverse = 1 / effective_gains(channel[..., None, :, :], probes, clusters, radio.noise_w)
    constant, slope = inverse[..., :1, :], (inverse[..., 1:, :] - inverse[..., :1, :]) / full
    moves = torch.cat([torch.zeros_like(one[:1]), one, -one])
    budgets = torch.full((*channel.shape[:-2], 1, num_clusters), full, dtype=torch.float64)
    for step in [full] * (num_clusters - 1) + [full / 2**i for i in range(halvings + 1)]:
        trial = budgets + step * moves
        needed = _needed(problem, _weakest_first(problem, constant + trial.clamp(0, full) @ slope))
        trial = torch.minimum(torch.maximum(trial, needed * (1 + 1e-12)), needed.new_tensor(full))
        scores = _score(*_cluster_merit(problem, constant + trial @ slope, trial))
        best = scores.argmax(-1, keepdim=True)
        budgets = torch.take_along_dim(trial, best[..., None], -2)
    return budgets[..., 0, :], torch.take_along_dim(scores, best, -1)[..., 0]


def _qos_first(problem: _Problem, channel: Tensor, budgets: Tensor) -> Tensor:
    """QoS-first powers [..., K] [W] where clusters spend `budgets` [..., V] [W]."""
    radio, clusters = problem.radio, problem.clusters
    gains = effective_gains(channel, budgets, clusters, radio.noise_w)
    order = resolve_order(gains, clusters).flatten(-2)
    ordered = torch.take_along_dim(gains, order, -1).unflatten(-1, clusters.shape)
    powers = qos_first_split(ordered, budgets, radio.bandwidth_hz, problem.qos_bps)
    return torch.take_along_dim(powers.flatten(-2), order.argsort(-1), -1)


def _score(sum_rate: Tensor, shortfall: Tensor) -> Tensor:
    """The sum rate where QoS is met, else minus the shortfall."""
    return torch.where(shortfall > 0, -shortfall, sum_rate)


def _weakest_first(problem: _Problem, inverse_gains: Tensor) -> Tensor:
    """1/e of the users [..., K] sorted by cluster, the weakest first: [..., V, K/V]."""
    return arranged(inverse_gains, problem.clusters).sort(-1, descending=True).values


def _needed(problem: _Problem, ordered: Tensor) -> Tensor:
    """What QoS takes of each cluster [..., V] [W], for 1/e from `_weakest_first`."""
    growth = (1 + problem.least_sinr) ** torch.arange(ordered.shape[-1], dtype=torch.float64)
    return problem.least_sinr * (growth * ordered).sum(-1)


def _effective(channels: Channels, phases: Tensor) -> Tensor:
    """Effective channels [..., K, M] for phases [..., N]."""
    return effective_channel(channels, ris_response(phases, torch.ones(())))


def _repeated(channels: Channels, count: int) -> Channels:
    """Channels [B, ...] of slots as [B, count, ...], without a copy."""
    return Channels(*(link[:, None].expand(-1, count, -1, -1) for link in channels))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def _nonzero(values: Tensor) -> Tensor:
    """`values`, or one where they are zero."""
    return torch.where(values == 0, 1.0, values)
