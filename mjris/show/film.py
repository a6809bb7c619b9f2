"""One episode of one policy as a video, a still and a drawing of the rover's way."""

from pathlib import Path

import mediapy
from rich.console import Console
from rich.progress import Progress

from mjris.config import Config
from mjris.show.rollout import Act, record
from mjris.show.trajectory import plot_trajectory
from mjris.show.video import snapshot, write_video
from mjris.simulation.task import Task


def film(config: Config, act: Act, folder: Path, slots: int, seed: int) -> None:
    """Play `slots` slots of the scene that follows from `seed`, and write video.mp4, frame.png and trajectory.png.

    Raises `ConfigError` where nothing can be rendered.
    """
    folder.mkdir(parents=True, exist_ok=True)
    task = Task(config)
    rollout = record(task, act, slots, seed)
    office = task.simulator.world.office(0)
    with Progress() as progress:
        bar = progress.add_task("filming", total=rollout.frames)
        write_video(
            config,
            office,
            rollout,
            folder / "video.mp4",
            progress=lambda done, _total: progress.update(bar, completed=done),
        )
    mediapy.write_image(folder / "frame.png", snapshot(config, office, rollout, rollout.frames // 2))
    plot_trajectory(office, rollout, folder / "trajectory.png")
    console = Console()
    for name in ("video.mp4", "frame.png", "trajectory.png"):
        console.print(folder / name, highlight=False, soft_wrap=True)
