"""Quasi-Newton ascent on the merit of one cell's slot over its phases."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.jit import vectors
from mjris.jit.compiled import compiled, reducing
from mjris.radio.merit import merit
from mjris.radio.serving import System
from mjris.radio.surface import Parts, Surface, effective, pulled, slopes

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]

_MEMORY = 6
"""Steps that the quasi-Newton ascent remembers."""
_FIRST_STEP, _LONGEST_STEP = 0.3, 1.5
"""How far a phase moves in the first step, and at most in any other [rad]."""
_CLIMB_MARGIN = 1e-4
"""The ascent aims this much above QoS, relatively, so that it ends inside where QoS bounds it."""


class Slot(NamedTuple):
    """One cell's slot."""

    system: System
    surface: Surface
    """With elements that take any phase."""
    direct: ComplexArray
    over: Parts
    weights: FloatArray
    order: IntArray


@compiled
def turned(phases: FloatArray) -> FloatArray:
    """The parts [2, N] of e^{jθ}."""
    turns = np.empty((2, len(phases)))
    for n in range(len(phases)):
        turn = vectors.phasor(-1 / (2 * math.pi) * phases[n])
        turns[0, n], turns[1, n] = turn.real, turn.imag
    return turns


@compiled
def _value(slot: Slot, phases: FloatArray, budgets: FloatArray, barrier: float, gradient: FloatArray) -> float:
    """`merit` at phases [N]; writes its `gradient` [N]."""
    turns = turned(phases)
    channel = effective(slot.surface, slot.direct, slot.over, turns)
    by_channel = np.empty_like(channel)
    value = merit(slot.system, channel, budgets, slot.weights, slot.order, barrier, by_channel)
    pull, through = pulled(slot.over, by_channel.conj()), slopes(slot.surface, turns)
    for n in range(len(phases)):
        gradient[n] = pull[0, n] * through[0, n] - pull[1, n] * through[1, n]
    return value


@reducing
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for n in range(len(a)):
        total += a[n] * b[n]
    return total


@compiled
def _steepest(gradient: FloatArray) -> float:
    """The largest modulus, at least a tiny one."""
    most = 1e-300
    for slope in gradient:
        most = max(most, abs(slope))
    return most


@compiled
def climb(slot: Slot, phases: FloatArray, budgets: FloatArray, barrier: float, steps: int) -> float:
    """Limited-memory BFGS ascent of `phases` [N] in place; returns the `merit` that they reach.

    A step that does not gain enough is not taken, and a quarter of it is tried next.
    """
    system = slot.system
    aimed = System(
        system.clusters,
        system.oma,
        system.tx_power_w,
        system.bandwidth_hz,
        system.noise_w,
        system.qos_bps * (1 + _CLIMB_MARGIN),
        system.selects,
        system.shares_power,
    )
    slot = Slot(aimed, slot.surface, slot.direct, slot.over, slot.weights, slot.order)
    elements = len(phases)
    gradient, next_gradient = np.empty(elements), np.empty(elements)
    steps_made, bends = np.empty((_MEMORY, elements)), np.empty((_MEMORY, elements))
    inverse, part, count = np.empty(_MEMORY), np.empty(_MEMORY), 0
    value = _value(slot, phases, budgets, barrier, gradient)
    # Inverse curvature along the last step; at first, such that the steepest phase moves by _FIRST_STEP.
    scale, length = _FIRST_STEP / _steepest(gradient), 1.0
    direction = scale * gradient
    for _ in range(steps):
        trial = phases + length * direction
        next_value = _value(slot, trial, budgets, barrier, next_gradient)
        if not next_value > value + 1e-4 * length * _dot(gradient, direction):
            length *= 0.25
            continue
        step, bend = steps_made[count % _MEMORY], bends[count % _MEMORY]
        for n in range(elements):
            step[n], bend[n] = trial[n] - phases[n], gradient[n] - next_gradient[n]
        curvature, squared = _dot(step, bend), _dot(bend, bend)
        if curvature > 1e-12 * math.sqrt(_dot(step, step) * squared):
            inverse[count % _MEMORY], scale = 1 / curvature, curvature / squared
            count += 1
        phases[:], gradient[:], value, length = trial, next_gradient, next_value, 1.0
        # Inverse curvature times gradient by the two-loop recursion.
        direction[:] = gradient
        for back in range(min(count, _MEMORY)):
            i = (count - 1 - back) % _MEMORY
            part[i] = inverse[i] * _dot(steps_made[i], direction)
            _add(direction, -part[i], bends[i])
        direction *= scale
        for back in range(min(count, _MEMORY) - 1, -1, -1):
            i = (count - 1 - back) % _MEMORY
            _add(direction, part[i] - inverse[i] * _dot(bends[i], direction), steps_made[i])
        direction *= min(1.0, _LONGEST_STEP / _steepest(direction))
    return value


@compiled
def _add(to: FloatArray, factor: float, what: FloatArray) -> None:
    for n in range(len(to)):
        to[n] += factor * what[n]
