"""The constraints of the paper's problem formulation, each evaluated for every slot."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.jit.compiled import compiled
from mjris.radio import serving

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_ROUNDING = 1e-9
"""Relative tolerance of a power budget."""


class Constraints(NamedTuple):
    """Which constraints a slot kept, bool [E] each; labels are those of the paper."""

    in_room: BoolArray
    """(OPPD): the rover stands in its room with the whole of its hull."""
    power: BoolArray
    """(OPPE): no cluster has more power than its share, or all together than P_max where they share; with OMA a single
    user counts as a cluster, unless the scheduler selects users."""
    decoding_order: BoolArray
    """(OPPB): users are decoded by ascending effective gain; with OMA nobody decodes the signals of others."""
    qos: BoolArray
    """(OPPG): every user has at least R_QoS."""
    collision_free: BoolArray
    """Section III-A: rover and panel touch neither obstacles nor people."""

    def by_cell(self) -> list[dict[str, bool]]:
        """The constraints of every cell by name."""
        kept = zip(*(column.tolist() for column in self), strict=True)
        # A display takes a third of the time of dict(zip(NAMES, cell)).
        return [
            {"in_room": room, "power": power, "decoding_order": order, "qos": qos, "collision_free": free}
            for room, power, order, qos, free in kept
        ]


NAMES = Constraints._fields
"""All constraints, in the order of `Constraints`."""


def within_room(xy: FloatArray, radius_m: float, room_m: FloatArray) -> BoolArray:
    """Whether discs of `radius_m` [m] at `xy` [..., 2] [m] lie in rooms from the origin to `room_m` [..., 2], [...]."""
    return np.all((xy >= radius_m) & (xy <= room_m - radius_m), axis=-1)


def within_budget(powers_w: FloatArray, clusters: IntArray, scheme: str, tx_power_w: float) -> BoolArray:
    """Whether powers [..., K] [W] are in the budget P: P/V for a cluster of `clusters` [V, K/V], P/K for a user of OMA.

    None is negative, and a sum may exceed its budget by the relative error of rounding, 1e-9.
    """
    groups = powers_w[..., None] if scheme == "oma" else powers_w[..., clusters]
    most = tx_power_w / groups.shape[-2] * (1 + _ROUNDING)
    return np.all(powers_w >= 0, axis=-1) & np.all(groups.sum(-1) <= most, axis=-1)


def ascending(gains: FloatArray, powers_w: FloatArray, order: IntArray) -> BoolArray:
    """Whether the effective gains [E, K] of every cluster's users rise in the decoding order [E, V, K/V], [E].

    Of users with power [E, K] [W]: others decode nothing, and nothing of theirs is decoded.
    """
    decoded = np.take_along_axis(gains[:, None], order, axis=-1)
    powered = np.take_along_axis(powers_w[:, None] > 0, order, axis=-1)
    before = np.maximum.accumulate(np.where(powered, decoded, -np.inf), axis=-1)
    return np.all((decoded >= before) | ~powered, axis=(-2, -1))


def evaluate(
    config: Config,
    system: serving.System,
    *,
    rover_xy: FloatArray,
    hull_radius_m: float,
    room_m: FloatArray,
    effective: NDArray[np.complexfloating],
    known: NDArray[np.complexfloating],
    powers_w: FloatArray,
    order: IntArray | None,
    rates_bps: FloatArray,
    collisions: IntArray,
) -> Constraints:
    """The constraints of a slot in E cells.

    `rover_xy` [E, 2] [m] is where the slot left the rover, `room_m` [E, 2] [m] the room's size, `effective` [E, K, M]
    the channels and `known` what beams followed from, `powers_w` [E, K] [W] what was transmitted, `rates_bps` [E, K]
    [bit/s] what came of it. `order` [E, V, K/V] is a decoding order that was fixed beforehand; None is OMA or the order
    of the slot's own gains, which ascend by its definition.
    """
    radio = config.radio
    ordered = np.ones(len(rates_bps), np.bool_)
    if order is not None:
        ordered = ascending(serving.effective_gains(system, effective, known, powers_w), powers_w, order)
    # A scheduler that selects users may give one all that its cluster has.
    by_user = radio.scheme == "oma" and not radio.oma_selection
    shape = (-1, 1) if by_user else (1, -1) if radio.cluster_power == "shared" else system.clusters.shape
    groups = system.clusters.reshape(shape)
    most_w = radio.tx_power_w / len(groups) * (1 + _ROUNDING)
    in_room, power, qos = _kept(
        rover_xy, hull_radius_m, room_m, powers_w, groups, most_w, rates_bps, config.task.qos_bps
    )
    return Constraints(in_room, power, ordered, qos, collision_free=collisions == 0)


@compiled
def _kept(
    rover_xy: FloatArray,
    hull_radius_m: float,
    room_m: FloatArray,
    powers_w: FloatArray,
    groups: IntArray,
    most_w: float,
    rates_bps: FloatArray,
    qos_bps: float,
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """`within_room`, `within_budget` for groups of users with `most_w` [W] each, and whether all have `qos_bps`."""
    cells = len(rover_xy)
    in_room, power, qos = np.ones(cells, np.bool_), np.ones(cells, np.bool_), np.ones(cells, np.bool_)
    for e in range(cells):
        for i in range(2):
            in_room[e] &= hull_radius_m <= rover_xy[e, i] <= room_m[e, i] - hull_radius_m
        for group in groups:
            total = 0.0
            for user in group:
                total += powers_w[e, user]
                power[e] &= powers_w[e, user] >= 0
                qos[e] &= rates_bps[e, user] >= qos_bps
            power[e] &= total <= most_w
    return in_room, power, qos
