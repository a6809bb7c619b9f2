"""Curves over time: gains over the episodes of several seeds, and an episode's phases against the aligned ones."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy import stats

from mjris.config import Config, ConfigError
from mjris.eval.checkpoints import Judged
from mjris.eval.intervals import gain_percent, interval
from mjris.eval.playing import independent
from mjris.eval.policies import Act, agent_policies
from mjris.show.palette import RANDOM, RIVALS, STOPS
from mjris.simulation.streams import Purpose, generator
from mjris.simulation.task import Task

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.integer]

_WIDTH_IN = 3.5
"""Half a page."""
_STYLE: dict[Any, Any] = {"font.size": 7, "axes.titlesize": 7, "axes.linewidth": 0.6}
_WINDOW = 10
"""Episodes of the running mean."""
_SCENES = 16
"""Scenes whose phases are compared."""
_BIN_DEG = 10


@dataclass(frozen=True)
class PhaseTrack:
    """T slots of S scenes: the phases of N elements beside the closed-form aligned ones."""

    difference_rad: FloatArray
    """Commanded minus aligned, in [-π, π), [T, S, N] [rad]."""
    gain_db: FloatArray
    """Σ_k ‖h_k‖² over that of the aligned phases [T, S] [dB]."""
    random_gain_db: FloatArray
    """The same for random phases [T, S] [dB]."""


def plot_learning(runs: Sequence[Path], judged: Judged, table: pd.DataFrame, path: Path) -> None:
    """Write the gain over no RIS by episode, as a PNG or PDF file: in training, and of checkpoints on held-out scenes.

    Scenes differ between the two panels, and are the same within the second: its lines are the rivals of an evaluation
    `table`. Shown are means over cells and seeds with 95 % intervals: over seeds in training, where there are several,
    and over scenes and seeds for checkpoints. Raises `ConfigError` as `read_metric`.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH_IN, 4.2), dpi=300, layout="compressed")
        above, below = figure.subplots(2, sharex=True)
        _draw_training(above, *training_gain(runs))
        _draw_rivals(below, table)
        _draw_checkpoints(below, judged)
        above.set_title(f"training: other scenes in every episode, mean of the last {_WINDOW}")
        below.set_title(f"checkpoints and rivals: the same {judged.bare_bps.shape[-1]} held-out scenes")
        for axes in (above, below):
            axes.set_ylabel("over no RIS,\nin the same slots [%]")
        below.set_xlabel("episode")
        below.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        figure.legend(loc="outside lower center", ncols=2, frameon=False, handlelength=3)
        figure.savefig(path)


def training_gain(runs: Sequence[Path]) -> tuple[IntArray, FloatArray]:
    """Episodes [T] of S run folders, and the gain of running means over no RIS in the same slots [S, T] [%].

    Raises `ConfigError` as `read_metric`.
    """
    episodes, rate = read_metric(runs, "sum_rate_mbps")
    _, bare = read_metric(runs, "bare_rate_mbps")
    return episodes, gain_percent(running_mean(rate), running_mean(bare))


def read_metric(runs: Sequence[Path], metric: str) -> tuple[IntArray, FloatArray]:
    """Episodes [T] of the metrics.csv of S run folders, and means over the cells of one of its columns [S, T].

    Episodes that not all runs have are left out. Raises `ConfigError` for a file that cannot be read, or has no rows or
    no such column.
    """
    curves = []
    for run in runs:
        file = run / "metrics.csv"
        try:
            rows = pd.read_csv(file)
        except (OSError, pd.errors.EmptyDataError) as error:
            raise ConfigError(f"{file}: cannot be read: {getattr(error, 'strerror', error)}") from None
        if rows.empty:
            raise ConfigError(f"{file}: has no episodes: train for a round at least")
        if metric not in rows:
            raise ConfigError(
                f"{file}: has no column {metric}: the run is an older version's, and has to be trained anew"
            )
        curves.append(rows.groupby("episode")[metric].mean())
    together = pd.concat(curves, axis=1, join="inner")
    return together.index.to_numpy(), together.to_numpy().T


def running_mean(values: FloatArray, window: int = _WINDOW) -> FloatArray:
    """Means [..., T] of each of `values` [..., T] and those before it, `window` in all or as many as there are."""
    total = np.cumsum(values, -1)
    total[..., window:] -= total[..., :-window].copy()
    return total / np.minimum(np.arange(1, values.shape[-1] + 1), window)


def student_interval(samples: FloatArray) -> tuple[FloatArray, FloatArray]:
    """95 % Student-t interval [...] of the means of `samples` [S, ...] over their first axis, S > 1."""
    count = len(samples)
    half = stats.t.ppf(0.975, count - 1) * samples.std(0, ddof=1) / np.sqrt(count)
    return samples.mean(0) - half, samples.mean(0) + half


def track_phases(config: Config, act: Act, seed: int) -> PhaseTrack:
    """The phases of an agent in an episode of some scenes, all stepped together, which follow from `seed`."""
    policy = agent_policies(act)[0]
    task = Task(independent(policy.changed(config)), cells=_SCENES)
    task.reset(seed)
    simulator = task.simulator
    differences, gains = [], []
    for _ in range(config.task.slots):
        controls = policy.controls(task)
        aligned = simulator.reference_phases()
        differences.append((controls.phases_rad - aligned + np.pi) % (2 * np.pi) - np.pi)
        compared = (aligned, controls.phases_rad, simulator.random_phases())
        gains.append([(np.abs(simulator.effective_channel(phases)) ** 2).sum((-2, -1)) for phases in compared])
        simulator.step(*controls)
    reference, learned, random = np.moveaxis(10 * np.log10(gains), 1, 0)
    return PhaseTrack(np.stack(differences), learned - reference, random - reference)


def plot_phases(track: PhaseTrack, path: Path) -> None:
    """Write how commanded phases differ from the aligned ones, and what that does to the channel, as a PNG or PDF."""
    slots, scenes, _ = track.difference_rad.shape
    with rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH_IN, 3.6), dpi=300, layout="compressed")
        above, below = figure.subplots(2)
        edges = np.arange(-180, 180 + _BIN_DEG, _BIN_DEG)
        counts, _ = np.histogram(np.degrees(track.difference_rad), edges)
        above.stairs(100 * counts / counts.sum(), edges, fill=True, color=STOPS, label="learned")
        above.axhline(100 / len(counts), ls="--", lw=1.0, color=RANDOM, label="random phases")
        above.set(xlim=(-180, 180), xticks=range(-180, 181, 60), xlabel="learned minus aligned phase [°]")
        above.set_ylabel("share of elements [%]")
        _draw_spread(below, track.gain_db, STOPS, "-")
        _draw_spread(below, track.random_gain_db, RANDOM, "--")
        below.axhline(0, lw=0.6, color="black", zorder=1)
        below.annotate(
            "aligned phases",
            (1, 0),
            (-2, 2),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            fontsize=6,
        )
        below.set(xlim=(1, max(slots, 2)), xlabel="slot", ylabel="gain over aligned [dB]")
        below.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        handles, labels = above.get_legend_handles_labels()
        title = f"below: median and middle 80 % of {scenes} scenes"
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, title=title)
        figure.savefig(path)


def _draw_training(axes: Axes, episodes: IntArray, gains: FloatArray) -> None:
    """The mean of `gains` [S, T], with the interval over seeds where there are several."""
    several = len(gains) > 1
    words = f"training, {len(gains)} seeds" if several else "training"
    axes.plot(episodes, gains.mean(0), color=STOPS, lw=1.4, label=words)
    if several:
        axes.fill_between(episodes, *student_interval(gains), color=STOPS, alpha=0.25, lw=0)


def _draw_checkpoints(axes: Axes, judged: Judged) -> None:
    """The gains of checkpoints, with intervals over scenes and seeds."""
    rng = generator(0, Purpose.RESAMPLING)
    rates, bare = judged.sum_rate_bps, judged.bare_bps
    gains = gain_percent(rates.mean((1, 2)), bare.mean((1, 2)))
    ends = [interval(gain_percent, *samples, rng=rng) for samples in zip(rates, bare, strict=True)]
    low, high = np.transpose(ends)
    error = (gains - low, high - gains)
    style: dict[str, Any] = {"color": STOPS, "lw": 1.4, "marker": "o", "ms": 3, "capsize": 2, "elinewidth": 0.8}
    axes.errorbar(judged.episodes, gains, error, label="checkpoints", zorder=3, **style)


def _draw_rivals(axes: Axes, table: pd.DataFrame) -> None:
    gains = dict(zip(table["policy"], table["gain_percent"], strict=True))
    for name, (colour, style) in RIVALS.items():
        if name in gains:
            axes.axhline(gains[name], color=colour, ls=style, lw=1.0, label=name)


def _draw_spread(axes: Axes, values: FloatArray, colour: str, style: str) -> None:
    """Median and middle 80 % over scenes of `values` [T, S]."""
    slot = np.arange(1, len(values) + 1)
    low, median, high = np.percentile(values, [10, 50, 90], axis=1)
    axes.fill_between(slot, low, high, color=colour, alpha=0.25, lw=0)
    axes.plot(slot, median, color=colour, ls=style, lw=1.2)
