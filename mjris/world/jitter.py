"""Similar, not equal: a layout whose furniture stands a little elsewhere in every cell."""

import math
from dataclasses import replace

import numpy as np

from mjris.config import Config, ConfigError
from mjris.world.fit import check_fit
from mjris.world.layout import Layout
from mjris.world.layout_checks import boxes_of, check_layout, is_wall

_TRIES = 3


def jittered(layout: Layout, config: Config, rng: np.random.Generator) -> Layout:
    """The layout with all furniture moved by up to `world.layout_jitter_m`, uniformly over the disc.

    Walls and the panels that hang on them stay, as does what would meet a wall or something else, or leave the rover
    too little room.
    """
    distance_m, boxes = config.world.layout_jitter_m, boxes_of(layout)
    walls = {int(boxes.owner[b]) for b in range(len(boxes.owner)) if is_wall(boxes, b)}
    for index in sorted({*range(len(layout.obstacles))} - walls):
        for _ in range(_TRIES):
            radius, angle = distance_m * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
            moved = _moved(layout, index, radius * math.cos(angle), radius * math.sin(angle))
            try:
                check_layout(moved)
                check_fit(config, moved)
            except ConfigError:
                continue
            layout = moved
            break
    return layout


def _moved(layout: Layout, index: int, dx: float, dy: float) -> Layout:
    obstacle = layout.obstacles[index]
    x, y = obstacle.position
    others = layout.obstacles
    return replace(
        layout, obstacles=(*others[:index], replace(obstacle, position=(x + dx, y + dy)), *others[index + 1 :])
    )
