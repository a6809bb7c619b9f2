"""The physical side of E cells on one MuJoCo batch: offices, rovers, people and lines of sight."""

from collections.abc import Callable

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from mjris.config import Config
from mjris.world.drives import make_fleet
from mjris.world.fit import check_fit, rover_start
from mjris.world.footprints import footprints
from mjris.world.jitter import jittered
from mjris.world.layout import Layout
from mjris.world.office import (
    HULL_FLOOR_GAP_M,
    MAST_RADIUS_M,
    PERSON_HEIGHT_M,
    Boxes,
    Office,
    build,
    hull_height,
    hull_radius,
)
from mjris.world.panels import board_half_m, panel_sizes
from mjris.world.people import Crowd
from mjris.world.placement import Placement
from mjris.world.rover import Motion
from mjris.world.sight import Sight

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int64]


class World:
    """E offices stepped together. Cell e has furniture of its own if the layout is jittered."""

    def __init__(self, config: Config, layout: Layout, generators: list[np.random.Generator]):
        """`generators` [E] place each cell's furniture.

        Raises `ConfigError` where rover, panel, antennas or people do not fit into the layout.
        """
        check_fit(config, layout)
        self.config = config.world
        self.num_cells = len(generators)
        jitter = config.world.layout_jitter_m
        layouts = [jittered(layout, config, rng) for rng in generators] if jitter > 0 else [layout]
        self.start = np.array(rover_start(config, layout))
        """Where rovers start [2] [m]."""
        self.panel_sizes = panel_sizes(config.radio, layout)
        """Rows and columns of all panels [S, 2], the rover's first."""
        self._fixed_centres = np.array([panel.at for panel in layout.ris]).reshape(-1, 3)
        self._fixed_headings = np.array([panel.facing for panel in layout.ris])
        self._placement = Placement(config, layouts, self.start)
        self.offices = [build(config, each) for each in layouts]
        office = self.offices[0]
        # The straight drive asks for little at a time: waking threads costs more than they save.
        self.batch = Batch(office.model, self.num_cells, nthread=1 if config.world.drive == "kinematic" else 0)
        if jitter > 0:
            self.batch.set_models([each.model for each in self.offices])
        self.hull_radius_m = hull_radius(config)
        self.hull_solid = footprints(self.offices, HULL_FLOOR_GAP_M, hull_height(config))
        """What the hull can bump into but people."""
        self._body_solid = footprints(self.offices, 0.0, PERSON_HEIGHT_M)
        self.crowd = Crowd(config.world, office, self.batch, self._body_solid)
        self.fleet = make_fleet(config.world, office, self.batch, self.hull_solid, self.crowd)
        self.losses_in_db = config.radio.obstacles == "materials"
        """Whether links lose what gets lost in things, by their materials, and not by how many there are."""
        moving = (
            self.crowd.walkers.xy if config.world.body_blockage else None,
            self._rover_boxes if config.world.rover_blockage else None,
        )
        self.sight = Sight(self.offices, *moving)
        self.losses = Sight(self.offices, *moving, in_db=True) if self.losses_in_db else self.sight
        """What links lose by; the very `sight` where things are counted."""
        self._board_half_m = np.array(board_half_m(config.radio, config.radio.panel_rows, config.radio.panel_cols))
        self.on_tick: Callable[[], None] | None = None
        """Called after every tick, for those who film."""

    def office(self, cell: int) -> Office:
        """The office of a cell."""
        return self.offices[cell % len(self.offices)]

    def panel_centres(self) -> FloatArray:
        """Middles of the panels [E, S, 3] [m], the rover's first."""
        centres = np.empty((self.num_cells, 1 + len(self._fixed_centres), 3))
        centres[:, 0] = _raised(self.fleet.xy, self.config.panel_height_m)
        centres[:, 1:] = self._fixed_centres
        return centres

    def _rover_boxes(self) -> Boxes:
        """Board and mast of every rover's panel, one body, with a leading axis of cells."""
        board, mast = self._board_half_m, np.array([MAST_RADIUS_M, MAST_RADIUS_M, self.config.panel_height_m / 2])
        centre = np.repeat(self.panel_centres()[:, :1], 2, 1)
        centre[:, 1, 2] /= 2
        facing = self.fleet.panel_heading
        axis = np.repeat(np.stack([np.cos(facing), np.sin(facing)], -1)[:, None], 2, 1)
        half = np.broadcast_to([board, mast], centre.shape)
        return Boxes(centre, half, axis, np.zeros(centre.shape[:2], np.int64), np.ones(centre.shape[:2]))

    def panel_headings(self) -> FloatArray:
        """Directions that the panels face [E, S] [rad]."""
        headings = np.empty((self.num_cells, 1 + len(self._fixed_headings)))
        headings[:, 0], headings[:, 1:] = self.fleet.panel_heading, self._fixed_headings
        return headings

    def receivers(self) -> FloatArray:
        """The users' receivers [E, K, 3] [m]."""
        return _raised(self.crowd.xy, self.config.user_height_m)

    def place(self, cells: IntArray, generators: list[np.random.Generator]) -> None:
        """Put rovers of `cells` [n] at the start, facing anywhere unless told, and people anywhere free."""
        # Drawn even where it is told, so that people stand alike.
        heading = np.array([rng.uniform(-np.pi, np.pi) for rng in generators])
        if self.config.start_heading_deg is not None:
            heading[:] = np.radians(self.config.start_heading_deg)
        self.fleet.place(cells, np.broadcast_to(self.start, (len(cells), 2)), heading)
        places = [self._placement.draw(int(e), rng) for e, rng in zip(cells, generators, strict=True)]
        self.crowd.place(cells, np.stack(places))

    def move(
        self,
        displacement: FloatArray,
        distance: FloatArray,
        direction: FloatArray,
        on_tick: Callable[[], None] | None = None,
    ) -> Motion:
        """One slot: rovers move by `displacement` [E, 2] [m], people `distance` [m], `direction` [rad], both [E, K].

        `on_tick` is called after every tick, as `World.on_tick` is.
        """
        self.crowd.plan(distance, direction)
        listeners = [each for each in (on_tick, self.on_tick) if each is not None]

        def tell() -> None:
            for listener in listeners:
                listener()

        return self.fleet.move(displacement, tell if listeners else None)

    def clearance(self) -> FloatArray:
        """Distance between the rover's hull and the nearest furniture, wall or person [E] [m]."""
        return self.fleet.clearance()

    def free_share(self, start: FloatArray, end: FloatArray, keep_m: float) -> FloatArray:
        """Share of segments up to `keep_m` [m] from what the hull can bump into but people, [E, P].

        From `start` [E, P or 1, 2] to `end` [E, P, 2] [m]. It is inf where nothing is in the way.
        """
        return self.hull_solid.free_share(start, end, keep_m)


def _raised(xy: FloatArray, height_m: float) -> FloatArray:
    raised = np.full((*xy.shape[:-1], 3), height_m)
    raised[..., :2] = xy
    return raised
