"""Every scalar equation of the radio, once: path loss, pattern, rates, and what a rate takes.

Compiled into each loop that uses them, so that loops over links, places and users are done in vectors. Labels are those
of the paper.
"""

import math

from mjris.jit import vectors
from mjris.jit.compiled import inlined
from mjris.radio.tables import LinkTable

_LN2 = math.log(2)
_NEPERS = math.log(10) / 10
"""Of power in a dB."""
_NOTHING_DB = -3000.0
"""A level that is no power at all; `vectors.exp` goes little further."""
_HAIR = 1 + 1e-12
"""Powers exceed what a rate takes by that much, so that rounding never leaves it below its QoS."""


@inlined
def db_to_linear(level_db: float) -> float:
    """Power ratio of a level [dB]."""
    ratio = vectors.exp(_NEPERS * max(level_db, _NOTHING_DB))
    return ratio if level_db > _NOTHING_DB else 0.0


@inlined
def path_loss_db(table: LinkTable, squared_m: float, obstacles: float) -> float:
    """Path loss [dB] over a squared distance [m²] behind so many obstacles, eqs. (PLLOS), (PLNLOS), (L).

    The distance is clamped to 1 m, where the models begin. With materials `obstacles` are what is lost on the straight
    way through them [dB]; more than behind one obstacle, around it, is never lost.
    """
    decades = 0.5 / math.log(10) * vectors.log(max(squared_m, 1.0))
    clear = table.clear_1m_db + table.clear_decade_db * decades
    further = 0.0 if table.materials else table.obstacle_db * (obstacles - 1)
    blocked = max(clear, table.blocked_1m_db + table.blocked_decade_db * decades + further)
    if table.materials:
        blocked = min(blocked, clear + obstacles)
    return blocked if obstacles > 0 else clear


@inlined
def rician_k(table: LinkTable, obstacles: float) -> float:
    """K-factor of a link, none behind obstacles; through materials its straight path is what is left of it."""
    if table.materials:
        return table.rician_k * db_to_linear(-obstacles)
    return 0.0 if obstacles > 0 else table.rician_k


@inlined
def element_gain_db(table: LinkTable, cosine: float) -> float:
    """Power gain [dB] of an element at an angle from boresight: 2(n+1) cos^n in front, nothing behind; or isotropic."""
    gain_db = table.boresight_db + table.exponent / _NEPERS * vectors.log(max(cosine, 1e-300))
    return gain_db if cosine > 0 or not table.front_only else _NOTHING_DB


@inlined
def rate_bps(bandwidth_hz: float, sinr: float) -> float:
    """R = B log2(1 + γ) [bit/s]."""
    return bandwidth_hz / _LN2 * vectors.log1p(sinr)


@inlined
def cancelled_sinr(gain: float, power_w: float, later_w: float) -> float:
    """SINR where only those decoded later are left, eqs. (inuk), (SINROMA), for a gain over noise [1/W]."""
    return gain * power_w / (gain * later_w + 1)


@inlined
def needed_share(bandwidth_hz: float, wanted_bps: float) -> float:
    """What part t/(1+t) = 1 - 2^(-R/B) of its SINR t a rate takes."""
    return -math.expm1(-_LN2 / bandwidth_hz * wanted_bps) * _HAIR


@inlined
def qos_power_w(gain: float, left_w: float, needed: float) -> float:
    """What a user's rate takes [W] of the power that is left, all of which interferes but its own: t/(1+t) (P + 1/e).

    For a `needed_share` and a gain e over noise [1/W]; nothing where all that is left would not be enough.
    """
    wanted = needed * (left_w + 1 / gain)
    return wanted if wanted <= left_w else 0.0
