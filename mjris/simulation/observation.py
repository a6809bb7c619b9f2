"""What agents see of the present scene in E cells, every number of order one."""

import math

import numpy as np
from numpy.typing import NDArray

from mjris.jit.compiled import compiled
from mjris.radio.links import Channels
from mjris.simulation.outlook import place_values
from mjris.simulation.simulator import Simulator
from mjris.simulation.units import rate_unit_bps, usual_loss_db

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
IntArray = NDArray[np.int64]
Seen = NDArray[np.float32]

FAR_M = 12.0
"""The furthest waypoint, and what counts as one: about half the diagonal of the default office."""
_RADII_M = (0.6, 2.0, 5.0)
_ANGLES = np.arange(8) * np.pi / 4
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)
_AROUND = np.concatenate([np.zeros((1, 2)), *(radius * _CIRCLE for radius in _RADII_M)])
"""Places of the radio map that are seen, the rover's own first, from there [P, 2] [m]."""
_LOSS_SPREAD_DB = 15
"""What path losses are scaled by: indoors they lie within some 30 dB of the usual one."""
_GAIN_SCALE = 5
"""Gains of the radio map are some tenths of the unit of rates."""


def channel_state(simulator: Simulator) -> Seen:
    """The paper's state, eq. (S), [E, D]: positions, path losses, and fading with the path loss taken out."""
    scene = simulator.scene
    users, (elements, antennas) = scene.users_xy.shape[1], scene.known.incident.shape[1:]
    width = 4 + 2 * users + scene.path_loss_db.shape[1]
    width += 2 * (users * antennas + elements * antennas + users * elements)
    seen = np.empty((simulator.num_cells, width), np.float32)
    usual_db = usual_loss_db(simulator.config)
    _write_channel_state(seen, *_geometry(simulator), scene.known, simulator.link_of, usual_db)
    return seen


def radio_map(simulator: Simulator, goal: FloatArray, promised_bps: FloatArray) -> Seen:
    """Positions, gains of the users' channels and the radio map around the rover, [E, D].

    What places around it are worth more than its own, how far the ways there are free, and where the map's goal
    [E, 2] [m] is and what it promises [E] [bit/s].
    """
    scene, world = simulator.scene, simulator.world
    around = scene.rover_xy[:, None] + _AROUND
    ends = around[:, -len(_CIRCLE) :]
    free = world.free_share(scene.rover_xy[:, None], ends, world.hull_radius_m + world.config.bumper_m)
    width = 4 + 6 * scene.users_xy.shape[1] + scene.path_loss_db.shape[1] + len(_AROUND) + len(_CIRCLE) + 3
    seen = np.empty((simulator.num_cells, width), np.float32)
    values_bps = place_values(simulator, around)
    scales = rate_unit_bps(simulator.config), usual_loss_db(simulator.config)
    _write_radio_map(seen, *_geometry(simulator), scene.known, values_bps, free, goal, promised_bps, *scales)
    return seen


def _geometry(simulator: Simulator) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Rovers [E, 2] [m], panels' headings [E], users [E, K, 2] [m], rooms [E, 2] [m], path losses [E, L] [dB]."""
    scene = simulator.scene
    return scene.rover_xy, scene.panel_heading, scene.known_users_xy, simulator.room_m, scene.path_loss_db


@compiled
def _write_channel_state(
    seen: Seen,
    rover_xy: FloatArray,
    panel_heading: FloatArray,
    users_xy: FloatArray,
    room_m: FloatArray,
    loss_db: FloatArray,
    channels: Channels,
    link_of: tuple[IntArray, IntArray, IntArray],
    usual_db: float,
) -> None:
    for e in range(len(seen)):
        own, amplitude = seen[e], 10.0 ** (loss_db[e] / 20)
        at = _write_positions(own, rover_xy[e], panel_heading[e], users_xy[e], room_m[e])
        at = _write_losses(own, at, loss_db[e], usual_db)
        at = _write_fading(own, at, channels.direct[e], link_of[0], amplitude)
        at = _write_fading(own, at, channels.incident[e], link_of[1], amplitude)
        _write_fading(own, at, channels.reflected[e], link_of[2], amplitude)


@compiled
def _write_radio_map(
    seen: Seen,
    rover_xy: FloatArray,
    panel_heading: FloatArray,
    users_xy: FloatArray,
    room_m: FloatArray,
    loss_db: FloatArray,
    channels: Channels,
    values_bps: FloatArray,
    free: FloatArray,
    goal: FloatArray,
    promised_bps: FloatArray,
    unit_bps: float,
    usual_db: float,
) -> None:
    direct, incident, reflected = channels
    users, toward = users_xy.shape[1], np.empty(incident.shape[1])
    for e in range(len(seen)):
        own, here = seen[e], values_bps[e, 0]
        at = _write_positions(own, rover_xy[e], panel_heading[e], users_xy[e], room_m[e])
        for k in range(users):
            for i in range(2):
                own[at] = 2 * (users_xy[e, k, i] - rover_xy[e, i]) / room_m[e, i]
                at += 1
        at = _write_losses(own, at, loss_db[e], usual_db)
        for n in range(len(toward)):
            toward[n] = _norm(incident[e, n])
        for k in range(users):
            own[at + k] = _scaled(_loss_db(_norm(direct[e, k])), usual_db)
            # With all elements in phase.
            panel = 0.0
            for n in range(len(toward)):
                panel += math.sqrt(reflected[e, k, n].real ** 2 + reflected[e, k, n].imag ** 2) * toward[n]
            own[at + users + k] = _scaled(_loss_db(panel), usual_db)
        at += 2 * users
        own[at] = here / unit_bps
        for place in range(1, values_bps.shape[1]):
            own[at + place] = _GAIN_SCALE * (values_bps[e, place] - here) / unit_bps
        at += values_bps.shape[1]
        for way in range(free.shape[1]):
            own[at + way] = min(free[e, way], 1.0)
        at += free.shape[1]
        # The length under a square root: what is near matters in detail.
        x, y = goal[e, 0] - rover_xy[e, 0], goal[e, 1] - rover_xy[e, 1]
        root = math.sqrt(FAR_M * max(math.hypot(x, y), 1e-9))
        own[at], own[at + 1] = x / root, y / root
        own[at + 2] = _GAIN_SCALE * (promised_bps[e] - here) / unit_bps


@compiled
def _write_positions(
    seen: Seen, rover_xy: FloatArray, panel_heading: float, users_xy: FloatArray, room_m: FloatArray
) -> int:
    """Write positions from the middle of the room and the direction of the panel; where they end."""
    half_x, half_y = room_m[0] / 2, room_m[1] / 2
    seen[0], seen[1] = rover_xy[0] / half_x - 1, rover_xy[1] / half_y - 1
    seen[2], seen[3] = math.cos(panel_heading), math.sin(panel_heading)
    for k in range(len(users_xy)):
        seen[4 + 2 * k], seen[5 + 2 * k] = users_xy[k, 0] / half_x - 1, users_xy[k, 1] / half_y - 1
    return 4 + 2 * len(users_xy)


@compiled
def _write_losses(seen: Seen, at: int, loss_db: FloatArray, usual_db: float) -> int:
    """Write the path losses of all links from `at` on; where they end."""
    for link in range(len(loss_db)):
        seen[at + link] = _scaled(loss_db[link], usual_db)
    return at + len(loss_db)


@compiled
def _write_fading(seen: Seen, at: int, channel: ComplexArray, link_of: IntArray, amplitude: FloatArray) -> int:
    """Write all real parts of a channel [., .] from `at` on, then the imaginary ones; where they end.

    With the path loss taken out: over the `amplitude` [L] of the link that each entry is `link_of` [., .].
    """
    for row in range(channel.shape[0]):
        for column in range(channel.shape[1]):
            over = amplitude[link_of[row, column]]
            seen[at], seen[at + channel.size] = channel[row, column].real * over, channel[row, column].imag * over
            at += 1
    return at + channel.size


@compiled
def _scaled(loss_db: float, usual_db: float) -> float:
    """A path loss [dB] around zero and of order one."""
    return (loss_db - usual_db) / _LOSS_SPREAD_DB


@compiled
def _loss_db(amplitude: float) -> float:
    return -20 * math.log10(max(amplitude, 1e-9))


@compiled
def _norm(row: ComplexArray) -> float:
    total = 0.0
    for entry in row:
        total += entry.real**2 + entry.imag**2
    return math.sqrt(total)
