"""The simulator: E cells stepped together once a slot, from motion over sight and channels to rates."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.planning.terrain import Terrain
from mjris.radio import ascent, closed_forms, fading, links, powers, serving
from mjris.radio.surface import Surface, effective_channel
from mjris.radio.tables import LinkTable
from mjris.simulation.checks import checked
from mjris.simulation.constraints import evaluate
from mjris.simulation.knowledge import Knowing, Places
from mjris.simulation.scene import Retune, Scene, Slot
from mjris.simulation.streams import CellId, Streams, first_cells
from mjris.world import facing
from mjris.world.layout import load_layout
from mjris.world.world import World

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]


class _Sent(NamedTuple):
    """What a slot's transmission was and gave."""

    rates_bps: FloatArray
    bare_rates_bps: FloatArray
    effective: ComplexArray
    """As the slot began."""
    known: ComplexArray
    """What was known of it then."""
    order: IntArray | None
    """The one that was fixed before."""
    channels: tuple[links.Channels, ...]


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
        self.terrain = Terrain(self.world)
        radio = config.radio
        k, m = config.world.num_users, radio.num_antennas
        counts = self.world.panel_sizes.prod(1)
        n = self.num_elements = int(counts.sum())
        """N, elements of all panels, the rover's first."""
        self.clusters = np.arange(k).reshape(radio.num_clusters, -1)
        """Users of every cluster, int [V, K/V]."""
        self.bare_system = serving.System.of(radio, self.clusters, config.task.qos_bps)
        """Who is served with what where there are no panels."""
        self.net_share = 1 - (0 if config.task.ris == "none" else _overhead(config, n))
        """What pilots and control leave of a slot; net rates are those of so much of the band."""
        self.system = self.bare_system._replace(bandwidth_hz=self.net_share * radio.bandwidth_hz)
        self.link_table, self.surface = LinkTable.of(radio), Surface.of(radio)
        self.links = links.Links(k, counts)
        """Which links there are: the axes [L] of the scene."""
        self.link_of = self.links.of_entries(m)
        """The links of all entries of h_d [K, M], G [N, M] and h_r [K, N]."""
        self._knowing = Knowing(config, self.links, self.link_of, self.world.panel_sizes, self._streams)
        self._spacing_m = radio.wavelength_m / 2
        self.ap_position = np.stack([self.world.office(e).ap_position for e in range(num_cells)])
        """Centres of the APs' arrays [E, 3] [m]."""
        self.room_m = np.array([self.world.office(e).layout.room.size[:2] for e in range(num_cells)])
        """Sizes of the rooms [E, 2] [m]."""
        axes = np.stack([self.world.office(e).ap_axis for e in range(num_cells)])
        self._antennas = links.uniform_linear_array(self.ap_position, axes, m, self._spacing_m)
        self.dead = self._streams.dead(n, radio.surface.dead_share)
        """Which elements reflect nothing [E, N]."""
        self._diffuse = np.zeros((num_cells, k * m + n * m + k * n), np.complex128)
        """Of h_d, G and h_r, [E, K M + N M + K N]."""
        self.order = self.system.no_order(num_cells)
        """The decoding order that is fixed for the episode [E, V, K/V], negative where it is that of the gains."""
        self.slots = np.zeros(num_cells, np.int64)
        """Slots of the episode that are over [E]."""
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
        self.order[cells] = -1
        self.slots[cells] = 0
        self._knowing.draw(cells)
        self._knowing.begin(self._places, cells)
        return self._look()

    def random_phases(self) -> FloatArray:
        """Uniform phases from each cell's stream for them [E, N] [rad]."""
        return self._streams.phases(self.num_elements)

    def step(
        self,
        displacement_m: FloatArray,
        phases_rad: FloatArray,
        powers_w: FloatArray,
        pan_rad: FloatArray | None = None,
        retune: Retune | None = None,
    ) -> Slot:
        """Transmit over the present channel, then move and turn the panels: see `Controls`.

        With phases that are held, transmission goes on while things move. Raises `ValueError` for arrays of other
        shapes and for numbers that are not finite.
        """
        cells, users, elements = self.num_cells, self.config.world.num_users, self.num_elements
        displacement_m = checked("displacement_m", displacement_m, (cells, 2))
        phases_rad = checked("phases_rad", phases_rad, (cells, elements))
        powers_w = checked("powers_w", powers_w, (cells, users))
        if pan_rad is not None:
            pan_rad = checked("pan_rad", pan_rad, (cells,))
        fresh = None
        if self.config.radio.fading_memory < 1:
            fresh = self._draw_diffuse(np.arange(cells))
        before, parts = self.world.fleet.xy, [self.scene]
        self._knowing.begin(self._places)

        def on_tick() -> None:
            share = len(parts) / self.config.world.ticks_per_slot
            parts.append(self._observe(self._diffuse if fresh is None else self._between(fresh, share), share))

        steps = self._streams.steps(users, self.config.world.walk_scale_m)
        motion = self.world.move(displacement_m, *steps, on_tick if self.config.task.phase_updates_per_slot else None)
        sent = self._transmit(parts, phases_rad, powers_w, retune)
        self._knowing.draw(np.arange(cells))
        self._face_panels(pan_rad)
        if fresh is not None:
            memory = self.config.radio.fading_memory
            self._diffuse = fading.evolve(self._diffuse, fresh, memory) if memory > 0 else fresh
        self.scene = self._observe(self._diffuse)
        self.slots += 1
        return Slot(
            rates_bps=sent.rates_bps,
            qos_met=sent.rates_bps >= self.config.task.qos_bps,
            bare_rates_bps=sent.bare_rates_bps,
            channels=sent.channels,
            displacement_m=self.world.fleet.xy - before,
            clearance_m=motion.clearance_m,
            collisions=motion.collisions,
            constraints=evaluate(
                self.config,
                self.system,
                rover_xy=self.scene.rover_xy,
                hull_radius_m=self.world.hull_radius_m,
                room_m=self.room_m,
                effective=sent.effective,
                known=sent.known,
                powers_w=powers_w,
                order=sent.order,
                rates_bps=sent.rates_bps,
                collisions=motion.collisions,
            ),
            scene=self.scene,
        )

    def _transmit(
        self, parts: Sequence[Scene], phases_rad: FloatArray, powers_w: FloatArray, retune: Retune | None
    ) -> "_Sent":
        """What is sent in the parts of a slot, which are its ticks' beginnings, or its beginning alone."""
        updates, ticks = self.config.task.phase_updates_per_slot, self.config.world.ticks_per_slot
        first, known = self._effective(phases_rad, parts[0])
        order = self._fix_order(known, powers_w)
        bare_powers, bare_rates = self._bare_powers(parts[0].known)
        if updates == 0:
            rates = self.rates(first, powers_w, self.order, known)
            if parts[0].known is not parts[0].channels:
                bare_rates = self._bare_rates(parts[0], bare_powers)
            return _Sent(rates, bare_rates, first, known, order, (parts[0].channels,))
        # The last scene is that of the next slot's beginning.
        parts = parts[:ticks]
        rates, bare_rates = np.zeros(powers_w.shape), np.zeros(powers_w.shape)
        for tick, part in enumerate(parts):
            if tick and tick % (ticks // updates) == 0:
                bare_powers, _ = self._bare_powers(part.known)
                if retune is not None:
                    phases_rad, powers_w = retune(part.known)
            effective, promised = self._effective(phases_rad, part)
            rates += self.rates(effective, powers_w, self.order, promised) / len(parts)
            bare_rates += self._bare_rates(part, bare_powers) / len(parts)
        return _Sent(rates, bare_rates, first, known, order, tuple(part.channels for part in parts))

    def _bare_powers(self, known: links.Channels) -> tuple[FloatArray, FloatArray]:
        """Reference powers [E, K] [W] without RIS, and their promise."""
        return powers.qos_or_sum(self.bare_system, known.direct, searched=self.config.task.ascent_steps > 0)

    def _bare_rates(self, part: Scene, powers_w: FloatArray) -> FloatArray:
        """What powers [E, K] [W] give without RIS [E, K] [bit/s]."""
        return serving.rates(self.bare_system, part.channels.direct, powers_w, None, part.known.direct)

    def _between(self, fresh: ComplexArray, share: float) -> ComplexArray:
        """Diffuse fading when a share of the slot is over, on the arc to that of the next slot; its power stays one."""
        return fading.evolve(self._diffuse, fresh, math.cos(share * math.acos(self.config.radio.fading_memory)))

    def _effective(self, phases_rad: FloatArray, scene: Scene) -> tuple[ComplexArray, ComplexArray]:
        """The effective channels [E, K, M], and what is known of them."""
        known, truth = self.effective_channel(phases_rad, scene.known), scene.channels
        missed_deg = self.config.radio.surface.phase_noise_deg
        if missed_deg > 0:
            missed = self._streams.phase_noise(self.num_elements, math.radians(missed_deg))
            truth = truth._replace(incident=np.exp(1j * missed)[..., None] * truth.incident)
        return known if truth is scene.known else self.effective_channel(phases_rad, truth), known

    def effective_channel(self, phases_rad: FloatArray, channels: links.Channels | None = None) -> ComplexArray:
        """H [E, K, M] for phases [E, N] [rad], without the RIS where the task has none; by default what is known."""
        channels = channels or self.scene.known
        if self.config.task.ris == "none":
            return channels.direct
        return effective_channel(self.surface, channels, phases_rad)

    def rates(
        self,
        effective: ComplexArray,
        powers_w: FloatArray,
        order: IntArray | None = None,
        known: ComplexArray | None = None,
    ) -> FloatArray:
        """Rates [..., K] [bit/s] over effective channels [..., K, M] for powers [..., K] [W]: `serving.rates`."""
        return serving.rates(self.system, effective, powers_w, order, known)

    def reference_powers(
        self, effective: ComplexArray, wanted_bps: FloatArray | None = None, order: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Reference powers [..., K] [W] for known channels [..., K, M], and their promise: `powers.qos_or_sum`.

        With the task's ascent, what clusters spend is searched.
        """
        searched = self.config.task.ascent_steps > 0
        return powers.qos_or_sum(self.system, effective, wanted_bps, order, searched=searched)

    def split_powers(self, shares: FloatArray) -> FloatArray:
        """Powers [E, K] [W] for shares [E, K] in [0, 1] of what users may have: `powers.split_powers`."""
        return powers.split_powers(self.system, checked("shares", shares, (self.num_cells, self.clusters.size)))

    def reference_phases(self, weights: FloatArray | None = None, channels: links.Channels | None = None) -> FloatArray:
        """Reference phases [E, N] [rad] for user weights [E, K], in the cells' decoding order.

        `qos_aligned_phases` or, where the task has steps for it, `ascended_phases`. For what is known of the present
        scene by default.
        """
        if weights is not None:
            weights = checked("weights", weights, (self.num_cells, self.clusters.size))
        known = channels or self.scene.known
        steps = self.config.task.ascent_steps
        if steps == 0:
            return closed_forms.qos_aligned_phases(self.system, self.surface, known, weights, self.order)
        effort = ascent.Effort.of(steps)
        return ascent.ascended_phases(self.system, self.surface, known, effort, weights, self.order)

    def _fix_order(self, known: ComplexArray, powers_w: FloatArray) -> IntArray | None:
        """The static order, which is fixed in the episode's first slot; None where every slot has its own."""
        radio = self.config.radio
        if radio.decoding_order == "dynamic" or radio.scheme == "oma":
            return None
        fresh = self.order[:, 0, 0] < 0
        if fresh.any():
            self.order[fresh] = serving.decoding_order(self.system, known, powers_w)[fresh]
        return self.order

    def bisector(self, places: FloatArray) -> FloatArray:
        """Where panels at `places` [E, 2] [m] should face: the bisector of `aims`, [E] [rad]."""
        users_xy = self._knowing.users_xy(self.world.crowd.xy, self.room_m)
        return facing.bisector(self.aims(users_xy), places)

    def aims(self, users_xy: FloatArray) -> FloatArray:
        """What panels face between [E, ., 2] [m]: users, or the room's middle for a fixed RIS, and, last, the AP."""
        users_xy = self.room_m[:, None] / 2 if self.config.task.ris == "fixed" else users_xy
        return np.concatenate([users_xy, self.ap_position[:, None, :2]], 1)

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
        self._knowing.begin(self._places)
        return self._look()

    def _look(self) -> Scene:
        self._face_panels()
        self.scene = self._observe(self._diffuse)
        return self.scene

    def _places(self) -> Places:
        return Places(self._antennas, self.world.receivers(), self.world.panel_centres(), self.world.panel_headings())

    def _observe(self, diffuse: ComplexArray, share: float = 1.0) -> Scene:
        """Sight, path losses and channels at the present positions, with this diffuse fading.

        When a `share` of the slot is over.
        """
        radio, world, places = self.config.radio, self.world, self._places()
        _, receivers, panels, headings = places
        start, end = self.links.ends(self.ap_position, panels, receivers)
        ways = start, end, self.links.person, None, self.links.panel == 0
        obstacles = blockers = world.sight.blockers(*ways)
        if world.losses_in_db:
            obstacles = world.losses.blockers(*ways)
        mean = links.means(self.link_table, self.links.panel, start, end, obstacles, headings)
        elements = links.panel_elements(panels, headings, world.panel_sizes, self._spacing_m)
        made = links.channels(self.links, self._antennas, receivers, elements, mean, diffuse, radio.wavelength_m)
        if radio.surface.dead_share > 0:
            made.incident[self.dead] = 0
        known_xy = self._knowing.users_xy(receivers[..., :2], self.room_m)
        known = self._knowing.channels(made, mean, diffuse, places, known_xy, share)
        if radio.surface.dead_share > 0:
            known.incident[self.dead] = 0  # nobody takes a path over them for one
        return Scene(
            rover_xy=panels[:, 0, :2],
            rover_heading=world.fleet.heading,
            panel_heading=headings[:, 0],
            users_xy=receivers[..., :2],
            known_users_xy=known_xy,
            blockers=blockers.astype(np.int64),
            path_loss_db=mean.loss_db,
            mean_gain=mean.gain,
            channels=made,
            known=known,
        )

    def _draw_diffuse(self, cells: IntArray) -> ComplexArray:
        """Fresh diffuse fading of some cells [n, ...]."""
        return self._streams.diffuse(cells, self._diffuse.shape[1], self.config.radio.difference_factor)


def _overhead(config: Config, elements: int) -> float:
    """The share of a slot that pilots for so many elements and control take. Raises `ConfigError` if that is all."""
    known, slot_s = config.radio.knowledge, config.world.slot_s
    share = (elements * known.pilot_s + known.control_s) / slot_s
    if share >= 1:
        raise ConfigError(
            f"radio.knowledge.pilot_s: {known.pilot_s:g} is not allowed: with {elements} elements and "
            f"radio.knowledge.control_s {known.control_s:g} nothing is left of world.slot_s {slot_s:g}"
        )
    return share
