"""Fields over an office's floor: sight, path loss, SNR, rate, what the RIS adds and where it would add most."""

import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config, ConfigError, Radio
from mjris.radio import propagation
from mjris.radio.surface import mean_coefficient
from mjris.simulation.outlook import bare_values, place_values
from mjris.simulation.simulator import Simulator
from mjris.world.footprints import Footprints, footprints
from mjris.world.office import HULL_FLOOR_GAP_M, PERSON_HEIGHT_M, Office, hull_height, hull_radius

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_FINEST_M, _COARSEST_M = 0.02, 1.0
_CHUNK = 4096
"""Points whose distances to all furniture are held at a time."""


@dataclass(frozen=True)
class FloorMap:
    """One office at one moment, for a receiver at user height on each point of a grid [ny, nx]; nothing fades.

    The SNR is that of a single user with all of the power in the whole band, at the mean gain of matched beams:
    P_max M g_d / σ², and its rate B log2(1 + SNR). The RIS adds its ideal cascade,
    P_max M (√g_d + Σ_s N_s β √(g_i g_r))² / σ²: all elements of all panels in phase with the direct path, and the AP's
    beam on all at once, which a single antenna reaches and several can only come near. Gains g hold path loss and
    element patterns.
    """

    x_m: FloatArray
    """Columns of the grid [nx] [m]."""
    y_m: FloatArray
    """Rows of the grid [ny] [m]."""
    in_furniture: BoolArray
    """Where nobody can stand, as furniture does [ny, nx]."""
    blockers: IntArray
    """Obstacles between AP and receiver [ny, nx]."""
    path_loss_db: FloatArray
    """From AP to receiver [ny, nx] [dB]."""
    snr_db: FloatArray
    """Without RIS [ny, nx] [dB]."""
    rate_bps: FloatArray
    """Without RIS [ny, nx] [bit/s]."""
    ris_snr_db: FloatArray
    """With the rover at `ris_xy_m` [ny, nx] [dB]."""
    ris_rate_bps: FloatArray
    """With the rover at `ris_xy_m` [ny, nx] [bit/s]."""
    place_x_m: FloatArray
    """Columns of the grid of places [px] [m]."""
    place_y_m: FloatArray
    """Rows of the grid of places [py] [m]."""
    place_gain_bps: FloatArray
    """Predicted sum rate of the present users, QoS penalty included, with the RIS at a place, less `bare_value_bps`;
    NaN where the rover cannot stand [py, px] [bit/s]."""
    bare_value_bps: FloatArray
    """The same prediction without RIS [] [bit/s]."""
    ap_xyz_m: FloatArray
    """[3] [m]"""
    users_xy_m: FloatArray
    """[K, 2] [m]"""
    ris_xy_m: FloatArray
    """[2] [m]"""
    ris_heading_rad: FloatArray
    """The direction that the panel faces [] [rad]."""

    def save(self, path: Path) -> None:
        """Write all fields under their names to an .npz file."""
        np.savez_compressed(path, **{field.name: getattr(self, field.name) for field in fields(self)})


def floor_map(
    simulator: Simulator,
    *,
    resolution_m: float = 0.1,
    place_resolution_m: float = 0.25,
    rover_xy_m: tuple[float, float] | None = None,
    panel_heading_rad: float | None = None,
) -> FloorMap:
    """The floor of a simulator's only cell, in its present scene, on grids no coarser than the resolutions [m].

    The RIS stands where the rover does, or at `rover_xy_m`, and faces as the config's pan says (the bisector of AP and
    users, or the rover's front), or `panel_heading_rad`. Raises `ConfigError` for a resolution or a place that is not
    allowed.
    """
    config, office, scene = simulator.config, simulator.world.office(0), simulator.scene
    x, y = _grid(office, resolution_m, "resolution_m")
    points = np.stack(np.meshgrid(x, y), -1)
    place_x, place_y = _grid(office, place_resolution_m, "place_resolution_m")
    ris_xy = scene.rover_xy[0] if rover_xy_m is None else _standable(config, office, np.array(rover_xy_m))
    heading = _panel_heading(simulator, ris_xy, panel_heading_rad)

    receivers = _at_height(points, config.world.user_height_m)
    blockers, loss_db = links(simulator, receivers, simulator.ap_position[0])
    direct = propagation.db_to_linear(-loss_db)
    panels, headings = simulator.world.panel_centres()[0], simulator.world.panel_headings()[0]
    panels[0, :2], headings[0] = ris_xy, heading
    amplitude = np.sqrt(direct)
    for panel, facing, elements in zip(panels, headings, simulator.links.elements, strict=True):
        amplitude += elements * _one_element(simulator, receivers, panel, facing)
    snr, ris_snr = _snr(direct, config.radio), _snr(amplitude**2, config.radio)
    bare = bare_values(simulator)[0]
    body = footprints([office], 0.0, PERSON_HEIGHT_M)
    return FloorMap(
        x_m=x,
        y_m=y,
        in_furniture=_distance(body, points) == 0,
        blockers=blockers,
        path_loss_db=loss_db,
        snr_db=10 * np.log10(snr),
        rate_bps=rate_bps(snr, config.radio),
        ris_snr_db=10 * np.log10(ris_snr),
        ris_rate_bps=rate_bps(ris_snr, config.radio),
        place_x_m=place_x,
        place_y_m=place_y,
        place_gain_bps=_place_values(simulator, np.stack(np.meshgrid(place_x, place_y), -1)) - bare,
        bare_value_bps=bare,
        ap_xyz_m=simulator.ap_position[0],
        users_xy_m=scene.users_xy[0],
        ris_xy_m=ris_xy,
        ris_heading_rad=heading,
    )


def links(simulator: Simulator, points: FloatArray, end: FloatArray) -> tuple[IntArray, FloatArray]:
    """Obstacles [...] and path loss [...] [dB] between points [..., 3] and one end [3] [m], in the only cell."""
    start, world = points.reshape(1, -1, 3), simulator.world
    ways = start, np.broadcast_to(end, start.shape)
    count, behind = (seen.blockers(*ways).reshape(points.shape[:-1]) for seen in (world.sight, world.losses))
    distance = np.linalg.norm(end - points, axis=-1)
    return count.astype(np.int64), propagation.losses_db(simulator.link_table, distance, behind)


def rate_bps(snr: FloatArray, radio: Radio) -> FloatArray:
    """Rate of a single user in the whole band [...] [bit/s] at a linear SNR [...]."""
    return radio.bandwidth_hz * np.log2(1 + snr)


def _snr(gain: FloatArray, radio: Radio) -> FloatArray:
    """Linear SNR at full power for a mean power gain [...] of one antenna, with the beam matched."""
    return radio.tx_power_w * radio.num_antennas * gain / radio.noise_w


def _one_element(simulator: Simulator, receivers: FloatArray, panel: FloatArray, heading: float) -> FloatArray:
    """Mean amplitude from AP to receivers [..., 3] [m] by way of one element [...] of a panel at a place [3] [m]."""
    radio = simulator.config.radio
    ends = np.concatenate([receivers.reshape(-1, 3), simulator.ap_position])
    _, loss_db = links(simulator, ends, panel)
    ahead = (ends - panel) @ np.array([np.cos(heading), np.sin(heading), 0.0])
    cosine = ahead / np.maximum(np.linalg.norm(ends - panel, axis=-1), 1e-12)
    gain = propagation.db_to_linear(-loss_db) * propagation.element_gain(radio, cosine)
    return mean_coefficient(radio).coherent * np.sqrt(gain[-1] * gain[:-1]).reshape(receivers.shape[:-1])


def _place_values(simulator: Simulator, places: FloatArray) -> FloatArray:
    """`place_values` of places [..., 2] [m] where the rover can stand, NaN at others [...] [bit/s]."""
    config = simulator.config
    free = _hull_room_m(config, simulator.world.office(0), places) >= config.world.bumper_m
    values = np.full(free.shape, np.nan)
    values[free] = place_values(simulator, places[free][None])[0]
    return values


def _panel_heading(simulator: Simulator, ris_xy: FloatArray, wanted_rad: float | None) -> FloatArray:
    if wanted_rad is not None:
        if not math.isfinite(wanted_rad):
            raise ConfigError(f"heading: {wanted_rad} is not allowed: it must be an angle")
        return np.array(wanted_rad)
    if simulator.config.world.pan == "auto":
        return simulator.bisector(ris_xy[None])[0]
    return simulator.scene.rover_heading[0]


def _standable(config: Config, office: Office, xy: FloatArray) -> FloatArray:
    """`xy` [2] [m], if the rover can stand there."""
    width, depth, _ = office.layout.room.size
    where = f"rover: {xy[0]:g} {xy[1]:g} is not allowed"
    if not (0 <= xy[0] <= width and 0 <= xy[1] <= depth):
        raise ConfigError(f"{where}: the room goes from 0 0 to {width:g} {depth:g}")
    room_m = float(_hull_room_m(config, office, xy[None])[0])
    if room_m < 0:
        raise ConfigError(f"{where}: the rover's hull would stand {-room_m:.2f} m in furniture or a wall")
    return xy


def _hull_room_m(config: Config, office: Office, points: FloatArray) -> FloatArray:
    """Room left between the hull at points [..., 2] [m] and everything solid, negative if it does not fit [...] [m]."""
    solid = footprints([office], HULL_FLOOR_GAP_M, hull_height(config))
    return _distance(solid, points) - hull_radius(config)


def _distance(solid: Footprints, points: FloatArray) -> FloatArray:
    """Distance from points [..., 2] [m] to the nearest rectangle [...] [m]."""
    flat = points.reshape(1, -1, 2)
    parts = np.array_split(flat, math.ceil(flat.shape[1] / _CHUNK), axis=1)
    return np.concatenate([solid.distance(part) for part in parts], 1).reshape(points.shape[:-1])


def _grid(office: Office, resolution_m: float, name: str) -> tuple[FloatArray, FloatArray]:
    """Middles of the columns and rows of equal cells that tile the floor, no longer than `resolution_m` [m]."""
    if not _FINEST_M <= resolution_m <= _COARSEST_M:
        raise ConfigError(f"{name}: {resolution_m} is not allowed: it must be from {_FINEST_M} to {_COARSEST_M:g} m")
    counts = [math.ceil(length / resolution_m - 1e-9) for length in office.layout.room.size[:2]]
    x, y = ((np.arange(n) + 0.5) * length / n for n, length in zip(counts, office.layout.room.size[:2], strict=True))
    return x, y


def _at_height(xy: FloatArray, height_m: float) -> FloatArray:
    """Points [..., 3] [m] above points [..., 2] [m] of the floor."""
    return np.concatenate([xy, np.full((*xy.shape[:-1], 1), height_m)], -1)
