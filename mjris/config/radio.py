"""Parameters of the radio: links, arrays, what surfaces can do, what is known, and multiple access."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from mjris.config.errors import plain_errors
from mjris.config.fields import STRICT, Count, Fraction, NonNegative, Positive
from mjris.config.link_tables import refusal


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Hardware:
    """What keeps the panels' elements from being ideal; by default nothing."""

    phase_bits: Annotated[int, Field(ge=1, le=8)] | None = None
    """b: elements take the nearest of 2^b phases, 0 among them; any by default."""
    least_amplitude: Fraction = 1.0
    """Least modulus of a reflection coefficient over the phase, as a share of the largest; measured was 0.2."""
    amplitude_steepness: NonNegative = 1.6
    """How narrow the dip around that phase is."""
    amplitude_offset_deg: float = 77.4
    """The dip lies 90° before this phase [°]; 77.4 is 0.43 π."""
    phase_noise_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    """Standard deviation of what elements miss their phases by, anew whenever they are set [°]."""
    dead_share: Fraction = 0.0
    """Share of the elements that reflect nothing, which are others in every cell and stay so."""
    board_w: NonNegative = 0.0
    """What the controller of a panel draws [W]."""
    elements_per_driver: Count = 8
    """How many elements a driver sets."""
    driver_w: NonNegative = 0.0
    """What a driver draws [W]."""
    element_w: NonNegative = 0.0
    """What an element itself draws [W]."""


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Knowledge:
    """What is known of channels and places, and what that costs; by default everything, at once and for nothing."""

    source: Literal["channels", "positions"] = "channels"
    """channels: beams, phases and powers follow from estimated channels; positions: from where users are alone, as if
    every path were the straight one; path losses are known either way."""
    nmse_db: Annotated[float, Field(ge=-100, le=20)] | None = None
    """Error of estimated channels, by the mean power of each link [dB]; none by default."""
    age_s: NonNegative = 0.0
    """How old channels are when they are used [s]; things have moved on by then."""
    position_error_m: NonNegative = 0.0
    """Standard deviation of users' known positions from the true ones, along x and along y [m]."""
    pilot_s: NonNegative = 0.0
    """What every element of the panels costs of each slot in pilots [s]; users have no rate then."""
    control_s: NonNegative = 0.0
    """What setting the panels costs of each slot [s]."""

    @model_validator(mode="after")
    def _only_what_is_estimated_is_wrong(self) -> "Knowledge":
        for name, value in (("nmse_db", self.nmse_db), ("age_s", self.age_s or None)):
            if self.source == "positions" and value is not None:
                raise ValueError(
                    f"radio.knowledge.{name}: {value} is not allowed: with radio.knowledge.source 'positions' no "
                    "channel is estimated"
                )
        return self

    @property
    def perfect(self) -> bool:
        """Whether channels are known as they are."""
        return self.source == "channels" and self.nmse_db is None and self.age_s == 0


@plain_errors
@dataclass(frozen=True, kw_only=True, config=STRICT)
class Radio:
    """Links, arrays and multiple access."""

    link_table: str = "paper"
    """What links cost, by the name of a published model: paper (ITU-R, as in the paper) or inh (3GPP InH-Office)."""
    obstacles: Literal["counted", "materials"] = "counted"
    """counted: what is in the way costs what the link table says, whatever it is made of; materials: what gets through
    it, by material and carrier, or around it, as behind one obstacle, whichever is more."""
    carrier_hz: Positive = 2e9
    """f_c [Hz], where the link table holds."""
    bandwidth_hz: Positive = 1e6
    """B, the band of one cell [Hz]."""
    noise_dbm_per_mhz: Annotated[float, Field(ge=-200, le=50)] = -30.0
    """Noise power density [dBm/MHz]."""
    tx_power_dbm: Annotated[float, Field(ge=0, le=60)] = 20.0
    """P_max, all that the AP transmits [dBm]."""
    num_antennas: Count = 4
    """M, antennas of the AP."""
    panel_rows: Count = 4
    """Rows of reflecting elements of the rover's panel."""
    panel_cols: Count = 4
    """Columns of reflecting elements of the rover's panel."""
    element_pattern: Literal["isotropic", "cosine"] = "cosine"
    """isotropic: the paper's; cosine: gain 2(n+1)cos^n in front of the panel, nothing behind it."""
    element_exponent: NonNegative = 0.57
    """n of the cosine pattern; 0.57 gives 4.97 dBi at boresight."""
    element_amplitude: Fraction = 1.0
    """β, the largest modulus of an element's reflection coefficient."""
    surface: Hardware = Hardware()
    """What the elements are like beyond that."""
    knowledge: Knowledge = Knowledge()
    """What is known of channels and places."""
    rician_k_db: Annotated[float, Field(ge=-30, le=60)] = 7.0
    """Rician K-factor of links in line of sight [dB]; blocked links are Rayleigh."""
    fading_memory: Fraction = 0.0
    """Correlation of the diffuse fading from slot to slot; 1 is frozen for the episode."""
    difference_factor: Fraction = 0.0
    """DF: diffuse fading is the same in every cell at 0, independent at 1."""
    scheme: Literal["noma", "oma"] = "noma"
    """Multiple access."""
    oma_selection: bool = False
    """Whether the scheduler of OMA may select users: where not all have QoS and that gives more, a cluster's bands and
    power go to its strongest user, as with NOMA its power does."""
    num_clusters: Count = 2
    """V, clusters of users."""
    cluster_power: Literal["equal", "shared"] = "equal"
    """equal: the paper's, no cluster has more than P_max/V; shared: what one leaves of P_max another may have, where
    budgets are searched (task.ascent_steps)."""
    decoding_order: Literal["dynamic", "static"] = "dynamic"
    """dynamic: by the gains of each slot; static: by those of the episode's first slot."""

    @model_validator(mode="after")
    def _link_is_known(self) -> "Radio":
        reason = refusal(self.link_table, self.carrier_hz)
        if reason:
            raise ValueError(reason)
        return self

    @property
    def num_elements(self) -> int:
        """N of the rover's panel."""
        return self.panel_rows * self.panel_cols

    @property
    def wavelength_m(self) -> float:
        """Carrier wavelength [m]."""
        return 299_792_458.0 / self.carrier_hz

    @property
    def tx_power_w(self) -> float:
        """P_max [W]."""
        return dbm_to_w(self.tx_power_dbm)

    @property
    def noise_w(self) -> float:
        """Noise power in the whole band [W]."""
        return dbm_to_w(self.noise_dbm_per_mhz) * self.bandwidth_hz / 1e6


def dbm_to_w(power_dbm: float) -> float:
    """Power in dBm to power in [W]."""
    return 10 ** (power_dbm / 10) / 1e3


def w_to_dbm(power_w: float) -> float:
    """Power in [W] to power in dBm."""
    return 10 * math.log10(power_w * 1e3)
