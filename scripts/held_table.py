"""What the RIS gains where phases and powers are held while people walk, by how often in a slot they are set anew.

python scripts/held_table.py [--scenes S] [--seed S] [--out FILE.csv]

The closed forms of the `office` preset drive, set phases and split powers; the gain is over no RIS in the same slots,
whose powers are set as often. Intervals are over scenes. Prints the table as Markdown.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from reference_table import FloatArray, Scenes, command, finish, markdown_table, number, spread, statistic

from mjris.config import preset
from mjris.eval.intervals import gain_percent
from mjris.planning.radio_map import penalised
from mjris.simulation.streams import CellId, Purpose, generator
from mjris.simulation.task import Task

UPDATES = (0, 1, 2, 5, 10)
"""Updates in a slot; 0 stands for phases that are always those of the moment."""


@dataclass(frozen=True, kw_only=True)
class HeldStudy(Scenes):
    """What scenes are simulated, for episodes of 100 slots."""

    scenes: int = 100
    """Random scenes, stepped together."""


def main(study: HeldStudy) -> None:
    """Play, print, write."""
    rng = generator(study.seed, Purpose.RESAMPLING)
    rows = []
    for updates in UPDATES:
        rate, value, bare = play(updates, study)
        rows.append(
            {
                "updates": updates,
                "scenes": study.scenes,
                "penalised_mbps": value.mean() / 1e6,
                **statistic("sum_rate_mbps", lambda mean: mean / 1e6, rate, rng=rng),
                **statistic("gain_percent", gain_percent, rate, bare, rng=rng),
            }
        )
    finish(pd.DataFrame(rows), markdown, study.out)


def play(updates: int, study: HeldStudy) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum rates with and without the QoS penalty of the closed forms, and without RIS, by scene [S] [bit/s]."""
    config = preset("classic")
    task_config = replace(config.task, phase_updates_per_slot=updates)
    config = replace(config, task=task_config, radio=replace(config.radio, difference_factor=1.0))
    task = Task(config, [CellId(study.seed, scene) for scene in range(study.scenes)])
    still = np.zeros((study.scenes, task.action_size))
    rate, value, bare = np.zeros((3, study.scenes))
    for _ in range(task_config.slots):
        slot = task.step(still).slot
        rate += slot.rates_bps.sum(-1) / task_config.slots
        value += penalised(slot.rates_bps, task_config.qos_bps, task_config.qos_penalty) / task_config.slots
        bare += slot.bare_rates_bps.sum(-1) / task_config.slots
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
    command(HeldStudy, __doc__, main)
