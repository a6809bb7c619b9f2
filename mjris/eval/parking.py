"""The best-placed fixed RIS: the one place and heading that are best over many scenes, none of which is judged."""

import math
from typing import NamedTuple

import numpy as np

from mjris.config import Config
from mjris.eval.playing import independent, play
from mjris.eval.policies import Policy, fixed_ris
from mjris.simulation.outlook import node_values
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId, Purpose, word

NAME = "best-placed fixed RIS"

_KEY = 1
"""Of the stream that the scenes' seed is from, beside that of other searches."""
_SCENES = 64
"""Scenes that are searched, stepped together."""
_EPISODES = 4
"""How often people are placed anew in each of them, for what the radio map promises."""
_HEADINGS_DEG = tuple(range(0, 360, 20))
_PLAYED = 8
"""Spots that are played."""
_APART_M = 1.0
"""They are so far apart: the radio map errs alike for neighbours."""


class Spot(NamedTuple):
    """Where a RIS stays."""

    x_m: float
    y_m: float
    heading_deg: float
    """Where its panel faces, counter-clockwise from +x."""


def parked_at(spot: Spot) -> Policy:
    """Closed-form phases and powers from a spot, with people placed as if the rover had always stood there."""
    world = {"pan": "locked", "start_m": (spot.x_m, spot.y_m), "start_heading_deg": spot.heading_deg}
    return fixed_ris(NAME, world)


def best_spot(config: Config, seed: int) -> Spot:
    """The spot that gives closed forms the most in eq. (R) over scenes that are not those of `seed`.

    Of the nodes of `World.paths` and 18 headings, those are played that the radio map promises most for.
    """
    seed = search_seed(seed)
    spots = promising(config, seed)
    values = [play(config, parked_at(spot), _SCENES, seed).value_bps.mean() for spot in spots]
    return spots[int(np.argmax(values))]


def search_seed(seed: int) -> int:
    """What the scenes of a search follow from, where judged scenes follow from `seed`."""
    return word(seed, Purpose.SEARCH, _KEY)


def promising(config: Config, seed: int) -> list[Spot]:
    """Spots that the radio map promises most for in the mean over scenes that follow from `seed`, best first.

    A place counts with its best heading, and only where the rover gets to it in every scene's furniture.
    """
    simulator = Simulator(independent(config), [CellId(seed, scene) for scene in range(_SCENES)])
    nodes = simulator.terrain.paths.nodes
    promised = np.zeros((len(_HEADINGS_DEG), len(nodes)))
    for _ in range(_EPISODES):
        promised += [node_values(simulator, math.radians(heading)).mean(0) for heading in _HEADINGS_DEG]
        simulator.reset()
    value, heading = promised.max(0), promised.argmax(0)
    chosen: list[int] = []
    for node in np.argsort(-value)[: np.isfinite(value).sum()].tolist():
        if all(math.dist(nodes[node], nodes[other]) >= _APART_M for other in chosen):
            chosen.append(node)
    best = chosen[:_PLAYED]
    return [Spot(x, y, _HEADINGS_DEG[heading[node]]) for node, (x, y) in zip(best, nodes[best].tolist(), strict=True)]
