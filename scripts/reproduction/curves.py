"""What is trained for each figure: the curves, their configs, and how much of everything at each scale."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from mjris.config import Config, preset
from mjris.eval import parking

PRESETS = ("classic", "paper")
SCHEMES = ("noma", "oma")
BASE = "mobile RIS"
"""The curve of a preset as it is, for one cell: NOMA, dynamic order, 16 elements, 4 antennas, 20 dBm, α = 3e-4."""
FIXED, TURNING, PARKED = "fixed RIS", "parked RIS that turns", parking.NAME
SELECTING = "mobile RIS, selecting users"
"""OMA that may leave users out, as NOMA does."""
_CHECKPOINT = 10
"""A cell alone has no rounds; so many episodes at most are from one checkpoint to the next."""
DIFFERENCES = (0.0, 0.5, 1.0)
"""Difference factors."""
DISCOUNTS = (0.0, 0.9, 0.99)
"""γ"""
PANELS = {4: (2, 2), 8: (2, 4), 16: (4, 4), 32: (4, 8)}
"""Rows and columns of a panel by its number of elements."""


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How much is trained and judged."""

    seeds: tuple[int, ...]
    scenes: int
    """Held-out scenes."""
    slots: int
    """Slots of an episode."""
    every: int
    """One of so many slots is searched for the best phases and powers, and bounded."""
    episodes: Mapping[str, int]
    """Of a cell alone, by preset."""
    federated: Mapping[str, int]
    """Of the cells of a federation, and of those that are compared with them, by preset."""
    rounds: Mapping[str, int]
    """Episodes between two averages of a federation, by preset."""
    judged: int
    """Episodes from one judgement to the next: whole rounds."""
    learning_rates: tuple[float, ...]
    elements: tuple[int, ...]
    powers_dbm: tuple[float, ...]


SCALES = {
    "quick": Scale(
        seeds=(1, 2),
        scenes=8,
        slots=100,
        every=10,
        episodes={"classic": 10, "paper": 10},
        federated={"classic": 15, "paper": 15},
        rounds={"classic": 5, "paper": 5},
        judged=5,
        learning_rates=(1e-3, 3e-4, 1e-4),
        elements=(4, 8, 16, 32),
        powers_dbm=(10.0, 20.0, 30.0),
    ),
    "full": Scale(
        seeds=(1, 2, 3, 4, 5),
        scenes=32,
        slots=100,
        every=10,
        episodes={"classic": 40, "paper": 40},
        federated={"classic": 60, "paper": 80},
        rounds={"classic": 10, "paper": 20},
        judged=20,
        learning_rates=(1e-3, 5e-4, 3e-4, 1e-4, 1e-5),
        elements=(4, 8, 16, 32),
        powers_dbm=(10.0, 15.0, 20.0, 25.0, 30.0),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One line of a figure, or one point of a line over x."""

    figure: str
    preset: str
    name: str
    scheme: str
    config: Config
    """With the seed 0."""
    x: float | None = None
    """Where the point is; None is a line over the episodes."""
    bounded: bool = True
    """Whether the planner and the upper bound are drawn beside."""
    parked: bool = False
    """Whether the best-placed fixed RIS is drawn beside."""

    def judged(self, scale: Scale) -> list[int]:
        """The episodes after which the agents are judged."""
        first, last = self.config.federation.round_episodes, self.config.federation.episodes
        return [last] if self.x is not None else sorted({first, *range(scale.judged, last, scale.judged), last})


def base(name: str, scale: Scale, *, cells: int = 1, **changes: Mapping[str, Any]) -> Config:
    """The preset for one cell, or for a federation of several, with some fields of its sections changed."""
    config = preset(name)
    federation = replace(
        config.federation,
        num_cells=cells,
        episodes=(scale.episodes if cells == 1 else scale.federated)[name],
        round_episodes=min(scale.rounds[name], _CHECKPOINT) if cells == 1 else scale.rounds[name],
    )
    config = replace(config, task=replace(config.task, slots=scale.slots), federation=federation)
    return replace(config, **{key: replace(getattr(config, key), **fields) for key, fields in changes.items()})


def learning_rate(name: str, scale: Scale) -> list[Curve]:
    """Throughput over episodes for several learning rates."""
    return [
        _curve("learning_rate", name, f"α = {rate:g}", scheme, scale, agent={"learning_rate": rate})
        for rate in scale.learning_rates
        for scheme in SCHEMES
    ]


def elements(name: str, scale: Scale) -> list[Curve]:
    """Sum rate over the number of reflecting elements."""
    sides: dict[int, dict[str, Any]] = {
        number: dict(zip(("panel_rows", "panel_cols"), PANELS[number], strict=True)) for number in scale.elements
    }
    return [
        _curve("elements", name, BASE, scheme, scale, x=number, radio=panel)
        for number, panel in sides.items()
        for scheme in SCHEMES
    ]


def power(name: str, scale: Scale) -> list[Curve]:
    """Sum rate over the AP's power, for two and four antennas; the planner and the bound are those of four."""
    return [
        _curve(
            "power",
            name,
            f"M = {antennas}",
            scheme,
            scale,
            x=power_dbm,
            bounded=antennas == 4,
            radio={"num_antennas": antennas, "tx_power_dbm": power_dbm},
        )
        for antennas in (4, 2)
        for power_dbm in scale.powers_dbm
        for scheme in SCHEMES
    ]


def gain(name: str, scale: Scale) -> list[Curve]:
    """Throughput over episodes with each component taken away: every agent learns with what it is judged with."""
    cases: list[tuple[str, str, dict[str, Any]]] = [
        (BASE, "noma", {}),
        ("static order", "noma", {"radio": {"decoding_order": "static"}}),
        (FIXED, "noma", {"task": {"ris": "fixed"}}),
        (TURNING, "noma", {"task": {"ris": "turning"}}),
        ("random phases", "noma", {"task": {"phases": "random"}}),
        ("no RIS", "noma", {"task": {"ris": "none"}}),
        (BASE, "oma", {}),
        (SELECTING, "oma", {"radio": {"oma_selection": True}}),
    ]
    first, *others = [_curve("gain", name, case, scheme, scale, **changes) for case, scheme, changes in cases]
    return [replace(first, parked=True), *others]


def difference_factor(name: str, scale: Scale) -> list[Curve]:
    """Federations whose cells fade more or less alike, and a cell alone for as many episodes."""
    together = [
        _curve("difference_factor", name, f"DF = {factor:g}", "noma", scale, 3, radio={"difference_factor": factor})
        for factor in DIFFERENCES
    ]
    return [*together, _alone("difference_factor", name, scale)]


def federation(name: str, scale: Scale) -> list[Curve]:
    """Agents with and without federation."""
    return [_curve("federation", name, "federation", "noma", scale, 3), _alone("federation", name, scale)]


def _curve(
    figure: str,
    name: str,
    case: str,
    scheme: str,
    scale: Scale,
    cells: int = 1,
    *,
    x: float | None = None,
    bounded: bool = True,
    **changes: Mapping[str, Any],
) -> Curve:
    """A curve of `base` with a scheme and other changes."""
    changes["radio"] = {**changes.get("radio", {}), "scheme": scheme}
    config = base(name, scale, cells=cells, **changes)
    return Curve(figure=figure, preset=name, name=case, scheme=scheme, config=config, x=x, bounded=bounded)


def _alone(figure: str, name: str, scale: Scale) -> Curve:
    """One cell for as many episodes as those of a federation."""
    curve = _curve(figure, name, "one cell", "noma", scale)
    longer = replace(curve.config.federation, episodes=scale.federated[name])
    return replace(curve, config=replace(curve.config, federation=longer))


def discount(name: str, scale: Scale) -> list[Curve]:
    """Throughput over episodes for several discounts."""
    return [
        _curve("discount", name, f"γ = {factor:g}", "noma", scale, agent={"discount": factor}) for factor in DISCOUNTS
    ]


TRAINED: dict[str, Callable[[str, Scale], list[Curve]]] = {
    "learning_rate": learning_rate,
    "elements": elements,
    "power": power,
    "gain": gain,
    "difference_factor": difference_factor,
    "federation": federation,
    "discount": discount,
}
"""Figures whose agents are trained for a preset at a scale."""
