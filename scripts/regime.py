"""Where a mobile surface pays: rivals that need no learning in many regimes, the very same scenes for all of a regime.

python scripts/regime.py [REGIME ...] [--scenes S] [--slots T] [--seeds SEED ...] [--out FILE.csv]

Each regime is the recommended one with something changed, see `REGIMES`. Four rivals play it, all with the preset's
phases and powers: no RIS; a fixed RIS at the best place that a search over other scenes finds; a rover that drives for
a radio map without walls; and one whose map has them. Gains are of the last one, of the sum rate with the QoS penalty
of eq. (R), with 95 % intervals over scenes. Prints the table as Markdown; rows that --out has are not played again.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from reference_table import command, markdown_table, number, spread, statistic

from mjris.config import Config, ConfigError, preset
from mjris.eval import parking
from mjris.eval.intervals import gain_percent
from mjris.eval.planner import best_places
from mjris.eval.playing import independent, play
from mjris.eval.policies import Policy, believing_in_sight, no_ris, reference_controls
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId, Purpose, generator

Changes = Mapping[str, Mapping[str, Any]]

REGIMES: dict[str, Changes] = {
    "office": {},
    "horizon of 12 slots": {"task": {"horizon_slots": 12}},
    "closed-form phases": {"task": {"ascent_steps": 0}},
    "shared power": {"radio": {"cluster_power": "shared"}},
    "walks of 0.3 m": {"world": {"walk_scale_m": 0.3}},
    "16 × 16 elements": {"radio": {"panel_rows": 16, "panel_cols": 16}},
    "28 × 28 elements": {"radio": {"panel_rows": 28, "panel_cols": 28}},
    "QoS 50 Mb/s": {"task": {"qos_bps": 50e6}},
    "QoS 150 Mb/s": {"task": {"qos_bps": 150e6}},
    "8 antennas, QoS 125 Mb/s": {"radio": {"num_antennas": 8}, "task": {"qos_bps": 125e6}},
    "six users, three clusters": {"world": {"num_users": 6}, "radio": {"num_clusters": 3}},
    "furniture jitter 0.3 m": {"world": {"layout_jitter_m": 0.3}},
    "InH-Office links": {"radio": {"link_table": "inh"}},
    "OMA": {"radio": {"scheme": "oma"}},
    "on wheels": {"world": {"drive": "wheels"}},
    "layout clinic": {"world": {"layout": "clinic"}},
    "layout office": {"world": {"layout": "office"}},
}
"""What each regime has other than the recommended preset, by section of the config."""
PRESETS = ("wifi", "mmwave", "classic")
"""Regimes that are presets of their own."""

FAR_M = 3.0
"""What counts as far from the AP, and from the best fixed place."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How much is simulated."""

    regimes: tyro.conf.Positional[tuple[str, ...]] = (*REGIMES, *PRESETS)
    """Which of `REGIMES` and `PRESETS`; all by default."""
    scenes: int = 100
    slots: int = 100
    """Slots of every scene's episode."""
    seeds: tuple[int, ...] = (1,)
    """Of the scenes; a row each."""
    out: Path | None = None
    """The table as a .csv file, to which rows are added."""


def main(sweep: Sweep) -> None:
    """Play, print, write."""
    unknown = [name for name in sweep.regimes if name not in (*REGIMES, *PRESETS)]
    if unknown:
        raise ConfigError(f"regimes: {unknown[0]!r} is not known: it is one of {', '.join((*REGIMES, *PRESETS))}")
    table = pd.DataFrame({"regime": [], "seed": []})
    if sweep.out is not None and sweep.out.exists():
        table = pd.read_csv(sweep.out)
    for name in sweep.regimes:
        for seed in sweep.seeds:
            if (name, seed) not in zip(table["regime"], table["seed"], strict=True):
                row = pd.DataFrame([judged(name, sweep, seed)])
                table = pd.concat([table, row], ignore_index=True) if len(table) else row
                if sweep.out is not None:
                    table.to_csv(sweep.out, index=False, float_format="%.6g")
    print(markdown(table))


def changed(config: Config, changes: Changes) -> Config:
    """The config with fields changed by section."""
    return replace(config, **{name: replace(getattr(config, name), **fields) for name, fields in changes.items()})


def judged(name: str, sweep: Sweep, seed: int) -> dict[str, str | int | float]:
    """A regime's row."""
    config = preset(name) if name in PRESETS else changed(preset("office"), REGIMES[name])
    config = replace(config, task=replace(config.task, slots=sweep.slots))
    spot, rng = parking.best_spot(config, seed), generator(seed, Purpose.RESAMPLING)
    rivals: dict[str, Policy] = {
        "no_ris": no_ris(),
        "fixed": parking.parked_at(spot),
        "belief": believing_in_sight(),
        "map": reference_controls(),
    }
    row: dict[str, str | int | float] = {"regime": name, "seed": seed, "scenes": sweep.scenes, "slots": sweep.slots}
    values: dict[str, NDArray[np.floating]] = {}
    for key, policy in rivals.items():
        start = time.process_time()
        played = play(config, policy, sweep.scenes, seed)
        row[f"{key}_ms"] = 1e3 * (time.process_time() - start) / (sweep.scenes * sweep.slots)
        values[key] = played.value_bps
        row |= statistic(f"{key}_mbps", lambda mean: mean / 1e6, played.value_bps, rng=rng)
        row |= statistic(f"{key}_qos_percent", lambda mean: 100 * mean, played.qos_share, rng=rng)
        row[f"{key}_collisions"] = played.collisions
    for key in ("no_ris", "fixed", "belief"):
        row |= statistic(f"over_{key}_percent", gain_percent, values["map"], values[key], rng=rng)
    return row | distances(config, sweep.scenes, seed, spot)


def distances(config: Config, scenes: int, seed: int, spot: parking.Spot) -> dict[str, float]:
    """How far the map's best place lies from the AP and from the best fixed place as scenes begin."""
    simulator = Simulator(independent(config), [CellId(seed, scene) for scene in range(scenes)])
    places, _ = best_places(simulator)
    from_ap = np.linalg.norm(places - simulator.ap_position[:, :2], axis=1)
    from_fixed = np.linalg.norm(places - spot[:2], axis=1)
    return {
        "fixed_x_m": spot.x_m,
        "fixed_y_m": spot.y_m,
        "best_from_ap_m": float(np.median(from_ap)),
        "best_from_fixed_m": float(np.median(from_fixed)),
        "far_from_both_percent": 100 * float(np.mean((from_ap > FAR_M) & (from_fixed > FAR_M))),
    }


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    cells = []
    for row in table.to_dict("records"):
        rivals = [
            f"{row[f'{key}_mbps']:,.0f}, {row[f'{key}_qos_percent']:.0f} %"
            for key in ("no_ris", "fixed", "belief", "map")
        ]
        gains = [spread(row, f"over_{key}_percent", "+.1f") for key in ("fixed", "belief")]
        cells.append(
            [row["regime"], number(row["seed"], ".0f"), *rivals, *gains, number(row["far_from_both_percent"], ".0f")]
        )
    heading = (
        "regime",
        "seed",
        "no RIS",
        "best fixed",
        "believes in sight",
        "knows the walls",
        "over fixed [%]",
        "over belief [%]",
    )
    return markdown_table((*heading, "far [%]"), cells)


if __name__ == "__main__":
    command(Sweep, __doc__, main)
