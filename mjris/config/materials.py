"""What gets through walls and furniture, as data: losses of materials by frequency, and what looks like which."""

from typing import NamedTuple


class Material(NamedTuple):
    """Loss [dB] on the way through a piece: constant + factor · (f / GHz) ^ exponent."""

    source: str
    constant_db: float
    factor_db: float
    exponent: float = 1.0

    def loss_db(self, carrier_hz: float) -> float:
        """The loss at a carrier."""
        return self.constant_db + self.factor_db * (carrier_hz / 1e9) ** self.exponent


MATERIALS = {
    "glass": Material("3GPP TR 38.901, table 7.4.3-1, standard multi-pane", 2.0, 0.2),
    "coated_glass": Material("3GPP TR 38.901, table 7.4.3-1, IRR", 23.0, 0.3),
    "wood": Material("3GPP TR 38.901, table 7.4.3-1", 4.85, 0.12),
    "concrete": Material("3GPP TR 38.901, table 7.4.3-1", 5.0, 4.0),
    # Two boards of 12.5 mm: 1636 σ/√ε dB/m with ε = 2.94 and σ = 0.0116 f^0.7076 S/m, and 0.3 dB at each of 4 faces.
    "plasterboard": Material("ITU-R P.2040, two boards of 12.5 mm", 1.2, 0.277, 0.7076),
    "metal": Material("reflects all of it", 100.0, 0.0),
}
"""Materials of walls and furniture."""

LOOKS = {
    "wood": "wood",
    "wood_dark": "wood",
    "white": "wood",
    "dark": "wood",
    "books": "wood",
    "metal": "metal",
    "screen": "metal",
    "concrete": "concrete",
    "pot": "concrete",
    "plaster": "plasterboard",
    "felt_green": "plasterboard",
    "felt_grey": "plasterboard",
    "fabric_blue": "plasterboard",
    "fabric_light": "plasterboard",
    "fabric_ochre": "plasterboard",
    "leaf": "plasterboard",
    "glass": "glass",
    "coated_glass": "coated_glass",
}
"""The material behind every look of assets/office.xml that bricks may have."""

BODY_DB = 20.0
"""What a person in the way costs [dB]; measured from 10 GHz on are some 15 to 30."""


def look_loss_db(look: str, carrier_hz: float) -> float:
    """Loss [dB] through a brick that looks so."""
    return MATERIALS[LOOKS[look]].loss_db(carrier_hz)
