"""Progress of a training run in the terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mjris.config import Config
from mjris.learn.federation import EpisodeMetrics
from mjris.learn.run import Report


@contextmanager
def progress_bar(config: Config) -> Iterator[Report]:
    """A bar over the episodes, to be passed to `train` as `report`."""
    columns = (
        TextColumn("episode"),
        MofNCompleteColumn(),
        BarColumn(),
        TextColumn("{task.description}"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns) as progress:
        task = progress.add_task("first round", total=config.federation.episodes)

        def report(metrics: list[EpisodeMetrics]) -> None:
            progress.update(task, completed=metrics[-1].episode, description=summary(metrics))

        yield report


def summary(metrics: list[EpisodeMetrics]) -> str:
    """A round in a few words: means over its episodes and cells, and all of its collisions."""
    rate = np.mean([row.sum_rate_mbps for row in metrics])
    qos = np.mean([row.qos_share for row in metrics])
    collisions = sum(row.collisions for row in metrics)
    return f"{rate:.3f} Mb/s · QoS {qos:.0%} · {collisions} collisions"
