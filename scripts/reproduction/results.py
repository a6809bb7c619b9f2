"""From curves to a table: missing agents trained, all judged on the same scenes, with the planner and the bound."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from judging import Job, Scores, agent_scores, each, kept, rival_file, rival_scores, train
from points import point
from reference_table import Study, driving, markdown_table, number, spread

from mjris.config import Config
from mjris.learn.study import run_folder
from mjris.simulation.streams import Purpose, generator
from reproduction.curves import PARKED, Curve, Scale

SCENE_SEED = 10_000
"""Of the held-out scenes, which all agents are judged on."""
PLANNER, BOUND = "planner", "upper bound"
_KEY = ["figure", "preset", "curve", "scheme", "x"]


def measure(curves: Sequence[Curve], scale: Scale, runs: Path) -> pd.DataFrame:
    """A row for every curve, point and seed, and for the rivals that are drawn beside it.

    Columns: figure, preset, curve, scheme, x (episodes where the curve is one over episodes), seed, and what
    `judging.agent_scores` gives, arrays over the scenes among it; rivals have no seed, and the planner and the bound
    have rates only.
    """
    train([own for curve in curves for own in _seeded(curve, scale)], runs)
    agents = [
        (curve, seed, episode, run_folder(own, runs))
        for curve in curves
        for seed, own in zip(scale.seeds, _seeded(curve, scale), strict=True)
        for episode in curve.judged(scale)
    ]
    # Averaged agents are the same in all cells, so that the first one's is judged.
    jobs: list[Job] = [(agent_scores, run, episode, 0, scale.scenes, SCENE_SEED) for _, _, episode, run in agents]
    study = Study(scenes=scale.scenes, slots=scale.slots, every=scale.every, seed=SCENE_SEED)
    bounds: list[tuple[Curve, Job]] = [
        (curve, (rivals, curve.config, study, runs)) for curve in curves if curve.bounded
    ]
    parked: list[tuple[Curve, Job]] = [
        (curve, (rival_scores, curve.config, PARKED, runs, scale.scenes, SCENE_SEED))
        for curve in curves
        if curve.parked
    ]
    all_jobs = [*jobs, *(job for _, job in bounds), *(job for _, job in parked)]
    scores = dict(zip(all_jobs, each(all_jobs), strict=True))
    rows = [
        _key(curve, episode) | {"seed": seed} | scores[job]
        for (curve, seed, episode, _), job in zip(agents, jobs, strict=True)
    ]
    rows += [_key(curve, float("nan")) | {"curve": PARKED} | scores[job] for curve, job in parked]
    for curve, job in bounds:
        said = {name: scores[job][name] for name in ("bare_mbps", "judged")}
        for name in (PLANNER, BOUND):
            rows.append(_key(curve, float("nan")) | {"curve": name, "sum_rate_mbps": scores[job][name]} | said)
    return pd.DataFrame(rows).drop_duplicates([*_KEY, "seed"], ignore_index=True)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row for every point of every curve, with intervals over seeds and scenes: `points.point`."""
    rng = generator(SCENE_SEED, Purpose.RESAMPLING)
    groups: Any = table.groupby(_KEY, sort=False, dropna=False)
    return pd.DataFrame([dict(zip(_KEY, key, strict=True)) | point(rows, rng) for key, rows in groups])


def shares(points: pd.DataFrame) -> str:
    """Who gets the sum rate of each curve over episodes at its end, as Markdown; of rows of `summary`."""
    heading = ("preset", "curve", "sum rate [Mb/s]", "all with QoS [%]", "users with QoS [%]", "5th percentile [kb/s]")
    cells = []
    groups: Any = points.groupby(["preset", "curve", "scheme"], sort=False)
    for (name, curve, scheme), rows in groups:
        row: dict[Any, Any] = rows.sort_values("x").iloc[-1].to_dict()
        if np.isnan(row["jain"]):  # the planner and the bound, whose users nobody counted
            continue
        counts = [number(row[score], ".1f") for score in ("user_qos_percent", "user_rate_p5_kbps")]
        counts += [number(row["jain"], ".2f"), number(row["superposing_percent"], ".1f")]
        words = f"{curve}, {str(scheme).upper()}"
        cells.append(
            [f"`{name}`", words, spread(row, "sum_rate_mbps", ".2f"), spread(row, "qos_percent", ".1f"), *counts]
        )
    return markdown_table((*heading, "Jain", "superposing [%]"), cells)


def rivals(config: Config, study: Study, runs: Path) -> Scores:
    """Sum rates [S] [Mb/s] of the planner, of the upper bound for its channels and of no RIS, in some of the slots."""
    # What is trained, and what a curve takes from its agents, change neither of them.
    task = replace(config.task, ris="mobile", phases="learned")
    radio = replace(config.radio, difference_factor=1.0, decoding_order="dynamic", oma_selection=False)
    config = replace(config, task=task, radio=radio)

    def judge() -> Scores:
        judged = driving(config, study, lambda: None)
        rates = {PLANNER: judged.sum_rate_bps, BOUND: judged.bound_bps, "bare_mbps": judged.bare_bps}
        return {name: rate / 1e6 for name, rate in rates.items()}

    return kept(rival_file(config, runs, f"bounded_{study.scenes}_{study.every}_{study.seed}"), judge)


def _seeded(curve: Curve, scale: Scale) -> list[Config]:
    return [replace(curve.config, seed=seed) for seed in scale.seeds]


def _key(curve: Curve, episode: float) -> dict[str, object]:
    x = episode if curve.x is None else curve.x
    return {"figure": curve.figure, "preset": curve.preset, "curve": curve.name, "scheme": curve.scheme, "x": x}
