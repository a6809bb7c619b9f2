"""Train what an experiment file describes over its seeds, judge it on held-out scenes, write a table and a figure.

python scripts/experiment.py docs/experiments/NAME.toml ... [--runs FOLDER] [--scenes S] [--scene-seed S]

NAME.csv and NAME.png go beside the file. Finished runs and judgements are kept in the folder of runs, so that an
interrupted or extended experiment goes on where it was. Prints what docs/learning.md shows, as Markdown.
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
from judging import RIVALS, agent_scores, commit, each, rival_scores, train
from reference_table import markdown_table, number

from mjris.config import Config, ConfigError, from_dict, preset
from mjris.learn.study import run_folder
from mjris.show.curves import student_interval


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
        table = judge(experiment, study)
        table.insert(0, "commit", commit())
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
    config = from_dict(_merged(preset(data.get("preset", "office")).to_dict(), data.get("config", {})), str(path))
    federation = config.federation
    for episode in judged:
        if episode % federation.round_episodes or not 0 < episode <= federation.episodes:
            raise ConfigError(f"{path}: judged: {episode} is not allowed: it must be the last episode of a round")
    return Experiment(path.stem, what, config, seeds, judged)


def judge(experiment: Experiment, study: Study) -> pd.DataFrame:
    """A row for every rival, and for every seed, cell and episode to be judged.

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
    table = pd.DataFrame(rivals + judged)
    for column in ("sum_rate_mbps", "penalised_mbps"):
        table[f"{column.split('_')[0]}_percent_of_planner"] = 100 * table[column] / table[column].iloc[0]
    return table


def markdown(table: pd.DataFrame) -> str:
    """Rivals, and the agents by episode: means over seeds with 95 % t-intervals, and the worst seed."""
    heading = ("", "sum rate [Mb/s]", "% of planner", "penalised [Mb/s]", "% of planner", "QoS [%]", "collisions")
    columns = ("sum_rate_mbps", "sum_percent_of_planner", "penalised_mbps", "penalised_percent_of_planner")
    cells = [
        [row["policy"], *_values(row, columns), number(row["qos_percent"], ".1f"), str(int(row["collisions"]))]
        for row in table.query("policy != 'learned'").to_dict("records")
    ]
    for episode, group in table.query("policy == 'learned'").groupby("episode"):
        seeds: Any = group.groupby("seed").mean(numeric_only=True)
        shares = [_interval(seeds[column], ".3f" if "mbps" in column else ".1f") for column in columns]
        worst = [number(seeds[column].min(), ".1f") for column in columns]
        shares[1] += f", worst {worst[1]}"
        shares[3] += f", worst {worst[3]}"
        qos = _interval(seeds["qos_percent"], ".1f")
        cells.append([f"learned, episode {episode:g}", *shares, qos, number(seeds["collisions"].sum(), ".0f")])
    return markdown_table(heading, cells)


def draw(experiment: Experiment, table: pd.DataFrame, path: Path) -> None:
    """Penalised sum rate of the agents over the episodes, with a 95 % interval over seeds, and the rivals' as lines."""
    from matplotlib.figure import Figure

    from mjris.show.palette import STOPS

    figure = Figure(figsize=(5.4, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for style, name in zip(("-", "--", "-.", ":"), RIVALS, strict=True):
        value = table.loc[table.policy == name, "penalised_mbps"].item()
        axes.axhline(value, color="#444444", linestyle=style, linewidth=1, label=name)
    learned: Any = table.query("policy == 'learned'").pivot_table("penalised_mbps", "episode", "seed")
    axes.fill_between(learned.index, *student_interval(learned.to_numpy().T), color=STOPS, alpha=0.2)
    axes.plot(learned.index, learned, color=STOPS, linewidth=0.5, alpha=0.6)
    axes.plot(learned.index, learned.mean(axis=1), color=STOPS, linewidth=2, marker="o", label="learned, mean of seeds")
    axes.set(xlabel="episodes of training", ylabel="sum rate with QoS penalty [Mb/s]", title=experiment.name)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    figure.savefig(path, dpi=150)


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    inner = {
        key: _merged(base.get(key, {}), value) if isinstance(value, Mapping) else value
        for key, value in changes.items()
    }
    return {**base, **inner}


def _values(row: Mapping[Any, Any], columns: Sequence[str]) -> list[str]:
    return [number(row[column], ".3f" if "mbps" in column else ".1f") for column in columns]


def _interval(values: Any, form: str) -> str:
    """Mean and 95 % t-interval over seeds."""
    half = student_interval(values.to_numpy())[1] - values.mean() if len(values) > 1 else np.nan
    return f"{number(values.mean(), form)} ± {number(half, form)}"


if __name__ == "__main__":
    try:
        main(tyro.cli(Study, description=__doc__))
    except ConfigError as error:
        sys.exit(str(error))
