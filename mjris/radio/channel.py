"""Element positions and patterns, the channels between AP, RIS and users, and the channel they make together."""

import math
from typing import NamedTuple

from array_api_compat import device

from mjris.radio.namespace import array_namespace
from mjris.radio.propagation import Array


class Channels(NamedTuple):
    """Complex amplitude gains of the three links; path loss, patterns and fading included."""

    direct: Array
    """h_d, AP to users [..., K, M]."""
    incident: Array
    """G, AP to RIS [..., N, M]."""
    reflected: Array
    """h_r, RIS to users [..., K, N]."""


def uniform_linear_array(centre: Array, axis: Array, count: int, spacing_m: float) -> Array:
    """Positions [..., count, 3] [m] of elements along the direction `axis` [..., 3] around `centre` [..., 3] [m]."""
    xp = array_namespace(centre, axis)
    steps = xp.arange(count, dtype=centre.dtype, device=device(centre)) - (count - 1) / 2
    return centre[..., None, :] + (spacing_m * steps)[:, None] * _unit(axis)[..., None, :]


def panel_normal(heading: Array) -> Array:
    """Unit normal [..., 3] of a vertical panel that faces the horizontal direction `heading` [...] [rad]."""
    xp = array_namespace(heading)
    return xp.stack([xp.cos(heading), xp.sin(heading), xp.zeros_like(heading)], axis=-1)


def panel_elements(centre: Array, heading: Array, rows: int, cols: int, spacing_m: float) -> Array:
    """Positions of the elements of a vertical panel [..., N, 3] [m], row by row from the bottom.

    `centre` [..., 3] [m] is the panel's middle and `heading` [...] [rad] the horizontal direction that it faces.
    """
    xp = array_namespace(centre, heading)
    element = xp.arange(rows * cols, dtype=centre.dtype, device=device(centre))
    along_row = spacing_m * (element % cols - (cols - 1) / 2)
    heading = heading[..., None]
    x, y = -xp.sin(heading) * along_row, xp.cos(heading) * along_row
    z = xp.broadcast_to(spacing_m * (element // cols - (rows - 1) / 2), x.shape)
    return centre[..., None, :] + xp.stack([x, y, z], axis=-1)


def element_gain(pattern: str, exponent: float, normal: Array, direction: Array) -> Array:
    """Power gain [...] of an element that faces `normal` [..., 3] toward `direction` [..., 3], linear.

    "isotropic" is 1 everywhere; "cosine" is 2(n+1) cos^n in front of the element and nothing behind it, which
    radiates all of the power (SimRIS: 2q = n = 0.57). Vectors of any length. Raises `ValueError` for any other pattern.
    """
    xp = array_namespace(normal, direction)
    square = xp.vecdot(normal, normal) * xp.vecdot(direction, direction)
    return pattern_gain(pattern, exponent, xp.vecdot(normal, direction) / xp.sqrt(xp.where(square > 0, square, 1.0)))


def pattern_gain(pattern: str, exponent: float, cosine: Array) -> Array:
    """`element_gain` [...] for the cosine [...] of the angle off boresight."""
    xp = array_namespace(cosine)
    if pattern == "isotropic":
        return xp.ones_like(cosine)
    if pattern == "cosine":
        front = cosine > 0
        base = xp.where(front, cosine, 1.0)  # a power of zero would have an infinite derivative
        return xp.where(front, 2 * (exponent + 1) * base**exponent, 0.0)
    raise ValueError(f"pattern: {pattern!r} is not known: it is one of isotropic, cosine")


def phase_ramp(receivers: Array, transmitters: Array, wavelength_m: float) -> Array:
    """Spherical-wave phase exp(-j 2π d / λ) of every line of sight [..., A, B].

    `receivers` [..., A, 3] and `transmitters` [..., B, 3] are positions [m]; d is each pair's own distance.
    """
    xp = array_namespace(receivers, transmitters)
    between = receivers[..., :, None, :] - transmitters[..., None, :, :]
    return xp.exp(-2j * math.pi / wavelength_m * xp.sqrt(xp.vecdot(between, between)))


def ris_response(phases_rad: Array, amplitude: Array) -> Array:
    """Reflection coefficients β e^{jθ} [..., N] of phases [..., N] [rad] and a modulus β that broadcasts."""
    return amplitude * array_namespace(phases_rad).exp(1j * phases_rad)


def cascade(channels: Channels) -> Array:
    """The path over every element: h_r[k, n] G[n, m], [..., K, N, M]."""
    return channels.reflected[..., :, :, None] * channels.incident[..., None, :, :]


def effective_channel(channels: Channels, response: Array) -> Array:
    """H = h_d + h_r Θ G [..., K, M], the factor in eq. (yt), for reflection coefficients `response` [..., N]."""
    return channels.direct + (channels.reflected * response[..., None, :]) @ channels.incident


def _unit(vector: Array) -> Array:
    """`vector` [..., 3] scaled to length one; zero stays zero, with a finite derivative."""
    xp = array_namespace(vector)
    square = xp.vecdot(vector, vector)[..., None]
    return vector / xp.sqrt(xp.where(square > 0, square, 1.0))
