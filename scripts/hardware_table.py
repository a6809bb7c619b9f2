"""What surfaces that can be built, and knowing less, cost: closed forms and the best known, in the very same scenes.

python scripts/hardware_table.py [--scenes S] [--slots T] [--seed S] [--out FILE.csv]

The `office` preset with one thing taken away from it in every row. Closed forms drive to the goal of the radio map,
with its phases by ascent; the best known is that of the planner's drive. Both know what the row lets them know.
Losses are against the first row, with 95 % intervals over scenes. Prints the table as Markdown, and draws it beside the
.csv file, as .png.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from reference_table import Scenes, command, finish, markdown_table, number, spread, statistic

from mjris.config import Hardware, Knowledge, preset
from mjris.eval.intervals import gain_percent
from mjris.eval.playing import Played, play
from mjris.eval.policies import planner, reference_controls
from mjris.simulation.streams import Purpose, generator

Changes = Mapping[str, Mapping[str, Any]]

POLICIES = ("closed forms", "best known")


@dataclass(frozen=True, kw_only=True)
class HardwareStudy(Scenes):
    """How much is simulated."""

    scenes: int = 50
    slots: int = 30
    """Slots of every scene's episode."""


def main(study: HardwareStudy) -> None:
    """Play, print, write, draw."""
    rng = generator(study.seed, Purpose.RESAMPLING)
    rows, ideal = [], {}
    for name, changes in cases():
        played = {policy: judged(study, changes, policy) for policy in POLICIES}
        ideal = ideal or played
        rows += [row(name, policy, played[policy], ideal[policy], rng) for policy in POLICIES]
    table = pd.DataFrame(rows)
    finish(table, markdown, study.out)
    if study.out is not None:
        draw(table, study.out.with_suffix(".png"))


def cases() -> Iterator[tuple[str, Changes]]:
    """The ideal first, then what keeps from it, one by one: fields of the config by section."""
    yield "ideal", {}
    for bits in (1, 2, 3):
        yield f"{bits} bit" + "s" * (bits > 1), surface(Hardware(phase_bits=bits))
    yield "amplitude down to 0.2", surface(Hardware(least_amplitude=0.2))
    for noise_deg in (20.0, 40.0):
        yield f"phase noise {noise_deg:g}°", surface(Hardware(phase_noise_deg=noise_deg))
    for share in (0.1, 0.3):
        yield f"{share:.0%} dead", surface(Hardware(dead_share=share))
    for nmse_db in (-20.0, -10.0):
        yield f"CSI error {nmse_db:g} dB", known(Knowledge(nmse_db=nmse_db))
    for age_ms in (2.0, 10.0):
        yield f"CSI {age_ms:g} ms old", known(Knowledge(age_s=age_ms / 1e3))
    yield "pilots of 0.25 ms an element", known(Knowledge(pilot_s=0.25e-3))
    yield "places ± 0.5 m", known(Knowledge(position_error_m=0.5))
    yield "places alone", known(Knowledge(source="positions"))
    yield "people in the way", {"world": {"body_blockage": True}}
    yield "rover in the way", {"world": {"rover_blockage": True}}
    yield "materials", {"radio": {"obstacles": "materials"}}


def surface(made: Hardware) -> Changes:
    """With such a surface."""
    return {"radio": {"surface": made}}


def known(what: Knowledge) -> Changes:
    """With such knowledge."""
    return {"radio": {"knowledge": what}}


def judged(study: HardwareStudy, changes: Changes, policy: str) -> Played:
    """A policy on all scenes in one case."""
    chosen = reference_controls() if policy == "closed forms" else planner(study.seed)
    made = preset("office")
    made = replace(made, task=replace(made.task, slots=study.slots))
    made = replace(made, **{name: replace(getattr(made, name), **fields) for name, fields in changes.items()})
    return play(made, chosen, study.scenes, study.seed)


def row(
    name: str, policy: str, played: Played, ideal: Played, rng: np.random.Generator
) -> dict[str, str | int | float]:
    """Scores of a policy in one case, and what it has less than in the ideal one."""
    return {
        "case": name,
        "policy": policy,
        "scenes": len(played.value_bps),
        **statistic("penalised_mbps", lambda mean: mean / 1e6, played.value_bps, rng=rng),
        **statistic("over_ideal_percent", gain_percent, played.value_bps, ideal.value_bps, rng=rng),
        **statistic("qos_percent", lambda mean: 100 * mean, played.qos_share, rng=rng),
    }


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    cells = [
        [
            row["case"],
            row["policy"],
            spread(row, "penalised_mbps", ".3f"),
            spread(row, "over_ideal_percent", "+.1f"),
            number(row["qos_percent"], ".1f"),
        ]
        for row in table.to_dict("records")
    ]
    return markdown_table(("case", "phases and powers", "penalised [Mb/s]", "over ideal [%]", "QoS [%]"), cells)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Penalised rate and QoS in every case, as a PNG file."""
    names = list(dict.fromkeys(table["case"]))
    scores = ("penalised_mbps", "penalised sum rate [Mb/s]"), ("qos_percent", "slots with QoS for all [%]")
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(7.2, 4.2), dpi=300, layout="constrained")
        for axes, (score, label) in zip(figure.subplots(1, 2, sharey=True), scores, strict=True):
            for place, (policy, colour) in enumerate(zip(POLICIES, ("#0072b2", "#e69f00"), strict=True)):
                own = table[table["policy"] == policy]
                low, high = own[score] - own[f"{score}_low"], own[f"{score}_high"] - own[score]
                at = np.arange(len(names)) + 0.2 * (2 * place - 1)
                axes.errorbar(own[score], at, xerr=[low, high], fmt="o", ms=3, lw=1, color=colour, label=policy)
            axes.set(xlabel=label, ylim=(len(names) - 0.5, -0.5))
            axes.set_yticks(range(len(names)), names)
            axes.grid(axis="x", lw=0.3)
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
        figure.savefig(path)


if __name__ == "__main__":
    command(HardwareStudy, __doc__, main)
