"""The figures of trained agents: a panel for each preset, a line for each curve, bands over the seeds."""

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mjris.show.curves import running_mean, student_interval
from reproduction.curves import BASE, PRESETS
from reproduction.results import BOUND, PLANNER

STYLE: dict[Any, Any] = {"font.size": 7, "axes.linewidth": 0.6, "legend.frameon": False}
WIDTH_IN = 3.5
"""Half a page."""
AXES = {
    "learning_rate": "episodes of training",
    "elements": "reflecting elements N",
    "power": "power of the AP [dBm]",
    "gain": "episodes of training",
    "difference_factor": "episodes of training",
    "federation": "episodes of training",
}
"""What lies along the x axis."""
_BLUE, _RED, _GREEN, _YELLOW, _PINK, _SKY = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9"
CURVES = {
    BASE: (_BLUE, "o"),
    "M = 4": (_BLUE, "o"),
    "α = 0.0003": (_BLUE, "o"),
    "one cell": (_BLUE, "o"),
    "M = 2": (_YELLOW, "s"),
    "α = 0.001": (_RED, "^"),
    "α = 0.0005": (_YELLOW, "s"),
    "α = 0.0001": (_PINK, "D"),
    "α = 1e-05": ("#7f7f7f", "v"),
    "static order": (_SKY, "s"),
    "fixed RIS": (_RED, "^"),
    "random phases": (_PINK, "D"),
    "no RIS": ("#7f7f7f", "v"),
    "federation": (_GREEN, "P"),
    "DF = 0": (_GREEN, "P"),
    "DF = 0.5": (_SKY, "s"),
    "DF = 1": (_YELLOW, "^"),
    PLANNER: ("#000000", ""),
    BOUND: ("#999999", ""),
}
"""Colours after Okabe and Ito, and markers that stay apart in grey print: blue is always the same agents."""
SCHEMES = {"noma": ("-", "NOMA"), "oma": ("--", "OMA")}


def draw(table: pd.DataFrame, training: pd.DataFrame, figure: str, path: Path) -> None:
    """Write a figure from the rows of its table and, where it is one over episodes, of `results.training`.

    Judged agents are marks with 95 % intervals over seeds, filled for NOMA. Faint lines are running means of training,
    whose scenes are others.
    """
    presets = [name for name in PRESETS if name in set(table["preset"])]
    with rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH_IN, 2.0 * len(presets) + 0.9), dpi=300, layout="constrained")
        panels = sheet.subplots(len(presets), squeeze=False)[:, 0]
        for axes, name in zip(panels, presets, strict=True):
            if len(training):
                _draw_training(axes, training[training["preset"] == name])
            _draw_judged(axes, table[table["preset"] == name])
            axes.set_title(f"{name} preset", fontsize=7)
            axes.set_ylabel("sum rate [Mb/s]")
            if figure == "elements":
                axes.set_xscale("log", base=2)
                axes.set_xticks(sorted(set(table["x"])), [f"{x:g}" for x in sorted(set(table["x"]))])
        panels[-1].set_xlabel(AXES[figure])
        sheet.legend(handles=_legend(table), loc="outside lower center", ncols=3, handlelength=2.6, columnspacing=1.2)
        sheet.savefig(path)


def _draw_training(axes: Axes, table: Any) -> None:
    for (name, scheme), rows in table.groupby(["curve", "scheme"], sort=False):
        seeds = rows.pivot_table("sum_rate_mbps", "x", "seed").sort_index()
        smooth = running_mean(seeds.to_numpy().T).mean(0)
        axes.plot(seeds.index, smooth, color=CURVES[name][0], ls=SCHEMES[scheme][0], lw=0.6, alpha=0.4, zorder=2)


def _draw_judged(axes: Axes, table: Any) -> None:
    for (name, scheme), rows in table.groupby(["curve", "scheme"], sort=False):
        (colour, marker), (line, _) = CURVES[name], SCHEMES[scheme]
        if name in (PLANNER, BOUND):
            style: dict[str, Any] = {"color": colour, "ls": line, "lw": 0.8, "zorder": 1}
            if rows["x"].isna().all():
                axes.axhline(rows["sum_rate_mbps"].item(), **style)
            else:
                axes.plot(rows["x"], rows["sum_rate_mbps"], **style)
            continue
        seeds = rows.pivot_table("sum_rate_mbps", "x", "seed").sort_index()
        mean, (low, _) = seeds.mean(axis=1), student_interval(seeds.to_numpy().T)
        style = {"color": colour, "marker": marker, "ms": 3.5, "ls": line, "lw": 1.1, "zorder": 3}
        face = "white" if scheme == "oma" else colour
        axes.errorbar(seeds.index, mean, yerr=mean - low, elinewidth=0.8, mfc=face, **style)


def _legend(table: pd.DataFrame) -> list[Line2D]:
    """A line for every curve; where there are both schemes, what line stands for which."""
    names = list(dict.fromkeys(table["curve"]))
    names = [name for name in names if name not in (PLANNER, BOUND)] + [PLANNER, BOUND]
    lines = [Line2D([], [], color=CURVES[name][0], marker=CURVES[name][1], ms=3, lw=1.1, label=name) for name in names]
    if len(set(table["scheme"])) > 1:
        lines += [Line2D([], [], color="#444444", ls=line, lw=1.0, label=words) for line, words in SCHEMES.values()]
    return lines
