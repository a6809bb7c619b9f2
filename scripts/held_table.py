"""What the RIS gains where phases and powers are held while people walk, by how often in a slot they are set anew.

python scripts/held_table.py [--scenes S] [--slots T] [--seed S] [--out FILE.csv]

The closed forms of the `office` preset drive, set phases and split powers; the gain is over no RIS in the same slots,
whose powers are set as often. Intervals are over scenes. Prints the table as Markdown.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import tyro
from reference_table import finish, markdown_table, number, spread, statistic

from mjris.config import preset
from mjris.eval.intervals import gain_percent
from mjris.radiomap import penalised
from mjris.streams import CellId, Purpose, generator
from mjris.task import Task

UPDATES = (0, 1, 2, 5, 10)
"""Updates in a slot; 0 stands for phases that are always those of the moment."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How much is simulated."""

    scenes: int = 100
    """Random scenes, stepped together."""
    slots: int = 100
    """Slots of every scene's episode."""
    seed: int = 1_000_003
    """The scenes follow from this seed."""
    out: Path | None = None
    """Where the table goes as .csv as well."""


def main(options: Options) -> None:
    """Play, print, write."""
    rng = generator(options.seed, Purpose.RESAMPLING)
    rows = []
    for updates in UPDATES:
        rate, value, bare = play(updates, options)
        rows.append(
            {
                "updates": updates,
                "scenes": options.scenes,
                "penalised_mbps": value.mean() / 1e6,
                **statistic("sum_rate_mbps", lambda mean: mean / 1e6, rate, rng=rng),
                **statistic("gain_percent", gain_percent, rate, bare, rng=rng),
            }
        )
    finish(pd.DataFrame(rows), markdown, options.out)


def play(updates: int, options: Options) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum rates with and without the QoS penalty of the closed forms, and without RIS, by scene [S] [bit/s]."""
    config = preset("office")
    task_config = replace(config.task, phase_updates_per_slot=updates)
    config = replace(config, task=task_config, radio=replace(config.radio, difference_factor=1.0))
    task = Task(config, [CellId(options.seed, scene) for scene in range(options.scenes)])
    still = np.zeros((options.scenes, task.action_size))
    rate, value, bare = np.zeros((3, options.scenes))
    for _ in range(options.slots):
        slot = task.step(still).slot
        rate += slot.rates_bps.sum(-1) / options.slots
        value += penalised(slot.rates_bps, task_config.qos_bps, task_config.qos_penalty) / options.slots
        bare += slot.bare_rates_bps.sum(-1) / options.slots
    return rate, value, bare


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    cells = [
        [
            "always" if row["updates"] == 0 else str(row["updates"]),
            spread(row, "sum_rate_mbps", ".3f"),
            spread(row, "gain_percent", "+.1f"),
            number(row["penalised_mbps"], ".3f"),
        ]
        for row in table.to_dict("records")
    ]
    return markdown_table(("updates a slot", "sum rate [Mb/s]", "over no RIS [%]", "penalised [Mb/s]"), cells)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
