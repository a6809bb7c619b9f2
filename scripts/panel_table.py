"""What the panel's element pattern and its pan joint are worth, with the RIS fixed and at the best placement.

python scripts/panel_table.py [--scenes S] [--slots T] [--every T] [--seed S] [--layout NAME] [--out FILE.csv]

All rows are the same scenes, with the best phases and powers known (NOMA). A locked panel faces where the rover happens
to face, at random, wherever it stands; a pan joint turns it toward the bisector of AP and users. The best placement is
that of reference_table.py. Prints the table as Markdown.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from reference_table import Judged, Study, command, finish, markdown_table, number, spread, standing, statistic
from rich.progress import Progress

from mjris.eval.intervals import gain_percent
from mjris.simulation.streams import Purpose, generator

PANELS = tuple(itertools.product(("isotropic", "cosine"), ("auto", "locked")))
"""Element pattern and pan."""


@dataclass(frozen=True, kw_only=True)
class PanelStudy(Study):
    """How much is simulated."""

    slots: int = 40
    """Slots of every scene's episode."""


def main(study: Study) -> None:
    """Play all panels, print the table and write it."""
    with Progress() as progress:
        bar = progress.add_task("slots", total=2 * len(PANELS) * study.judged)
        played = {panel: play(*panel, study, lambda: progress.advance(bar)) for panel in PANELS}
    rng = generator(study.seed, Purpose.RESAMPLING)
    finish(pd.DataFrame([row(*panel, cases, rng) for panel, cases in played.items()]), markdown, study.out)


def play(pattern: str, pan: str, study: Study, advance: Callable[[], None]) -> tuple[Judged, Judged, Judged]:
    """No RIS, the fixed RIS and the best placement with one panel; `advance` is called twice a judged slot."""
    config = study.config
    world, radio = replace(config.world, pan=pan), replace(config.radio, element_pattern=pattern)
    return standing(replace(config, world=world, radio=radio), study, advance)


def row(
    pattern: str, pan: str, cases: tuple[Judged, Judged, Judged], rng: np.random.Generator
) -> dict[str, str | int | float]:
    """Gains of the sum rate, and of the one with the QoS penalty, over no RIS; and shares of slots that meet QoS."""
    bare, *others = cases
    gains: dict[str, float] = {}
    for name, case in zip(("fixed", "placed"), others, strict=True):
        gains |= statistic(f"{name}_gain_percent", gain_percent, case.sum_rate_bps, bare.sum_rate_bps, rng=rng)
        gains |= statistic(f"{name}_value_gain_percent", gain_percent, case.value_bps, bare.value_bps, rng=rng)
    shares = [100 * case.qos_share.mean() for case in cases]
    met = dict(zip(("bare_qos_percent", "fixed_qos_percent", "placed_qos_percent"), shares, strict=True))
    return {"elements": pattern, "pan": pan, "scenes": len(bare.sum_rate_bps), **gains, **met}


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown; gains in %."""
    heading = (
        *("elements", "pan", "fixed: sum rate", "fixed: penalised", "best placement: sum rate"),
        *("best placement: penalised", "QoS met [%]"),
    )
    gains = [f"{case}_{what}percent" for case in ("fixed", "placed") for what in ("gain_", "value_gain_")]
    return markdown_table(
        heading,
        [
            [
                row["elements"],
                row["pan"],
                *(spread(row, gain, "+.1f") for gain in gains),
                ", ".join(number(row[f"{case}_qos_percent"], ".1f") for case in ("bare", "fixed", "placed")),
            ]
            for row in table.to_dict("records")
        ],
    )


if __name__ == "__main__":
    command(PanelStudy, __doc__, main)
