"""Path loss and Rician fading with its correlation over time and between cells."""

from typing import Any, TypeAlias

import numpy as np
from array_api_compat import is_array_api_obj

from mjris.radio.namespace import array_namespace

Array: TypeAlias = Any
"""An array of any library that follows the Python array API; real ones are float64, complex ones complex128."""


def path_loss_db(distance_m: Array, blockers: Array, carrier_hz: float) -> Array:
    """Path loss of links with `blockers` obstacles in their way [dB].

    Eq. (PLLOS) without obstacles, eq. (PLNLOS) with L_f = 15 + 4(n - 1) for n >= 1 of them. `distance_m` [m] is
    clamped to 1 m, where the models begin. Both arguments may be plain numbers, and broadcast.
    """
    xp, distance = _as_array(distance_m)
    blockers = xp.asarray(blockers)
    distance = xp.where(distance < 1, 1.0, distance)
    clear = 16.9 * xp.log10(distance) - 27.2 + 20 * np.log10(carrier_hz / 1e6)
    blocked = indoor_loss_db(distance, carrier_hz, 25.5, 15 + 4 * (blockers - 1))
    return xp.where(blockers > 0, blocked, clear)


def indoor_loss_db(distance_m: Array, carrier_hz: float, coefficient: float, obstacle_loss_db: Array) -> Array:
    """Site-general indoor transmission loss of ITU-R P.1238: L_0 + N log10 d + L_f, with L_0 of eq. (L) [dB]."""
    xp, distance = _as_array(distance_m)
    return 20 * np.log10(carrier_hz / 1e6) - 28 + coefficient * xp.log10(distance) + obstacle_loss_db


def db_to_linear(db: Array) -> Array:
    """Linear power ratio of a level in dB."""
    return 10.0 ** (db / 10)


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Circular complex Gaussian samples of unit mean power, NumPy [*shape]."""
    parts = rng.standard_normal((*shape, 2)) * 0.5**0.5
    return parts.view(np.complex128)[..., 0]


def evolve(diffuse: Array, innovation: Array, memory: float) -> Array:
    """One slot of the first-order autoregression of diffuse fading.

    `innovation` is a fresh unit-power sample; the mean power stays one and the correlation from slot to slot is
    `memory` (1 freezes the fading).
    """
    return memory * diffuse + (1 - memory**2) ** 0.5 * innovation


def mix_cells(shared: Array, own: Array, difference_factor: float) -> Array:
    """Diffuse fading of cells that share a part of it.

    `shared` [...] is one unit-power sample for all cells, `own` [E, ...] one for each; between two cells the result
    [E, ...] has the correlation 1 - `difference_factor`, and unit mean power.
    """
    return (1 - difference_factor) ** 0.5 * shared + difference_factor**0.5 * own


def rician(los: Array, diffuse: Array, k_factor: Array) -> Array:
    """Rician fading of unit mean power, h of eq. (PL).

    `los` has unit modulus, `diffuse` unit mean power, and `k_factor` is their power ratio, linear (0 is Rayleigh);
    all broadcast.
    """
    diffuse_share = 1 / (k_factor + 1)
    return (k_factor * diffuse_share) ** 0.5 * los + diffuse_share**0.5 * diffuse


def _as_array(values: Array) -> tuple[Any, Array]:
    """The namespace of `values` and `values` as its array; plain numbers become NumPy arrays."""
    array = values if is_array_api_obj(values) else np.asarray(values)
    return array_namespace(array), array
