"""What cells look like as a slot begins, what is decided in it, and what it gives."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.radio.links import Channels
from mjris.simulation.constraints import Constraints

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Scene:
    """What a slot begins with, in E cells with K users; the L links are those of `Links`."""

    rover_xy: FloatArray
    """[E, 2] [m]"""
    rover_heading: FloatArray
    """[E] [rad]"""
    panel_heading: FloatArray
    """Of the rover's panel [E] [rad]."""
    users_xy: FloatArray
    """[E, K, 2] [m]"""
    known_users_xy: FloatArray
    """Where users are taken to be [E, K, 2] [m]."""
    blockers: IntArray
    """Obstacles on every link [E, L]."""
    path_loss_db: FloatArray
    """Of every link [E, L] [dB]."""
    mean_gain: FloatArray
    """Power gain of every link without fading, the pattern of the panel's elements included [E, L]."""
    channels: Channels
    """h_d [E, K, M], G [E, N, M], h_r [E, K, N]: what rates follow from."""
    known: Channels
    """What is known of them: what beams, phases, powers and observations follow from."""


Retune = Callable[[Channels], tuple[FloatArray, FloatArray]]
"""Phases [E, N] [rad] and powers [E, K] [W] for known channels."""


class Controls(NamedTuple):
    """What is decided in a slot, in E cells."""

    displacement_m: FloatArray
    """[E, 2] [m]"""
    phases_rad: FloatArray
    """[E, N] [rad]"""
    powers_w: FloatArray
    """[E, K] [W]"""
    pan_rad: FloatArray | None = None
    """By how much panels are turned from the bisector of AP and users [E] [rad]; None is not at all."""
    retune: Retune | None = None
    """What phases and powers are set to within the slot, where `task.phase_updates_per_slot` says when; None lets them
    as they are."""


@dataclass(frozen=True)
class Slot:
    """What a slot gave, and the scene that the next one begins with."""

    rates_bps: FloatArray
    """[E, K] [bit/s]"""
    qos_met: NDArray[np.bool_]
    """[E, K]"""
    bare_rates_bps: FloatArray
    """What the same slot gives without RIS under the reference powers, in the order of its gains [E, K] [bit/s]."""
    channels: tuple[Channels, ...]
    """Over which it transmitted in every part, of which rates are means: one, unless phases are held."""
    displacement_m: FloatArray
    """How far each rover got [E, 2] [m]."""
    clearance_m: FloatArray
    """Smallest distance between the hull and anything in the slot [E] [m]."""
    collisions: IntArray
    """Penetrating contacts seen in the slot [E]."""
    constraints: Constraints
    scene: Scene
