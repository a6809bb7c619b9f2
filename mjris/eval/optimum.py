"""Reference optimum of a slot: the best phases and powers that a search from many starts finds."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mjris.config import Radio
from mjris.eval.gradients import Problem, arranged, coefficients, merit
from mjris.eval.powers import best_budgets, best_powers, given_orders, scored
from mjris.radio import serving
from mjris.radio.closed_forms import aligned_phases
from mjris.radio.links import Channels
from mjris.radio.surface import Surface, cascade, effective_channel, flattened

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_SLOTS = 128
"""Slots that are searched together: enough to hide the cost of a call, few enough for the cache."""
_MEMORY = 6
"""Steps that the quasi-Newton ascent remembers."""
_FIRST_STEP, _LONGEST_STEP = 0.3, 1.5
"""How far a phase moves in the first step, and at most in any other [rad]."""
_SHORTFALL_WEIGHT = 10.0
"""What a shortfall of one costs in the ascent [bit/s/Hz]: more than what rates could gain by it."""
_BARRIER, _LAST_BARRIER = 1e-2, 1e-4
"""What keeps the ascent from cliffs, and in the last steps [bit/s/Hz]."""
_CLIMB_MARGIN = 1e-4
"""The ascent aims this much above QoS, relatively, so that it ends inside where QoS bounds it."""
_SWEEPS = 2
"""How often every element is asked again which of few phases is the best."""
_MOST_CHOICES = 16
"""Choices of one user from each cluster that are tried as starts."""


@dataclass(frozen=True)
class Optimum:
    """The best known solution of every slot."""

    phases_rad: FloatArray
    """[..., N] [rad]"""
    powers_w: FloatArray
    """[..., K] [W]"""
    rates_bps: FloatArray
    """[..., K] [bit/s]"""


class _Paths(NamedTuple):
    """Torch channels of B slots in which the phases [B, S, N] of many starts are tried at once."""

    direct: Tensor
    """[B, 1, K M]"""
    cascade: Tensor
    """Before the elements' coefficients [B, N, K M]."""
    surface: Surface
    shape: tuple[int, int]
    """K, M"""

    @staticmethod
    def of(surface: Surface, channels: Channels) -> "_Paths":
        """The paths of channels whose only leading axis is that of the slots."""
        return _Paths(
            torch.as_tensor(channels.direct).flatten(-2)[:, None],
            torch.as_tensor(cascade(channels)).flatten(-2),
            surface,
            (channels.direct.shape[-2], channels.direct.shape[-1]),
        )

    def effective(self, phases: Tensor) -> Tensor:
        """Effective channels [B, S, K, M] if elements take any phase, with one product for all starts of a slot."""
        return (self.direct + coefficients(self.surface, phases) @ self.cascade).unflatten(-1, self.shape)


def best_known(
    channels: Channels,
    clusters: IntArray,
    radio: Radio,
    qos_bps: float,
    rng: np.random.Generator,
    order: IntArray | None = None,
    *,
    random_starts: int = 2,
    screening_steps: int = 6,
    finalists: int = 6,
    final_steps: int = 20,
) -> Optimum:
    """The highest sum rate known for every slot, over all phases and all powers that `radio.scheme` allows.

    `channels` have the leading axes [...] of the slots, `clusters` are int [V, K/V]. A solution in which every user
    has `qos_bps` beats one in which somebody has not; among equals the sum rate decides. Users are decoded in a given
    `order` [..., V, K/V] or, where that is None or negative, in that of the slot's gains. This is the best of a search,
    not a proven optimum; `mjris.eval.bound` has what nothing can exceed.

    The search starts from phases aligned to each user, to all users, and for and against one user of each cluster, and
    from `random_starts` random ones. All climb `screening_steps`, the best `finalists` another `final_steps`, and the
    best of these half of that, by quasi-Newton ascent on the phases with QoS-first powers. Elements that can take few
    phases only take the nearest ones then, and after that, each in turn, the best one.
    """
    batch = channels.direct.shape[:-2]
    surface, links = Surface.of(radio), flattened(channels)
    phases = torch.zeros(links.incident.shape[:-1], dtype=torch.float64)

    def search(problem: Problem, slots: Tensor) -> Tensor:
        """Set the phases of `slots`, and return whether they meet QoS."""
        if problem.order is not None:
            problem = problem._replace(order=problem.order[slots])
        some = Channels(*(link[slots.numpy()] for link in links))
        paths = _Paths.of(surface, some)
        random = torch.as_tensor(rng.uniform(-np.pi, np.pi, (len(slots), random_starts, phases.shape[-1])))
        tried = torch.cat([_informed_starts(surface, some, problem.clusters.numpy(), rng), random], 1)
        budgets = problem.full_budgets
        for steps, barrier, kept in (
            (screening_steps, _BARRIER, finalists),
            (final_steps, _BARRIER, 1),
            (final_steps // 2, _LAST_BARRIER, 1),
        ):
            tried = _climb(problem, paths, tried, budgets, steps, barrier)
            tried = _leaders(tried, scored(*merit(problem, paths.effective(tried), budgets)), kept)
            budgets, score = best_budgets(problem, paths.effective(tried))
        if surface.step_rad > 0:
            tried = _taken(problem, paths, tried[:, 0], budgets)[:, None]
            budgets, score = best_budgets(problem, paths.effective(tried))
        phases[slots] = tried[:, 0]
        return score[:, 0] >= 0

    flat = given_orders(order, clusters)
    problem = Problem(torch.as_tensor(clusters), radio, qos_bps, flat)
    met = torch.zeros(len(phases), dtype=torch.bool)
    possible = torch.as_tensor(_may_meet_qos(problem, surface.amplitude, links))
    for slots in filter(len, torch.nonzero(possible)[:, 0].split(_SLOTS)):
        met[slots] = search(problem, slots)
    # Where QoS is out of reach for somebody, the sum rate alone decides.
    for slots in filter(len, torch.nonzero(~met)[:, 0].split(_SLOTS)):
        search(problem.without_qos, slots)
    effective = effective_channel(surface, links, phases.numpy())
    given = None if flat is None else flat.numpy()
    powers = best_powers(effective, clusters, radio, qos_bps, given)
    rates = serving.rates(serving.System.of(radio, clusters, qos_bps), effective, powers, given)
    return Optimum(*(values.reshape(*batch, -1) for values in (phases.numpy(), powers, rates)))


def _may_meet_qos(problem: Problem, amplitude: float, links: Channels) -> NDArray[np.bool_]:
    """Whether every user has QoS [B] where it alone has all of the cluster's power and all paths add up in phase."""
    radio = problem.radio
    paths = amplitude * abs(cascade(links)).sum(-3)
    most = ((abs(links.direct) + paths) ** 2).sum(-1)
    snr = radio.tx_power_w / (len(problem.clusters) * radio.noise_w) * most
    bands = problem.clusters.shape[1] if radio.scheme == "oma" else 1
    return (radio.bandwidth_hz / bands * np.log1p(snr) / math.log(2) >= problem.qos_bps).all(-1)


def _informed_starts(surface: Surface, links: Channels, clusters: IntArray, rng: np.random.Generator) -> Tensor:
    """Phases [B, S, N] aligned to each user, to all, and for and against one user of each cluster."""
    num_clusters, size = clusters.shape
    users = np.eye(clusters.size)
    if size**num_clusters <= _MOST_CHOICES:
        places = np.stack(np.meshgrid(*[np.arange(size)] * num_clusters, indexing="ij"), -1).reshape(-1, num_clusters)
    else:
        places = rng.integers(size, size=(_MOST_CHOICES, num_clusters))
    chosen = users[clusters[np.arange(num_clusters), places]].sum(-2)
    # A cluster's beam follows its strongest user: which one that is, the phases choose by pushing others down.
    strength = (abs(links.direct) ** 2).sum(-1)[:, None]
    against = (2 * chosen - 1) / np.where(strength == 0, 1.0, strength)
    weights = np.concatenate(np.broadcast_arrays(2 * chosen - 1, against, chosen - 1), 1)
    toward = np.concatenate([users, users.sum(0, keepdims=True)])
    return torch.as_tensor(
        np.concatenate(
            [
                aligned_phases(surface, _repeated(links, len(toward)), toward),
                aligned_phases(surface, _repeated(links, weights.shape[1]), weights, iterations=0),
            ],
            1,
        )
    )


def _climb(problem: Problem, paths: _Paths, phases: Tensor, budgets: Tensor, steps: int, barrier: float) -> Tensor:
    """Limited-memory BFGS ascent of many phase vectors [B, S, N] at once; every one has a step length of its own.

    A step that does not gain enough is not taken, and a quarter of it is tried next. The merit jumps where another user
    of a cluster becomes the strongest one; a `barrier` [bit/s/Hz] before those cliffs lets the ascent go along them,
    where it would get stuck. Steps may still cross.
    """
    aimed = problem._replace(qos_bps=problem.qos_bps * (1 + _CLIMB_MARGIN))

    def evaluate(phases: Tensor) -> tuple[Tensor, Tensor]:
        phases = phases.detach().requires_grad_()
        channel = paths.effective(phases)
        sum_rate, shortfall = merit(aimed, channel, budgets)
        value = sum_rate / problem.radio.bandwidth_hz - _SHORTFALL_WEIGHT * shortfall
        value = value + barrier * _lead(aimed, channel)
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


def _taken(problem: Problem, paths: _Paths, phases: Tensor, budgets: Tensor) -> Tensor:
    """The phases that elements can take nearest to `phases` [B, N], and after that each in turn the best of them."""
    step = paths.surface.step_rad
    levels = step * torch.arange(round(2 * math.pi / step), dtype=torch.float64)
    choices = coefficients(paths.surface, levels)[None, :, None]
    phases = step * torch.floor(phases / step + 0.5)
    channel = paths.effective(phases[:, None])[:, 0].flatten(-2)
    for n in [*range(phases.shape[1])] * _SWEEPS:
        path = paths.cascade[:, n]
        without = channel - coefficients(paths.surface, phases[:, n, None]) * path
        tried = without[:, None] + choices * path[:, None]
        best = scored(*merit(problem, tried.unflatten(-1, paths.shape), budgets)).argmax(1)
        channel, phases[:, n] = tried[torch.arange(len(tried)), best], levels[best]
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


def _leaders(phases: Tensor, scores: Tensor, count: int) -> Tensor:
    """The `count` of `phases` [B, S, N] with the best `scores` [B, S]: [B, count, N]."""
    best = torch.topk(scores, min(count, phases.shape[1]), dim=1).indices
    return torch.take_along_dim(phases, best[..., None], 1)


def _lead(problem: Problem, channel: Tensor) -> Tensor:
    """How clearly one user is the strongest of its cluster [...]: Σ_v ln(1 - ‖h_second‖²/‖h_first‖²)."""
    if problem.radio.scheme == "oma" or problem.clusters.shape[1] == 1:
        return channel.new_zeros((), dtype=torch.float64)
    strength = arranged(torch.linalg.vecdot(channel, channel).real, problem.clusters).topk(2, -1).values
    return torch.log1p(-torch.clamp(strength[..., 1] / strength[..., 0], max=1 - 1e-9)).sum(-1)


def _repeated(channels: Channels, count: int) -> Channels:
    """Channels [B, ...] of slots as [B, count, ...]."""
    return Channels(*(np.broadcast_to(link[:, None], (len(link), count, *link.shape[1:])) for link in channels))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def _nonzero(values: Tensor) -> Tensor:
    """`values`, or one where they are zero."""
    return torch.where(values == 0, 1.0, values)
