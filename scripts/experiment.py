"""Train what an experiment file describes over its seeds, judge it on held-out scenes, write a table and a figure.

python scripts/experiment.py docs/experiments/NAME.toml ... [--runs FOLDER] [--scenes S] [--scene-seed S]

NAME.csv and NAME.png go beside the file. Finished runs and judgements are kept in the folder of runs, so that an
interrupted or extended experiment goes on where it was; the table names the commits that trained and judged. Intervals
are over seeds and scenes together. Prints what docs/learning.md shows, as Markdown.
"""

import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tyro
from judging import RIVALS, agent_scores, each, rival_scores, train
from points import by_scene, point
from reference_table import markdown_table, number, spread, statistic

from mjris.config import Config, ConfigError, from_dict, preset
from mjris.learn.study import run_folder
from mjris.simulation.streams import Purpose, generator


@dataclass(frozen=True, kw_only=True)
class Study:
    """What to do."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Experiment files."""
    runs: Path = Path("runs/experiments")
    """Where runs and judgements are kept."""
    scenes: int = 64
    """Held-out scenes."""
    scene_seed: int = 10_000
    """Their seed."""


@dataclass(frozen=True)
class Experiment:
    """One file."""

    name: str
    what: str
    config: Config
    """With the seed 0."""
    seeds: Sequence[int]
    judged: Sequence[int]
    """Episodes after which the agents are judged."""

    @property
    def configs(self) -> list[Config]:
        """One a seed."""
        return [replace(self.config, seed=seed) for seed in self.seeds]


def main(study: Study) -> None:
    """Train, judge, write."""
    experiments = [read(path) for path in study.files]
    configs = [config for experiment in experiments for config in experiment.configs]
    train(configs, study.runs)
    for path, experiment in zip(study.files, experiments, strict=True):
        table = summary(judge(experiment, study), study.scene_seed)
        table.to_csv(path.with_suffix(".csv"), index=False, float_format="%.6g")
        draw(experiment, table, path.with_suffix(".png"))
        print(f"\n{experiment.name}: {experiment.what}\n\n{markdown(table)}")


def read(path: Path) -> Experiment:
    """An experiment from its file. Raises `ConfigError` for what is missing or wrong in it."""
    try:
        data = tomllib.loads(path.read_text())
        what, seeds, judged = (data[key] for key in ("what", "seeds", "judged"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    except KeyError as error:
        raise ConfigError(f"{path}: {error.args[0]} is missing") from None
    config = from_dict(_merged(preset(data.get("preset", "classic")).to_dict(), data.get("config", {})), str(path))
    federation = config.federation
    for episode in judged:
        if episode % federation.round_episodes or not 0 < episode <= federation.episodes:
            raise ConfigError(f"{path}: judged: {episode} is not allowed: it must be the last episode of a round")
    return Experiment(path.stem, what, config, seeds, judged)


def judge(experiment: Experiment, study: Study) -> pd.DataFrame:
    """A row for every rival, and for every seed, cell and episode to be judged, with arrays over the scenes.

    Averaged agents are the same in all cells, so that one of them is judged.
    """
    config = experiment.config
    cells = 1 if config.federation.averaging else config.federation.num_cells
    agents = [
        (run_folder(own, study.runs), episode, cell)
        for own in experiment.configs
        for episode in experiment.judged
        for cell in range(cells)
    ]
    scenes = study.scenes, study.scene_seed
    scores = each(
        [
            *((rival_scores, config, name, study.runs, *scenes) for name in RIVALS),
            *((agent_scores, *agent, *scenes) for agent in agents),
        ]
    )
    rivals = [{"policy": name} | row for name, row in zip(RIVALS, scores[: len(RIVALS)], strict=True)]
    judged = [
        {"policy": "learned", "seed": int(seed), "cell": cell, "episode": episode} | row
        for (_, episode, cell), seed, row in zip(
            agents,
            np.repeat(experiment.seeds, len(agents) // len(experiment.seeds)),
            scores[len(RIVALS) :],
            strict=True,
        )
    ]
    return pd.DataFrame(rivals + judged)


def summary(judged: pd.DataFrame, scene_seed: int) -> pd.DataFrame:
    """A row for every rival, and for every episode of the agents: its `point`, and shares of what the planner has."""
    rng = generator(scene_seed, Purpose.RESAMPLING)
    planner: Any = judged[judged["policy"] == RIVALS[0]]
    rows = []
    groups: Any = judged.groupby(["policy", "episode"], sort=False, dropna=False)
    for (policy, episode), group in groups:
        row = {"policy": policy, "episode": episode} | point(group, rng)
        for score in ("sum_rate_mbps", "penalised_mbps"):
            share = f"{score.removesuffix('_mbps')}_percent_of_planner"
            row |= statistic(share, _percent, by_scene(group, score), by_scene(planner, score), rng=rng)
        rows.append(row)
    return pd.DataFrame(rows)


def markdown(table: pd.DataFrame) -> str:
    """Rivals, and the agents by episode: means over seeds and scenes with 95 % intervals, and the worst seed."""
    heading = ("", "sum rate [Mb/s]", "% of planner", "penalised [Mb/s]", "% of planner", "QoS [%]", "collisions")
    cells = []
    for row in table.to_dict("records"):
        learned = row["policy"] == "learned"
        values = []
        for score in ("sum_rate", "penalised"):
            share = spread(row, f"{score}_percent_of_planner", ".1f")
            if learned:
                worst = min(float(mean) for mean in row[f"{score}_mbps_by_seed"].split())
                share += f", worst seed {number(100 * worst / table[f'{score}_mbps'].iloc[0], '.1f')}"
            values += [spread(row, f"{score}_mbps", ".3f"), share]
        name = f"learned, episode {row['episode']:g}" if learned else row["policy"]
        cells.append([name, *values, spread(row, "qos_percent", ".1f"), f"{row['collisions']:.0f}"])
    return markdown_table(heading, cells)


def draw(experiment: Experiment, table: pd.DataFrame, path: Path) -> None:
    """Penalised sum rate over the episodes, of every seed and of all with a 95 % interval, and the rivals' as lines."""
    from matplotlib.figure import Figure

    from mjris.show.palette import STOPS

    figure = Figure(figsize=(5.4, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for style, name in zip(("-", "--", "-.", ":", (0, (1, 4))), RIVALS, strict=True):
        value = table.loc[table.policy == name, "penalised_mbps"].item()
        axes.axhline(value, color="#444444", linestyle=style, linewidth=1, label=name)
    learned: Any = table.query("policy == 'learned'").set_index("episode")
    axes.fill_between(
        learned.index, learned["penalised_mbps_low"], learned["penalised_mbps_high"], color=STOPS, alpha=0.2
    )
    seeds = [[float(mean) for mean in words.split()] for words in learned["penalised_mbps_by_seed"]]
    axes.plot(learned.index, seeds, color=STOPS, linewidth=0.5, alpha=0.6)
    label = "learned, mean of seeds"
    axes.plot(learned.index, learned["penalised_mbps"], color=STOPS, linewidth=2, marker="o", label=label)
    axes.set(xlabel="episodes of training", ylabel="sum rate with QoS penalty [Mb/s]", title=experiment.name)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    figure.savefig(path, dpi=150)


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    inner = {
        key: _merged(base.get(key, {}), value) if isinstance(value, Mapping) else value
        for key, value in changes.items()
    }
    return {**base, **inner}


def _percent(mean: Any, reference: Any) -> Any:
    return 100 * mean / reference


if __name__ == "__main__":
    try:
        main(tyro.cli(Study, description=__doc__))
    except ConfigError as error:
        sys.exit(str(error))
