"""The simulator: E cells stepped together once a slot, from motion over sight and channels to rates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.compiled import compiled
from mjris.config import Config
from mjris.constraints import Constraints, evaluate
from mjris.radio import access, alignment, channel, links, propagation, serving
from mjris.streams import CellId, Streams, first_cells
from mjris.world.layout import load_layout
from mjris.world.world import World

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Scene:
    """What a slot begins with, in E cells with K users; links are AP–users, RIS–users, AP–RIS."""

    rover_xy: FloatArray
    """[E, 2] [m]"""
    rover_heading: FloatArray
    """[E] [rad]"""
    panel_heading: FloatArray
    """[E] [rad]"""
    users_xy: FloatArray
    """[E, K, 2] [m]"""
    blockers: IntArray
    """Obstacles on every link [E, 2K + 1]."""
    path_loss_db: FloatArray
    """Of every link [E, 2K + 1] [dB]."""
    channels: channel.Channels
    """h_d [E, K, M], G [E, N, M], h_r [E, K, N]."""


class Controls(NamedTuple):
    """What is decided in a slot, in E cells."""

    displacement_m: FloatArray
    """[E, 2] [m]"""
    phases_rad: FloatArray
    """[E, N] [rad]"""
    powers_w: FloatArray
    """[E, K] [W]"""
    pan_rad: FloatArray | None = None
    """By how much panels are turned from the bisector of AP and users [E] [rad]; None is not at all."""


@dataclass(frozen=True)
class Slot:
    """What a slot gave, and the scene that the next one begins with."""

    rates_bps: FloatArray
    """[E, K] [bit/s]"""
    qos_met: NDArray[np.bool_]
    """[E, K]"""
    bare_rates_bps: FloatArray | None
    """What the same slot gives without RIS under the reference powers [E, K] [bit/s], where the "gain" reward asks."""
    displacement_m: FloatArray
    """How far each rover got [E, 2] [m]."""
    clearance_m: FloatArray
    """Smallest distance between the hull and anything in the slot [E] [m]."""
    collisions: IntArray
    """Penetrating contacts seen in the slot [E]."""
    constraints: Constraints
    scene: Scene


class Simulator:
    """E cells of one config; a number stands for the first ones of a run with the config's seed.

    Cells of several runs, which differ in their seeds only, can be simulated together.
    """

    def __init__(self, config: Config, cells: int | Sequence[CellId] = 1):
        self.config = config
        self.cells = first_cells(config, cells) if isinstance(cells, int) else list(cells)
        num_cells = self.num_cells = len(self.cells)
        self._streams = Streams(self.cells)
        self.world = World(config, load_layout(config.world.layout), self._streams.furniture())
        radio = config.radio
        k, m, n = config.world.num_users, radio.num_antennas, radio.num_elements
        self.clusters = np.arange(k).reshape(radio.num_clusters, -1)
        """Users of every cluster, int [V, K/V]."""
        self.system = serving.System.of(radio, self.clusters, config.task.qos_bps)
        self.medium = links.Medium.of(radio)
        """What the compiled radio needs of the config."""
        self._spacing_m = radio.wavelength_m / 2
        self.ap_position = np.stack([self.world.office(e).ap_position for e in range(num_cells)])
        """Centres of the APs' arrays [E, 3] [m]."""
        self.room_m = np.array([self.world.office(e).layout.room.size[:2] for e in range(num_cells)])
        """Sizes of the rooms [E, 2] [m]."""
        axes = np.stack([self.world.office(e).ap_axis for e in range(num_cells)])
        self._antennas = channel.uniform_linear_array(self.ap_position, axes, m, self._spacing_m)
        self._own_person = np.array([*range(k), *range(k), -1])
        self._diffuse = np.zeros((num_cells, k * m + n * m + k * n), np.complex128)
        """Of h_d, G and h_r, [E, K M + N M + K N]."""
        self._order = np.zeros((num_cells, *self.clusters.shape), np.int64)
        self._fresh = np.ones(num_cells, np.bool_)
        self.resets, self.slots = 0, 0
        """How often cells began an episode, and the slots since."""
        self.scene: Scene
        self.reset()

    def seed(self, seed: int | Sequence[int]) -> None:
        """Restart the random streams of all cells, with one seed for all or one each; equal seeds share a stream."""
        self._streams.seed([seed] * self.num_cells if isinstance(seed, int) else seed)

    def reset(self, cells: IntArray | None = None) -> Scene:
        """Begin an episode in some cells, all by default."""
        cells = np.arange(self.num_cells) if cells is None else np.asarray(cells)
        if len(cells) < self.num_cells:
            self._streams.part(cells)
        self.world.place(cells, self._streams.own(cells))
        self._diffuse[cells] = self._draw_diffuse(cells)
        self._fresh[cells] = True
        self.resets, self.slots = self.resets + 1, 0
        return self.look()

    def random_phases(self) -> FloatArray:
        """Uniform phases from each cell's stream for them [E, N] [rad]."""
        return self._streams.phases(self.config.radio.num_elements)

    def step(
        self,
        displacement_m: FloatArray,
        phases_rad: FloatArray,
        powers_w: FloatArray,
        pan_rad: FloatArray | None = None,
    ) -> Slot:
        """Transmit over the present channel, then move and turn the panels: see `Controls`."""
        effective = self.effective_channel(phases_rad)
        order = self._decoding_order(effective, powers_w)
        rates = self.rates(effective, powers_w, order)
        bare = None
        if self.config.task.reward == "gain":
            _, bare = self.reference_powers(self.scene.channels.direct)
        before = self.world.fleet.xy
        steps = self._streams.steps(self.config.world.num_users, self.config.world.walk_scale_m)
        motion = self.world.move(displacement_m, *steps)
        self._face_panels(pan_rad)
        if self.config.radio.fading_memory < 1:
            fresh = self._draw_diffuse(np.arange(self.num_cells))
            self._diffuse = propagation.evolve(self._diffuse, fresh, self.config.radio.fading_memory)
        self.scene = self._observe()
        self.slots += 1
        return Slot(
            rates_bps=rates,
            qos_met=rates >= self.config.task.qos_bps,
            bare_rates_bps=bare,
            displacement_m=self.world.fleet.xy - before,
            clearance_m=motion.clearance_m,
            collisions=motion.collisions,
            constraints=evaluate(
                self.config,
                self.clusters,
                rover_xy=self.scene.rover_xy,
                hull_radius_m=self.world.hull_radius_m,
                room_m=self.room_m,
                effective=effective,
                powers_w=powers_w,
                order=order,
                rates_bps=rates,
                collisions=motion.collisions,
            ),
            scene=self.scene,
        )

    def effective_channel(self, phases_rad: FloatArray) -> ComplexArray:
        """H of the present scene for phases [E, N] [rad], without the RIS where the task has none: [E, K, M]."""
        if self.config.task.ris == "none":
            return self.scene.channels.direct
        response = channel.ris_response(phases_rad, self.config.radio.element_amplitude)
        return channel.effective_channel(self.scene.channels, response)

    def rates(self, effective: ComplexArray, powers_w: FloatArray, order: IntArray | None = None) -> FloatArray:
        """Rates [..., K] [bit/s] for effective channels [..., K, M] and powers [..., K] [W]."""
        return serving.rates(self.system, effective, powers_w, order)

    def reference_powers(
        self, effective: ComplexArray, wanted_bps: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Closed-form powers [..., K] [W] for channels [..., K, M], and their rates [..., K]: `serving.qos_or_sum`."""
        return serving.qos_or_sum(self.system, effective, wanted_bps)

    def split_powers(self, shares: FloatArray) -> FloatArray:
        """Powers [E, K] [W] for shares [E, K] in [0, 1] of what users may have: `control.split_powers`."""
        return serving.split_powers(self.system, shares)

    def reference_phases(self, weights: FloatArray | None = None) -> FloatArray:
        """Closed-form phases [E, N] [rad] for the present scene and user weights [E, K]: `qos_aligned_phases`."""
        channels = self.scene.channels
        channels = channels._replace(reflected=self.config.radio.element_amplitude * channels.reflected)
        return alignment.qos_aligned_phases(self.system, channels, weights)

    def _decoding_order(self, effective: ComplexArray, powers_w: FloatArray) -> IntArray | None:
        """None for the order of every slot; with the static order, that of the episode's first slot."""
        radio = self.config.radio
        if radio.decoding_order == "dynamic" or radio.scheme == "oma":
            return None
        if self._fresh.any():
            now = access.decoding_order(effective, powers_w, self.clusters, radio.noise_w)
            self._order[self._fresh] = now[self._fresh]
            self._fresh[:] = False
        return self._order

    def bisector(self, places: FloatArray) -> FloatArray:
        """Where panels at `places` [E, 2] [m] should face: the bisector of `aims`, [E] [rad]."""
        return _bisectors(self.aims(), places)

    def aims(self) -> FloatArray:
        """What panels face between [E, ., 2] [m]: users, or the room's middle for a fixed RIS, and, last, the AP."""
        users = self.room_m[:, None] / 2 if self.config.task.ris == "fixed" else self.world.crowd.xy
        return np.concatenate([users, self.ap_position[:, None, :2]], 1)

    def _face_panels(self, pan_rad: FloatArray | None = None) -> None:
        if self.config.world.pan == "locked":
            return
        if self.config.task.ris == "fixed":
            # Of where it was mounted, whatever little it has rolled since.
            direction = self.bisector(np.broadcast_to(self.world.start, (self.num_cells, 2)))
        else:
            direction = self.bisector(self.world.fleet.xy) + (0 if pan_rad is None else pan_rad)
        self.world.fleet.face(direction)

    def look(self) -> Scene:
        """See the scene anew after rovers or people were placed by hand, the panels turned to their bisectors."""
        self._face_panels()
        self.scene = self._observe()
        return self.scene

    def _observe(self) -> Scene:
        """Sight, path losses and channels at the present positions."""
        radio, world = self.config.radio, self.world
        panel, receivers, heading = world.panel_centre(), world.receivers(), world.fleet.panel_heading
        start, end = links.ends(self.ap_position, panel, receivers)
        blockers = world.sight.blockers(start, end, self._own_person)
        mean = links.means(self.medium, start, end, blockers, heading)
        elements = links.panel_elements(panel, heading, radio.panel_rows, radio.panel_cols, self._spacing_m)
        return Scene(
            rover_xy=panel[:, :2],
            rover_heading=world.fleet.heading,
            panel_heading=heading,
            users_xy=receivers[..., :2],
            blockers=blockers,
            path_loss_db=mean.loss_db,
            channels=links.channels(self._antennas, receivers, elements, mean, self._diffuse, radio.wavelength_m),
        )

    def _draw_diffuse(self, cells: IntArray) -> ComplexArray:
        """Fresh diffuse fading of some cells [n, ...]."""
        return self._streams.diffuse(cells, self._diffuse.shape[1], self.config.radio.difference_factor)


@compiled
def _bisectors(aims: FloatArray, places: FloatArray) -> FloatArray:
    """`Simulator.bisector` for `Simulator.aims`."""
    headings, x, y = np.empty(len(places)), places[:, 0].copy(), places[:, 1].copy()
    forward_x, forward_y = np.empty(len(x)), np.empty(len(x))
    for e in range(len(places)):
        own = slice(e, e + 1)
        links.bisectors(aims[e], x[own], y[own], forward_x[own], forward_y[own])
        headings[e] = math.atan2(forward_y[e], forward_x[e])
    return headings
