"""One policy, played on scenes: what it got, who got it, and what it broke."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mjris.config import Config
from mjris.eval import fairness
from mjris.eval.bound import upper_bound
from mjris.eval.policies import Policy
from mjris.planning.radio_map import penalised
from mjris.radio.powers import best_powers
from mjris.radio.serving import rates as rates_of
from mjris.radio.surface import power_drawn_w
from mjris.simulation.constraints import NAMES
from mjris.simulation.streams import CellId
from mjris.simulation.task import Task

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class Played:
    """One policy on S scenes."""

    sum_rate_bps: FloatArray
    """Mean over the slots of every scene [S] [bit/s]."""
    bare_bps: FloatArray
    """What the very same slots give without RIS and with the best powers known, [S] [bit/s]."""
    value_bps: FloatArray
    """The sum rate with the QoS penalty of eq. (R) [S] [bit/s]."""
    qos_share: FloatArray
    """Share of slots in which every user meets QoS [S]."""
    user_qos_share: FloatArray
    """Share of the users' slots with QoS [S]."""
    user_rate_p5_bps: FloatArray
    """5th percentile of the rates of a scene, over its users and slots together [S] [bit/s]."""
    jain: FloatArray
    """Jain's index over the users of a slot, mean over the slots of every scene [S]."""
    superposing_share: FloatArray
    """Share of the clusters' slots in which at least two users have power [S]; 0 with OMA."""
    collisions: int
    clearance_m: float
    """Smallest clearance of all scenes [m]."""
    violations: Mapping[str, int]
    """Slots of all scenes that broke each constraint, by its name."""
    radiated_w: FloatArray
    """What the AP sent, mean over the slots of every scene [S] [W]."""
    panels_w: float
    """What the panels drew [W]."""
    bound_bps: FloatArray
    """Upper bound on the sum rate over the channels of these slots [S] [bit/s]; NaN where it was not asked for."""


def independent(config: Config) -> Config:
    """The config with scenes that share no fading."""
    return replace(config, radio=replace(config.radio, difference_factor=1.0))


def play(config: Config, policy: Policy, scenes: int, seed: int, *, bounded: bool = False) -> Played:
    """One episode in each of `scenes` cells, all stepped together, with fading of their own."""
    config = independent(policy.changed(config))
    radio, qos_bps = config.radio, config.task.qos_bps
    # Furniture follows from the scenes' seed, too: held-out scenes are not the cells of the training.
    task = Task(config, [CellId(seed, scene) for scene in range(scenes)])
    simulator = task.simulator
    rates, powers, direct, bounds, met = [], [], [], [], []
    collisions, clearance = 0, np.inf
    violations = dict.fromkeys(NAMES, 0)
    for _ in range(config.task.slots):
        controls = policy.controls(task)
        slot = simulator.step(*controls)
        rates.append(slot.rates_bps)
        powers.append(controls.powers_w)
        direct.append([part.direct for part in slot.channels])
        if bounded:
            bound_bps = [upper_bound(part, simulator.clusters, radio) for part in slot.channels]
            bounds.append(simulator.net_share * np.mean(bound_bps, 0))
        met.append(slot.qos_met.all(-1))
        collisions += int(slot.collisions.sum())
        clearance = min(clearance, float(slot.clearance_m.min()))
        for name in NAMES:
            violations[name] += int((~getattr(slot.constraints, name)).sum())
    # Slots, and their parts where phases and powers are held; then powers without RIS are, too.
    bare, served = np.array(direct), np.stack(rates)
    hold = bare.shape[1] // max(config.task.phase_updates_per_slot, 1)
    bare_powers = best_powers(simulator.bare_system, bare[:, ::hold]).repeat(hold, 1)
    bare_rates = rates_of(simulator.bare_system, bare, bare_powers)
    return Played(
        sum_rate_bps=served.sum(-1).mean(0),
        bare_bps=bare_rates.sum(-1).mean((0, 1)),
        value_bps=penalised(served, qos_bps, config.task.qos_penalty).mean(0),
        qos_share=np.mean(met, 0),
        user_qos_share=fairness.user_qos_share(served, qos_bps),
        user_rate_p5_bps=fairness.low_rate_bps(served),
        jain=fairness.jain_index(served),
        superposing_share=fairness.superposing_share(np.stack(powers), simulator.clusters, radio.scheme),
        collisions=collisions,
        clearance_m=clearance,
        violations=violations,
        radiated_w=np.stack(powers).sum(-1).mean(0),
        panels_w=0.0 if config.task.ris == "none" else power_drawn_w(radio.surface, simulator.links.elements),
        bound_bps=np.mean(bounds, 0) if bounded else np.full(scenes, np.nan),
    )
