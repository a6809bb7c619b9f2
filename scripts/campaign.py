"""A long adversarial campaign: rovers are driven at furniture, walls and people, and every promise is checked.

python scripts/campaign.py [--kinematic-slots N] [--wheels-slots N] [--corner-slots N] [--cells E] [--seed S]

Ends with status 1 if a rover penetrated anything, left its room or was too fast. Beside what the simulator says of
itself, the rovers' ways are held against the layouts' bricks and walls by geometry of this script's own.
"""

import itertools
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mjris.config import Config, from_dict
from mjris.simulation.constraints import within_room
from mjris.world.layout import Layout, load_layout
from mjris.world.office import HULL_FLOOR_GAP_M, PERSON_RADIUS_M, hull_height
from mjris.world.world import World

FloatArray = NDArray[np.floating]

DRIVERS = ("random", "jerky", "waypoint", "rammer", "hunter")
"""random: anywhere within reach; jerky: full speed, another way every slot; waypoint: to one random place after the
other; rammer: straight into furniture and walls; hunter: after the nearest person."""
LAYOUTS = ("office", "open", "clinic")
FURNISHINGS = ((0.0, 4), (0.0, 12), (0.3, 12))
"""Layout jitter [m] and number of people."""
CORNERS = {
    "slowest tick": {"world": {"ticks_per_slot": 1, "max_speed_mps": 0.38, "bumper_m": 0.415, "clearance_m": 0.415}},
    "long slots": {"world": {"slot_s": 20, "ticks_per_slot": 200, "bumper_m": 0.1, "clearance_m": 0.1}},
    "smallest bumper": {
        "world": {"ticks_per_slot": 100, "max_speed_mps": 0.2, "bumper_m": 0.02, "clearance_m": 0.02},
    },
    "tallest mast": {"world": {"panel_height_m": 2.2, "bumper_m": 0.099, "clearance_m": 0.099}},
    "widest panel": {"world": {"layout": "open"}, "radio": {"panel_cols": 24}},
    "highest speed": {
        "world": {
            "max_speed_mps": 1.9,
            "ticks_per_slot": 200,
            "panel_height_m": 0.6,
            "bumper_m": 0.46,
            "clearance_m": 0.46,
        },
    },
    "fast and tall": {
        "world": {
            "max_speed_mps": 1.5,
            "ticks_per_slot": 50,
            "panel_height_m": 2.2,
            "bumper_m": 0.39,
            "clearance_m": 0.39,
        },
    },
    "shortest physics step": {"world": {"ticks_per_slot": 100, "timestep_s": 0.002, "bumper_m": 0.055}},
    "fast walkers": {"world": {"walk_scale_m": 3}},
}
"""Corners of what configs allow: what differs from a campaign's config, which has 12 people in the office. Bumper and
clearance are hardly more than the config asks for."""
RESTART_SLOTS = 20
"""Rovers begin at another place, with other targets, this often."""
_CANDIDATES = 200
_CLOSEST = 10
_ARRIVED_M = 0.3
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """How long the campaign is."""

    kinematic_slots: int = 100_000
    """Slots of the kinematic drive, all cells together."""
    wheels_slots: int = 10_000
    """Slots of the wheels drive, all cells together."""
    corner_slots: int = 2000
    """Slots of each drive at each corner of what configs allow."""
    cells: int = 40
    """Cells that are stepped together; the drivers take turns over them."""
    seed: int = 0
    """The whole campaign follows from it."""


@dataclass(frozen=True)
class Leg:
    """A batch of cells with one drive, layout, jitter and number of people."""

    drive: str
    layout: str
    jitter_m: float
    num_users: int
    cells: int
    slots: int
    """Slots of every cell."""
    seed: int
    corner: str = "within"
    """What of `CORNERS` it has, or that it is within them all."""

    @property
    def config(self) -> Config:
        """Its config."""
        world = {"drive": self.drive, "layout": self.layout, "num_users": self.num_users}
        change = CORNERS.get(self.corner, {})
        world |= {"layout_jitter_m": self.jitter_m} | change.get("world", {})
        return from_dict({"world": world, "radio": change.get("radio", {})})


@dataclass(frozen=True)
class Log:
    """What happened in T slots of E cells, all [T, E]."""

    penetrations: NDArray[np.int64]
    clearance_m: FloatArray
    speed_mps: FloatArray
    inside: NDArray[np.bool_]
    speed_limit_mps: float

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Slots that broke a promise [T, E]."""
        too_fast = self.speed_mps > self.speed_limit_mps * (1 + _ROUNDING)
        return (self.penetrations > 0) | (self.clearance_m <= 0) | ~self.inside | too_fast


def main(campaign: Campaign) -> int:
    """Play the campaign and print its table; 1 if a promise broke."""
    legs = plan(campaign)
    tables, incidents = [], []
    with Progress(transient=True) as progress:
        bar = progress.add_task("slots", total=sum(leg.cells * leg.slots for leg in legs))
        for leg in legs:
            progress.update(bar, description=f"{leg.drive} · {leg.layout} · {leg.num_users} people · {leg.corner}")
            log = play(leg, lambda cells=leg.cells: progress.advance(bar, cells))
            tables.append(summary(leg, log))
            incidents += [f"{leg}: cell {cell}, slot {slot}" for slot, cell in np.argwhere(log.broken)]
    console = Console()
    console.print(shown(pd.concat(tables)))
    for incident in incidents:
        console.print(incident)
    return int(bool(incidents))


def plan(campaign: Campaign) -> list[Leg]:
    """The legs of a campaign.

    Every drive in every layout and furnishing, with equal numbers of slots for a drive, and then at every corner.
    """
    scenes = list(itertools.product(LAYOUTS, FURNISHINGS))
    totals = {"kinematic": campaign.kinematic_slots, "wheels": campaign.wheels_slots}
    within = [
        Leg(
            drive,
            layout,
            *furnishing,
            cells=campaign.cells,
            slots=math.ceil(total / (len(scenes) * campaign.cells)),
            seed=campaign.seed + 1000 * index,
        )
        for drive, total in totals.items()
        if total
        for index, (layout, furnishing) in enumerate(scenes)
    ]
    each = math.ceil(campaign.corner_slots / campaign.cells)
    corners = [
        Leg(drive, "office", 0.0, 12, campaign.cells, each, campaign.seed + 1000 * (len(scenes) + index), corner)
        for drive in totals
        if each
        for index, corner in enumerate(CORNERS)
    ]
    return within + corners


def play(leg: Leg, on_slot: Callable[[], None]) -> Log:
    """Drive a leg; `on_slot` is called after every slot."""
    config = leg.config
    generators = [np.random.default_rng([leg.seed, cell]) for cell in range(leg.cells)]
    made = World(config, load_layout(config.world.layout), generators)
    made.place(np.arange(leg.cells), generators)
    rng = np.random.default_rng(leg.seed)
    solid = Solid([made.office(e).layout for e in range(leg.cells)], hull_height(config))
    drivers = Drivers(made, solid, rng)
    # The kinematic drive goes straight, so that its whole way can be checked; of the wheels' way only the end.
    samples = np.linspace(0, 1, 6) if leg.drive == "kinematic" else np.ones(1)
    slots = []
    for slot in range(leg.slots):
        if slot % RESTART_SLOTS == 0:
            drivers.restart()
        before = made.fleet.xy
        shape = (leg.cells, leg.num_users)
        motion = made.move(
            drivers.commands(), rng.rayleigh(made.config.walk_scale_m, shape), rng.uniform(0, 2 * math.pi, shape)
        )
        after = made.fleet.xy
        way = before[:, None] + samples[:, None] * (after - before)[:, None]
        clearance = np.minimum(motion.clearance_m, solid.distance(way).min(-1) - made.hull_radius_m)
        speed = np.linalg.norm(after - before, axis=-1) / made.config.slot_s
        slots.append((motion.collisions, clearance, speed, within_room(after, made.hull_radius_m, solid.room_m)))
        on_slot()
    return Log(*(np.stack(part) for part in zip(*slots, strict=True)), speed_limit_mps=made.config.max_speed_mps)


class Drivers:
    """Commands for E cells; cell e has driver e modulo their number."""

    def __init__(self, world: World, solid: "Solid", rng: np.random.Generator):
        self._world = world
        self._rng = rng
        self._solid = solid
        self._room_m = solid.room_m
        self._reach_m = world.config.max_speed_mps * world.config.slot_s
        self._angle = np.zeros(world.num_cells)
        self._waypoint = np.zeros((world.num_cells, 2))
        self._victim = np.zeros((world.num_cells, 2))

    def restart(self) -> None:
        """Give the rammers new targets and put every rover at a free place near its cell's target, facing anywhere."""
        world, rng, cells = self._world, self._rng, np.arange(self._world.num_cells)
        self._waypoint = rng.uniform(0, self._room_m)
        bricks = self._solid.centre
        brick = bricks[cells, rng.integers(bricks.shape[1], size=len(cells))]
        side = rng.integers(2, size=(len(cells), 2)) * self._room_m
        wall = np.where(np.eye(2, dtype=bool)[rng.integers(2, size=len(cells))], side, self._waypoint)
        self._victim = np.where(rng.random((len(cells), 1)) < 0.3, wall, brick + rng.normal(0, 0.2, brick.shape))
        places = rng.uniform(0, self._room_m[:, None], (len(cells), _CANDIDATES, 2))
        free = self._solid.distance(places) > world.hull_radius_m + world.config.bumper_m
        people = np.linalg.norm(places[:, :, None] - world.crowd.xy[:, None], axis=-1).min(-1)
        free &= people > world.hull_radius_m + PERSON_RADIUS_M + world.config.clearance_m
        distance = np.where(free, np.linalg.norm(places - self._victim[:, None], axis=-1), np.inf)
        choice = np.argsort(distance, axis=-1)[cells, rng.integers(_CLOSEST, size=len(cells))]
        chosen = cells[free[cells, choice]]
        world.fleet.place(chosen, places[chosen, choice[chosen]], rng.uniform(-math.pi, math.pi, len(chosen)))

    def commands(self) -> FloatArray:
        """Displacements of the next slot [E, 2] [m]."""
        rng, cells = self._rng, np.arange(self._world.num_cells)
        here, people = self._world.fleet.xy, self._world.crowd.xy
        anywhere = unit(rng.uniform(0, 2 * math.pi, len(cells))) * np.sqrt(rng.random((len(cells), 1)))
        self._angle += rng.uniform(math.pi / 2, 3 * math.pi / 2, len(cells))
        arrived = np.linalg.norm(self._waypoint - here, axis=-1, keepdims=True) < _ARRIVED_M
        self._waypoint = np.where(arrived, rng.uniform(0, self._room_m), self._waypoint)
        nearest = people[cells, np.linalg.norm(people - here[:, None], axis=-1).argmin(-1)]
        ways = {
            "random": anywhere,
            "jerky": unit(self._angle),
            "waypoint": toward(here, self._waypoint),
            "rammer": toward(here, self._victim),
            "hunter": toward(here, nearest),
        }
        return self._reach_m * np.stack([ways[name] for name in DRIVERS])[cells % len(DRIVERS), cells]


class Solid:
    """Walls, and the B bricks that the hull can meet, in E cells with layouts of the same furniture."""

    def __init__(self, layouts: list[Layout], hull_height_m: float):
        self.room_m = np.array([layout.room.size[:2] for layout in layouts])
        """[E, 2] [m]"""
        centre, half, axis = zip(*(bricks_at_hull(layout, hull_height_m) for layout in layouts), strict=True)
        self.centre = np.stack(centre)
        """[E, B, 2] [m]"""
        self._half, self._axis = np.stack(half), np.stack(axis)

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from points [E, S, 2] [m] to the nearest brick or wall, [E, S] [m]; zero or less inside."""
        away = points[:, :, None] - self.centre[:, None]
        (x, y), (c, s) = np.moveaxis(away, -1, 0), np.moveaxis(self._axis, -1, 0)[:, :, None]
        local = np.stack([c * x + s * y, c * y - s * x], -1)
        beyond = np.maximum(np.abs(local) - self._half[:, None], 0)
        walls = np.minimum(points, self.room_m[:, None] - points).min(-1)
        return np.minimum(np.linalg.norm(beyond, axis=-1).min(-1), walls)


def bricks_at_hull(layout: Layout, hull_height_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middles, half sides and axes of the bricks that stand between the hull's bottom and top, [B, 2] each."""
    centre, half, axis = [], [], []
    for obstacle in layout.obstacles:
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        for brick in obstacle.bricks:
            (x, y, z), (length, width, height) = brick.at, brick.size
            if z - height / 2 < hull_height_m and z + height / 2 > HULL_FLOOR_GAP_M:
                centre.append([obstacle.position[0] + c * x - s * y, obstacle.position[1] + s * x + c * y])
                half.append([length / 2, width / 2])
                axis.append([c, s])
    return np.array(centre), np.array(half), np.array(axis)


def unit(angle: FloatArray) -> FloatArray:
    """Unit vectors [E, 2]."""
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def toward(here: FloatArray, there: FloatArray) -> FloatArray:
    """Unit vectors from `here` to `there`, both [E, 2]."""
    way = there - here
    return way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)


def summary(leg: Leg, log: Log) -> pd.DataFrame:
    """One row a driver."""
    driver = np.arange(leg.cells) % len(DRIVERS)
    return pd.DataFrame(
        {
            "drive": leg.drive,
            "layout": leg.layout,
            "corner": leg.corner,
            "driver": name,
            "slots": log.broken[:, driver == index].size,
            "penetrations": log.penetrations[:, driver == index].sum(),
            "clearance": log.clearance_m[:, driver == index].min(initial=math.inf),
            "speed": log.speed_mps[:, driver == index].max(initial=0),
            "outside": (~log.inside[:, driver == index]).sum(),
        }
        for index, name in enumerate(DRIVERS)
    )


def shown(summaries: pd.DataFrame) -> Table:
    """The rows by drive, and of each drive by layout and driver, and then by corner."""
    headings = ("slots", "penetrations", "least\nclearance\n\\[m]", "highest\nspeed\n\\[m/s]", "out of\nroom")
    table = Table("drive", "part", *headings)
    for column in table.columns[2:]:
        column.justify = "right"
    for drive, rows in summaries.groupby("drive"):
        at = rows["corner"] != "within"
        groups = [
            ("all", rows),
            *rows[~at].groupby("layout"),
            *rows[~at].groupby("driver"),
            *rows[at].groupby("corner"),
        ]
        for name, group in groups:
            table.add_row(
                str(drive),
                str(name),
                f"{group['slots'].sum():,}",
                str(group["penetrations"].sum()),
                f"{group['clearance'].min():.4f}",
                f"{group['speed'].max():.4f}",
                str(group["outside"].sum()),
            )
        table.add_section()
    return table


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Campaign, description=__doc__)))
