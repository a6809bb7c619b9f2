"""The channels between AP, RIS and users, and the channel that they make together."""

from typing import NamedTuple

from mjris.radio.namespace import Array, array_namespace


class Channels(NamedTuple):
    """Complex amplitude gains of the three links; path loss, patterns and fading included."""

    direct: Array
    """h_d, AP to users [..., K, M]."""
    incident: Array
    """G, AP to RIS [..., N, M]."""
    reflected: Array
    """h_r, RIS to users [..., K, N]."""


def ris_response(phases_rad: Array, amplitude: Array) -> Array:
    """Reflection coefficients β e^{jθ} [..., N] of phases [..., N] [rad] and a modulus β that broadcasts."""
    return amplitude * array_namespace(phases_rad).exp(1j * phases_rad)


def cascade(channels: Channels) -> Array:
    """The path over every element: h_r[k, n] G[n, m], [..., K, N, M]."""
    return channels.reflected[..., :, :, None] * channels.incident[..., None, :, :]


def effective_channel(channels: Channels, response: Array) -> Array:
    """H = h_d + h_r Θ G [..., K, M], the factor in eq. (yt), for reflection coefficients `response` [..., N]."""
    return channels.direct + (channels.reflected * response[..., None, :]) @ channels.incident
