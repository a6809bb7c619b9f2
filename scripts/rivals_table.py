"""What driving, superposition and the dynamic order add: closed forms against closed forms in the very same scenes.

python scripts/rivals_table.py [--scenes S] [--seed S] [--out FILE.csv]

The closed forms of the `office` preset drive, set phases and split powers; each row takes one thing away. Gains are of
the mobile RIS over the row, of the sum rate and of the one with the QoS penalty of eq. (R), with 95 % intervals over
scenes, episodes of 100 slots. Prints the table as Markdown.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
from reference_table import Scenes, command, finish, markdown_table, spread, statistic

from mjris.config import preset
from mjris.eval import parking
from mjris.eval.intervals import gain_percent
from mjris.eval.playing import Played, play
from mjris.eval.policies import Policy, fixed_ris, reference_controls, reference_oma
from mjris.simulation.streams import Purpose, generator


def main(study: Scenes) -> None:
    """Play, print, write."""
    config, rng = preset("classic"), generator(study.seed, Purpose.RESAMPLING)
    mobile = play(config, reference_controls(), study.scenes, study.seed)
    rows = [
        row(policy.name, mobile, play(config, policy, study.scenes, study.seed), rng) for policy in rivals(study.seed)
    ]
    finish(pd.DataFrame(rows), markdown, study.out)


def rivals(seed: int) -> Iterator[Policy]:
    """Closed forms with one thing taken away; places are searched in scenes that do not follow from `seed`."""
    mobile = reference_controls()
    yield fixed_ris()
    yield parking.parked_at(parking.best_spot(preset("classic"), seed))
    yield from reference_oma()
    yield replace(mobile, name="static order", changes={**mobile.changes, "radio": {"decoding_order": "static"}})


def row(name: str, mobile: Played, rival: Played, rng: np.random.Generator) -> dict[str, str | int | float]:
    """The sum rate of a rival, and what the mobile RIS has more."""
    return {
        "rival": name,
        "scenes": len(rival.sum_rate_bps),
        **statistic("sum_rate_mbps", lambda mean: mean / 1e6, rival.sum_rate_bps, rng=rng),
        **statistic("mobile_over_it_percent", gain_percent, mobile.sum_rate_bps, rival.sum_rate_bps, rng=rng),
        **statistic("penalised_over_it_percent", gain_percent, mobile.value_bps, rival.value_bps, rng=rng),
    }


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    cells = [
        [
            row["rival"],
            spread(row, "sum_rate_mbps", ".3f"),
            *(spread(row, f"{what}_over_it_percent", "+.1f") for what in ("mobile", "penalised")),
        ]
        for row in table.to_dict("records")
    ]
    heading = "closed forms", "sum rate [Mb/s]", "mobile RIS over it [%]", "penalised, over it [%]"
    return markdown_table(heading, cells)


if __name__ == "__main__":
    command(Scenes, __doc__, main)
