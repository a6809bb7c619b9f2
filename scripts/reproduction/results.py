"""From curves to a table: missing agents trained, all judged on the same scenes, with the planner and the bound."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
from judging import Job, Scores, agent_scores, each, kept, rival_file, train
from reference_table import Study, driving

from mjris.config import Config
from mjris.learn.study import run_folder
from mjris.show.curves import read_metric
from reproduction.curves import Curve, Scale

SCENE_SEED = 10_000
"""Of the held-out scenes, which all agents are judged on."""
PLANNER, BOUND = "planner", "upper bound"


def measure(curves: Sequence[Curve], scale: Scale, runs: Path) -> pd.DataFrame:
    """A row for every curve, point and seed, and for the planner and the upper bound of every point.

    Columns: figure, preset, curve, scheme, x (episodes where the curve is one over episodes), seed, and what
    `judging.agent_scores` gives; the planner and the bound have a sum rate [Mb/s] only, and no seed.
    """
    train([own for curve in curves for own in _seeded(curve, scale)], runs)
    agents = [
        (curve, seed, episode, run_folder(own, runs))
        for curve in curves
        for seed, own in zip(scale.seeds, _seeded(curve, scale), strict=True)
        for episode in curve.judged(scale)
    ]
    study = Study(scenes=scale.scenes, slots=scale.slots, every=scale.every, seed=SCENE_SEED)
    bounded = [curve for curve in curves if curve.bounded]
    # Averaged agents are the same in all cells, so that the first one's is judged.
    jobs: list[Job] = [(agent_scores, run, episode, 0, scale.scenes, SCENE_SEED) for _, _, episode, run in agents]
    scores = each([*jobs, *((rivals, curve.config, study, runs) for curve in bounded)])
    rows = [
        _key(curve, episode) | {"seed": seed} | row
        for (curve, seed, episode, _), row in zip(agents, scores[: len(agents)], strict=True)
    ]
    for curve, best in zip(bounded, scores[len(agents) :], strict=True):
        rows += [_key(curve, float("nan")) | {"curve": name, "sum_rate_mbps": best[name]} for name in (PLANNER, BOUND)]
    return pd.DataFrame(rows).drop_duplicates(ignore_index=True)


def training(curves: Sequence[Curve], scale: Scale, runs: Path) -> pd.DataFrame:
    """Sum rates [Mb/s] in training, with its exploration, of curves over episodes: a row for each episode and seed."""
    rows = []
    for curve in curves:
        if curve.x is None:
            episodes, rates = read_metric([run_folder(own, runs) for own in _seeded(curve, scale)], "sum_rate_mbps")
            for seed, values in zip(scale.seeds, rates, strict=True):
                rows += [
                    _key(curve, episode) | {"seed": seed, "sum_rate_mbps": rate}
                    for episode, rate in zip(episodes, values, strict=True)
                ]
    return pd.DataFrame(rows)


def rivals(config: Config, study: Study, runs: Path) -> Scores:
    """Sum rates [Mb/s] of the planner, and of the upper bound for its channels, in some slots of the same scenes."""
    # What is trained, and what a curve takes from its agents, change neither of them.
    task = replace(config.task, ris="mobile", phases="learned")
    radio = replace(config.radio, difference_factor=1.0, decoding_order="dynamic")
    config = replace(config, task=task, radio=radio)

    def judge() -> Scores:
        judged = driving(config, study, lambda: None)
        return {PLANNER: judged.sum_rate_bps.mean() / 1e6, BOUND: judged.bound_bps.mean() / 1e6}

    return kept(rival_file(config, runs, f"bounded_{study.scenes}_{study.every}_{study.seed}"), judge)


def _seeded(curve: Curve, scale: Scale) -> list[Config]:
    return [replace(curve.config, seed=seed) for seed in scale.seeds]


def _key(curve: Curve, episode: float) -> dict[str, object]:
    x = episode if curve.x is None else curve.x
    return {"figure": curve.figure, "preset": curve.preset, "curve": curve.name, "scheme": curve.scheme, "x": x}
