"""What elements that can be built cost: closed forms and the best phases and powers known, in the very same scenes.

python scripts/hardware_table.py [--scenes S] [--slots T] [--seed S] [--out FILE.csv]

The `office` preset with 8 × 8 elements, one thing taken away from the ideal surface in every row. Closed forms drive to
the goal of the radio map, the best known is that of the planner's drive. Losses are against the ideal surface's row,
with 95 % intervals over scenes. Prints the table as Markdown, and draws it beside the .csv file, as .png.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from reference_table import Scenes, command, finish, markdown_table, number, spread, statistic

from mjris.config import Config, Hardware, preset
from mjris.eval.intervals import gain_percent
from mjris.eval.playing import Played, play
from mjris.eval.policies import planner, reference_controls
from mjris.simulation.streams import Purpose, generator

POLICIES = ("closed forms", "best known")


@dataclass(frozen=True, kw_only=True)
class HardwareStudy(Scenes):
    """How much is simulated."""

    scenes: int = 50
    slots: int = 40
    """Slots of every scene's episode."""


def main(study: HardwareStudy) -> None:
    """Play, print, write, draw."""
    rng = generator(study.seed, Purpose.RESAMPLING)
    rows, ideal = [], {}
    for name, hardware in surfaces():
        played = {policy: judged(study, hardware, policy) for policy in POLICIES}
        ideal = ideal or played
        rows += [row(name, policy, played[policy], ideal[policy], rng) for policy in POLICIES]
    table = pd.DataFrame(rows)
    finish(table, markdown, study.out)
    if study.out is not None:
        draw(table, study.out.with_suffix(".png"))


def surfaces() -> Iterator[tuple[str, Hardware]]:
    """Ideal elements first, then what keeps them from it, one by one."""
    yield "ideal", Hardware()
    for bits in (1, 2, 3):
        yield f"{bits} bit" + "s" * (bits > 1), Hardware(phase_bits=bits)
    yield "amplitude down to 0.2", Hardware(least_amplitude=0.2)
    for noise_deg in (20.0, 40.0):
        yield f"phase noise {noise_deg:g}°", Hardware(phase_noise_deg=noise_deg)
    for share in (0.1, 0.3):
        yield f"{share:.0%} dead", Hardware(dead_share=share)


def judged(study: HardwareStudy, hardware: Hardware, policy: str) -> Played:
    """A policy on all scenes with elements of one kind."""
    chosen = reference_controls() if policy == "closed forms" else planner(study.seed)
    return play(config(study, hardware), chosen, study.scenes, study.seed)


def config(study: HardwareStudy, hardware: Hardware) -> Config:
    """The config of a row."""
    made = preset("classic")
    radio = replace(made.radio, panel_rows=8, panel_cols=8, surface=hardware)
    return replace(made, radio=radio, task=replace(made.task, slots=study.slots))


def row(
    name: str, policy: str, played: Played, ideal: Played, rng: np.random.Generator
) -> dict[str, str | int | float]:
    """Scores of a policy with one kind of elements, and what it has less than with ideal ones."""
    return {
        "elements": name,
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
            row["elements"],
            row["policy"],
            spread(row, "penalised_mbps", ".3f"),
            spread(row, "over_ideal_percent", "+.1f"),
            number(row["qos_percent"], ".1f"),
        ]
        for row in table.to_dict("records")
    ]
    return markdown_table(("elements", "phases and powers", "penalised [Mb/s]", "over ideal [%]", "QoS [%]"), cells)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Penalised rate and QoS over the kinds of elements, as a PNG file."""
    names = list(dict.fromkeys(table["elements"]))
    scores = ("penalised_mbps", "penalised sum rate [Mb/s]"), ("qos_percent", "slots with QoS for all [%]")
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(7.2, 2.6), dpi=300, layout="constrained")
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
