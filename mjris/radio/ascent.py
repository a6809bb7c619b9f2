"""Phases that serve users: quasi-Newton ascent on the merit of a slot, from several starts."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.beams import cluster_beams, strength
from mjris.radio.budgets import best_budgets, equal_budgets
from mjris.radio.climbing import Slot, climb, turned
from mjris.radio.closed_forms import align, best_alignment, unturned, write_phases
from mjris.radio.decoding import ascending
from mjris.radio.links import Channels
from mjris.radio.merit import amplitudes, least_sinr, powers_of, slot_score
from mjris.radio.serving import System
from mjris.radio.surface import Surface, coefficient, effective, flattened, parts

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_BARRIER, _LAST_BARRIER = 1e-2, 1e-4
"""What keeps the ascent from cliffs, and in the last steps [bit/s/Hz]."""
_ALIGNMENTS = 3
"""Iterations of starts that are aligned to users."""
_FAR = 4
"""How many of few phases up and down are tried."""


class Effort(NamedTuple):
    """How hard is searched for the phases of a slot."""

    choices: int
    """Choices of one user from each cluster that are tried as starts, at most."""
    variants: int
    """Ways to align to a choice: 1 to 3; with 3 also to every user and to all."""
    screening: int
    """Steps from every start."""
    finalists: int
    """Starts that climb on."""
    steps: int
    """Steps of these, and half as many nearer to the cliffs."""
    sweeps: int
    """How often every element is asked again which of few phases is the best."""

    @classmethod
    def of(cls, steps: int) -> "Effort":
        """That of a task with so many steps."""
        return cls(choices=4, variants=1, screening=(steps + 2) // 3, finalists=1, steps=steps, sweeps=1)


def ascended_phases(
    system: System,
    surface: Surface,
    known: Channels,
    effort: Effort,
    weights: FloatArray | None = None,
    order: IntArray | None = None,
    random: FloatArray | None = None,
) -> FloatArray:
    """Phases [E, N] [rad] for the highest sum rate with QoS, under the best budgets of clusters and QoS-first powers.

    In a decoding `order` [E, V, K/V], or that of the gains. `weights` [E, K] > 0 are what a bit of a user is worth that
    it has beyond QoS, None for one. Starts are the closed form's, those for one user of each cluster and against the
    others, and `random` ones [E, R, N] [rad]. All climb by quasi-Newton ascent; elements that can take few phases then
    take the nearest ones, and after that, each in turn, the best one. Where QoS is not found for all, the sum rate
    alone counts. The result is never worse than `qos_aligned_phases` under the same powers.
    """
    cells, elements = known.incident.shape[:2]
    weights = np.ones(known.direct.shape[:-1]) if weights is None else np.ascontiguousarray(weights)
    order = system.no_order(cells) if order is None else order
    random = np.empty((cells, 0, elements)) if random is None else random
    return _ascend_all(system, surface, surface.unstepped, *flattened(known), weights, order, random, effort)


@compiled
def _ascend_all(
    system: System,
    surface: Surface,
    unstepped: Surface,
    direct: ComplexArray,
    incident: ComplexArray,
    reflected: ComplexArray,
    weights: FloatArray,
    order: IntArray,
    random: FloatArray,
    effort: Effort,
) -> FloatArray:
    phases = np.empty(incident.shape[:2])
    # Where QoS is out of reach for somebody, the sum rate alone decides, and no order matters.
    alone = System(
        system.clusters,
        system.oma and not system.selects,
        system.tx_power_w,
        system.bandwidth_hz,
        system.noise_w,
        0.0,
        system.selects,
        system.shares_power,
    )
    # There is less to win then, and less to miss.
    choices = min(effort.choices, effort.finalists)
    fewer = Effort(choices, effort.variants, effort.screening, effort.finalists, effort.steps, effort.sweeps)
    no_order = system.clusters * 0 - 1
    for cell in range(len(phases)):
        over = parts(incident[cell], reflected[cell])
        decoded = order[cell] if system.qos_bps > 0 else no_order
        slot = Slot(system, unstepped, direct[cell], over, weights[cell], decoded)
        aligned = np.empty(incident.shape[1])
        write_phases(best_alignment(system, surface, direct[cell], over, weights[cell], order[cell]), aligned)
        if surface.step_rad > 0:
            _snap(surface.step_rad, aligned)
        met = -1.0
        if system.qos_bps == 0 or _may_meet_qos(slot):
            met, phases[cell] = _searched(slot, surface, aligned, random[cell], effort)
        if met < 0:
            slot = Slot(alone, unstepped, direct[cell], over, weights[cell], no_order)
            _, phases[cell] = _searched(slot, surface, aligned, random[cell], fewer)
    return phases


@compiled
def _searched(
    slot: Slot, surface: Surface, aligned: FloatArray, random: FloatArray, effort: Effort
) -> tuple[float, FloatArray]:
    """The best phases [N] found from all starts, and their score under the best budgets."""
    starts = _starts(slot, random, effort)
    full = equal_budgets(slot.system)
    reached = np.empty(len(starts))
    for start in range(len(starts)):
        reached[start] = climb(slot, starts[start], full, _BARRIER, effort.screening)
    best = _settled_score(slot, surface, aligned)
    found, budgets = aligned.copy(), full.copy()
    leading = np.argsort(-reached)
    for start in leading[: effort.finalists]:
        phases = starts[start]
        _spend_best(slot, phases, budgets)
        climb(slot, phases, budgets, _BARRIER, effort.steps)
        _spend_best(slot, phases, budgets)
        climb(slot, phases, budgets, _LAST_BARRIER, effort.steps // 2)
        if surface.step_rad > 0:
            _settle(slot, surface, phases, budgets, effort.sweeps)
        score = _settled_score(slot, surface, phases)
        if score > best:
            best = score
            found[:] = phases
    return best, found


@compiled
def _may_meet_qos(slot: Slot) -> bool:
    """Whether every user has QoS where it has a cluster's power and all paths add up in phase."""
    system, over = slot.system, slot.over
    bands = system.clusters.shape[1] if system.oma else 1
    # With OMA a band has its share of a cluster's power, and of the noise.
    shares = 1 if system.shares_power and not system.oma else len(system.clusters)
    snr = system.tx_power_w / shares / system.noise_w
    for k in range(len(slot.direct)):
        gain = 0.0
        for m in range(slot.direct.shape[1]):
            most = abs(slot.direct[k, m])
            for n in range(over.incident.shape[2]):
                paths = (over.incident[0, m, n] ** 2 + over.incident[1, m, n] ** 2) * (
                    over.reflected[0, k, n] ** 2 + over.reflected[1, k, n] ** 2
                )
                most += slot.surface.amplitude * math.sqrt(paths)
            gain += most * most
        if system.bandwidth_hz / bands * math.log1p(snr * gain) / math.log(2) < system.qos_bps:
            return False
    return True


@compiled
def _starts(slot: Slot, random: FloatArray, effort: Effort) -> FloatArray:
    """Phases [S, N] for one user of each cluster and against the others, to every user and to all, and `random` ones.

    A cluster's beam follows its strongest user: which one that is, the phases choose by pushing others down.
    """
    users, elements = slot.over.reflected.shape[1:]
    num_clusters, size = slot.system.clusters.shape
    ways = size**num_clusters
    choices = min(ways, effort.choices)
    aligned = users + 1 if effort.variants > 2 else 0
    made = np.empty((choices * effort.variants + aligned + len(random), elements))
    powers, toward = np.empty(users), np.empty(users)
    for k in range(users):
        powers[k] = strength(slot.direct, k)
    by_power = ascending(slot.system.clusters, powers)
    conjugate, at = slot.direct.conj(), 0
    for choice in range(choices):
        for variant in range(effort.variants):
            chosen = choice * ways // choices
            for v in range(num_clusters):
                for place in range(size):
                    user = by_power[v, place]
                    liked = place == size - 1 - chosen % size
                    weight = slot.weights[user] if liked else -1 / slot.weights[user]
                    power = powers[user] if powers[user] > 0 else 1.0
                    toward[user] = weight / power if variant == 0 else weight if variant == 1 else min(weight, 0.0)
                chosen //= size
            turns = unturned(elements)
            align(slot.over, conjugate, toward, turns)
            write_phases(turns, made[at])
            at += 1
    for user in range(aligned):
        for k in range(users):
            toward[k] = 1.0 if user in (k, users) else 0.0
        turns = unturned(elements)
        align(slot.over, conjugate, toward, turns)
        for _ in range(_ALIGNMENTS):
            align(slot.over, effective(slot.surface, slot.direct, slot.over, turns).conj(), toward, turns)
        write_phases(turns, made[at])
        at += 1
    made[at:] = random
    return made


@compiled
def _spend_best(slot: Slot, phases: FloatArray, budgets: FloatArray) -> None:
    """Write the best `budgets` [V] [W] known for these phases."""
    if not slot.system.oma:
        channel = effective(slot.surface, slot.direct, slot.over, turned(phases))
        _budgets_over(slot, channel, budgets)


@compiled
def _budgets_over(slot: Slot, channel: ComplexArray, budgets: FloatArray) -> float:
    """The same for an effective channel [K, M], and their score."""
    received = powers_of(amplitudes(slot.system, channel, cluster_beams(channel, slot.system.clusters)))
    return best_budgets(slot.system, least_sinr(slot.system), received, slot.weights, slot.order, budgets)


@compiled
def _settled_score(slot: Slot, surface: Surface, phases: FloatArray) -> float:
    """The score of phases [N] on the very surface, under the best budgets."""
    budgets = equal_budgets(slot.system)
    channel = effective(surface, slot.direct, slot.over, turned(phases))
    if slot.system.oma:
        return slot_score(slot.system, channel, budgets, slot.weights, slot.order)
    return _budgets_over(slot, channel, budgets)


@compiled
def _snap(step_rad: float, phases: FloatArray) -> None:
    """Set `phases` [N] to the nearest multiples of a step."""
    for n in range(len(phases)):
        phases[n] = step_rad * math.floor(phases[n] / step_rad + 0.5)


@compiled
def _settle(slot: Slot, surface: Surface, phases: FloatArray, budgets: FloatArray, sweeps: int) -> None:
    """Set `phases` [N] to the nearest ones that there are, and after that each in turn to the best one."""
    step, over = surface.step_rad, slot.over
    users, antennas = slot.direct.shape
    count = round(2 * math.pi / step)
    tried = np.empty_like(slot.direct)
    _snap(step, phases)
    channel = effective(surface, slot.direct, over, turned(phases))
    best = slot_score(slot.system, channel, budgets, slot.weights, slot.order)
    for _ in range(sweeps):
        for n in range(len(phases)):
            before = phases[n]
            through = coefficient(surface, complex(math.cos(before), math.sin(before)))
            for offset in range(-min(_FAR, (count - 1) // 2), min(_FAR, count // 2) + 1):
                phase = before + offset * step
                change = coefficient(surface, complex(math.cos(phase), math.sin(phase))) - through
                for k in range(users):
                    onward = change * complex(over.reflected[0, k, n], over.reflected[1, k, n])
                    for m in range(antennas):
                        tried[k, m] = channel[k, m] + onward * complex(over.incident[0, m, n], over.incident[1, m, n])
                score = slot_score(slot.system, tried, budgets, slot.weights, slot.order)
                if score > best:
                    best, phases[n] = score, phase
            change = coefficient(surface, complex(math.cos(phases[n]), math.sin(phases[n]))) - through
            for k in range(users):
                onward = change * complex(over.reflected[0, k, n], over.reflected[1, k, n])
                for m in range(antennas):
                    channel[k, m] += onward * complex(over.incident[0, m, n], over.incident[1, m, n])
