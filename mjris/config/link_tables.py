"""What links cost, as data: one entry for every published model, with the numbers of its source."""

from typing import NamedTuple


class Terms(NamedTuple):
    """Path loss [dB] of a constant and two logarithms: constant + distance · log10 d + frequency · log10 f."""

    constant_db: float
    distance_db: float
    """A decade of the distance in m."""
    frequency_db: float
    """A decade of the frequency, in the table's unit."""


class Source(NamedTuple):
    """A published model of links."""

    source: str
    unit_hz: float
    """What its frequencies are counted in."""
    carrier_hz: tuple[float, float]
    """Where it holds."""
    clear: Terms
    """In line of sight."""
    blocked: Terms
    """Behind obstacles; never less than in line of sight."""
    first_obstacle_db: float
    """What one obstacle adds to that."""
    further_obstacle_db: float
    """What every further one adds."""


LINK_TABLES = {
    # Eqs. (PLLOS), (PLNLOS) and (L), L_f = 15 + 4(n - 1).
    "paper": Source(
        "ITU-R P.1238, as in the paper",
        1e6,
        (3e8, 3e11),
        clear=Terms(-27.2, 16.9, 20),
        blocked=Terms(-28, 25.5, 20),
        first_obstacle_db=15,
        further_obstacle_db=4,
    ),
    "inh": Source(
        "3GPP TR 38.901 InH-Office, table 7.4.1-1",
        1e9,
        (5e8, 1e11),
        clear=Terms(32.4, 17.3, 20),
        blocked=Terms(17.3, 38.3, 24.9),
        first_obstacle_db=0,
        further_obstacle_db=0,
    ),
}
"""By the names that `radio.link_table` takes."""


def refusal(name: str, carrier_hz: float) -> str | None:
    """Why there is no such link, in one sentence that names the field at fault; None where there is."""
    if name not in LINK_TABLES:
        return f"radio.link_table: {name!r} is not known: it is one of {', '.join(sorted(LINK_TABLES))}"
    low, high = LINK_TABLES[name].carrier_hz
    if not low <= carrier_hz <= high:
        return (
            f"radio.carrier_hz: {carrier_hz:g} is not allowed: radio.link_table {name!r} "
            f"({LINK_TABLES[name].source}) holds from {low:g} to {high:g} Hz"
        )
    return None
