"""What links cost at one carrier, with the pattern of elements: numbers for compiled loops, from a config."""

import math
from typing import NamedTuple

from mjris.config import LINK_TABLES, Radio
from mjris.config.link_tables import Terms


class LinkTable(NamedTuple):
    """An entry of `LINK_TABLES` at one carrier, and what a config says of fading and elements."""

    clear_1m_db: float
    """Path loss in sight at one metre [dB]."""
    clear_decade_db: float
    """How much it grows in a decade of distance [dB]."""
    blocked_1m_db: float
    """The same behind one obstacle."""
    blocked_decade_db: float
    obstacle_db: float
    """What every further obstacle adds [dB], if they are counted."""
    materials: bool
    """Whether what is in the way is told in dB, and not counted."""
    rician_k: float
    """Of links in sight, linear."""
    front_only: bool
    """Whether elements have the cosine pattern, and nothing behind them, and not the isotropic one."""
    boresight_db: float
    """Gain of an element straight ahead [dB]."""
    exponent: float
    """Of the cosine of the angle from there."""

    @classmethod
    def of(cls, radio: Radio) -> "LinkTable":
        """The table that a config names."""
        source = LINK_TABLES[radio.link_table]
        decades = math.log10(radio.carrier_hz / source.unit_hz)

        def at_1_m(terms: Terms) -> float:
            return terms.constant_db + terms.frequency_db * decades

        cosine = radio.element_pattern == "cosine"
        return cls(
            at_1_m(source.clear),
            source.clear.distance_db,
            at_1_m(source.blocked) + source.first_obstacle_db,
            source.blocked.distance_db,
            source.further_obstacle_db,
            radio.obstacles == "materials",
            10 ** (radio.rician_k_db / 10),
            cosine,
            # 2(n+1) cos^n radiates all of the power (SimRIS: n = 0.57).
            10 * math.log10(2 * (radio.element_exponent + 1)) if cosine else 0.0,
            radio.element_exponent if cosine else 0.0,
        )
