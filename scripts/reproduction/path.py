"""The way of the robot: the trained agents of both presets in one held-out scene, over the radio map."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from judging import train
from matplotlib import rc_context
from matplotlib.figure import Figure

from mjris.config import Config
from mjris.eval.floormap import FloorMap, floor_map
from mjris.learn.policy import load_policy, without_noise
from mjris.show.rollout import Rollout, record
from mjris.show.trajectory import HEIGHTS_LABEL, draw_trajectory
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task
from reproduction.curves import PRESETS, Scale, base
from reproduction.drawing import STYLE, WIDTH_IN
from reproduction.results import SCENE_SEED

_SLOTS = 30
"""Slots that are shown: time enough to cross the office."""


def draw_path(scale: Scale, runs: Path, path: Path) -> None:
    """Write the ways of the first seed's agents, over the worth of every place as the episode begins."""
    configs = {name: replace(base(name, scale), seed=scale.seeds[0]) for name in PRESETS}
    folders = train(list(configs.values()), runs)
    scene = shadowed_scene(configs["classic"], scale.scenes)
    with rc_context({**STYLE, "hatch.linewidth": 0.4, "font.size": 6}):
        sheet = Figure(figsize=(WIDTH_IN, 3.6), dpi=300, layout="compressed")
        panels = sheet.subplots(1, len(PRESETS), sharey=True)
        bars: dict[str, Any] = {"shrink": 0.8, "aspect": 18, "location": "bottom", "pad": 0.02}
        handles = []
        drives = [
            drive(config, folder, scene, min(_SLOTS, scale.slots))
            for config, folder in zip(configs.values(), folders, strict=True)
        ]
        most = max(np.nanmax(floor.place_gain_bps) for *_, floor in drives) / 1e6
        for axes, name, (rollout, task, floor) in zip(panels, configs, drives, strict=True):
            office = task.simulator.world.office(0)
            x, y, _ = office.layout.room.size
            worth = axes.imshow(
                floor.place_gain_bps / 1e6,
                origin="lower",
                extent=(0, x, 0, y),
                cmap="Greens",
                vmin=0,
                vmax=most,
                zorder=0,
            )
            heights, handles = draw_trajectory(axes, office, rollout)
            axes.set_title(f"{name} preset", fontsize=6)
            if axes is panels[0]:
                sheet.colorbar(heights, ax=axes, label=HEIGHTS_LABEL, **bars)
            else:
                axes.set_ylabel("")
                sheet.colorbar(worth, ax=axes, label="worth of a place [Mb/s]", **bars)
        sheet.legend(handles=handles, loc="outside upper center", ncols=4, handlelength=1.6, columnspacing=1.0)
        sheet.savefig(path)


def shadowed_scene(config: Config, scenes: int) -> int:
    """The number of the first of the held-out scenes in which most users begin without line of sight to the AP."""
    task = _scenes(config, range(scenes))
    return int((task.simulator.scene.blockers[:, : config.world.num_users] > 0).sum(1).argmax())


def drive(config: Config, run: Path, scene: int, slots: int) -> tuple[Rollout, Task, FloorMap]:
    """An episode of a run's agent, and the floor as it begins."""
    agent, task = load_policy(run), _scenes(config, [scene])
    floor = floor_map(task.simulator, resolution_m=0.5)
    rollout = record(task, without_noise(agent), slots, SCENE_SEED)
    return rollout, task, floor


def _scenes(config: Config, numbers: Sequence[int]) -> Task:
    """Scenes that agents are judged on, as `eval.evaluate.play` begins them."""
    radio = replace(config.radio, difference_factor=1.0)
    return Task(replace(config, radio=radio), [CellId(SCENE_SEED, number) for number in numbers])
