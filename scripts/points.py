"""From judgements, a row for each agent with arrays over scenes, to points of tables and figures, with intervals."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from reference_table import statistic

from mjris.eval.intervals import gain_percent

FloatArray = NDArray[np.floating]

_SPREAD = ("sum_rate_mbps", "penalised_mbps", "qos_percent")
"""Scores that have an interval of their own."""


def point(rows: pd.DataFrame, rng: np.random.Generator) -> dict[str, Any]:
    """What the agents of one point did, of one seed each or several: means over seeds and scenes, with 95 % intervals.

    Every score is a mean. NAME_low and NAME_high are its interval, over seeds and scenes together; NAME_by_seed has
    the means of the seeds, in their order. Gains are over what the very same slots give without RIS. Columns
    that the rows do not have, or have no scenes for, are left out.
    """
    scores = [name for name in rows if isinstance(rows[name].iloc[0], np.ndarray)]
    found: dict[str, Any] = {"seeds": rows["seed"].nunique(), "scenes": by_scene(rows, scores[0]).shape[1]}
    for name in scores:
        values = by_scene(rows, name)
        found |= statistic(name, lambda mean: mean, values, rng=rng) if name in _SPREAD else {name: values.mean()}
        if name in _SPREAD[:2]:
            found[f"{name}_by_seed"] = " ".join(f"{mean:.4f}" for mean in values.mean(1))
    found |= statistic(
        "gain_percent", gain_percent, by_scene(rows, "sum_rate_mbps"), by_scene(rows, "bare_mbps"), rng=rng
    )
    if "collisions" in rows:
        found |= {"collisions": rows["collisions"].sum(min_count=1), "clearance_m": rows["clearance_m"].min()}
    return found | {name: _commits(rows[name]) for name in ("trained", "judged") if name in rows}


def by_scene(rows: pd.DataFrame, score: str) -> FloatArray:
    """A score of every seed in every scene [R, S]: means over the cells of a seed, and one row for who has no seed."""
    groups = rows.groupby("seed", dropna=False)[score]
    return np.stack([np.mean(np.stack(cells.to_list()), 0) for _, cells in groups])


def _commits(labels: Any) -> str:
    return " ".join(sorted(set(labels.dropna())))
