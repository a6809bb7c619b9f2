"""The figures of trained agents: a panel for each preset, a line for each curve, bars over seeds and scenes."""

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reproduction.curves import BASE, FIXED, PARKED, PRESETS, SELECTING, TURNING
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
    "discount": "episodes of training",
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
    FIXED: (_RED, "^"),
    TURNING: (_YELLOW, "^"),
    PARKED: (_RED, ""),
    SELECTING: (_GREEN, "P"),
    "random phases": (_PINK, "D"),
    "no RIS": ("#7f7f7f", "v"),
    "federation": (_GREEN, "P"),
    "DF = 0": (_GREEN, "P"),
    "DF = 0.5": (_SKY, "s"),
    "DF = 1": (_YELLOW, "^"),
    "γ = 0": (_RED, "^"),
    "γ = 0.9": (_BLUE, "o"),
    "γ = 0.99": (_YELLOW, "s"),
    PLANNER: ("#000000", ""),
    BOUND: ("#999999", ""),
}
"""Colours after Okabe and Ito, and markers that stay apart in grey print, but for who does not learn. Blue is always
the same agents."""
SCHEMES = {"noma": ("-", "NOMA"), "oma": ("--", "OMA")}


def draw(table: pd.DataFrame, figure: str, path: Path) -> None:
    """Write a figure from the rows of its table, see `results.summary`.

    Agents are marks with 95 % intervals where the table has some, filled for NOMA.
    """
    presets = [name for name in PRESETS if name in set(table["preset"])]
    with rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH_IN, 2.0 * len(presets) + 0.9), dpi=300, layout="constrained")
        panels = sheet.subplots(len(presets), squeeze=False)[:, 0]
        for axes, name in zip(panels, presets, strict=True):
            _draw_judged(axes, table[table["preset"] == name])
            axes.set_title(f"{name} preset", fontsize=7)
            axes.set_ylabel("sum rate [Mb/s]")
            if figure == "elements":
                axes.set_xscale("log", base=2)
            ticks = sorted(set(table.loc[table["preset"] == name, "x"].dropna()))
            axes.set_xticks(ticks, [f"{x:g}" for x in ticks], minor=False)
        panels[-1].set_xlabel(AXES[figure])
        sheet.legend(handles=_legend(table), loc="outside lower center", ncols=2, handlelength=2.6, columnspacing=1.2)
        sheet.savefig(path)


def _draw_judged(axes: Axes, table: Any) -> None:
    for (name, scheme), rows in table.groupby(["curve", "scheme"], sort=False):
        (colour, marker), (line, _) = CURVES[name], SCHEMES[scheme]
        if not marker:
            style: dict[str, Any] = {"color": colour, "ls": line, "lw": 0.8, "zorder": 1}
            if rows["x"].isna().all():
                axes.axhline(rows["sum_rate_mbps"].item(), **style)
            else:
                axes.plot(rows["x"], rows["sum_rate_mbps"], **style)
            continue
        rows = rows.sort_values("x")
        mean = rows["sum_rate_mbps"]
        bars = mean - rows["sum_rate_mbps_low"], rows["sum_rate_mbps_high"] - mean
        style = {"color": colour, "marker": marker, "ms": 3.5, "ls": line, "lw": 1.1, "zorder": 3}
        face = "white" if scheme == "oma" else colour
        axes.errorbar(rows["x"], mean, yerr=bars, elinewidth=0.8, mfc=face, **style)


def _legend(table: pd.DataFrame) -> list[Line2D]:
    """A line for every curve; where there are both schemes, what line stands for which."""
    names = list(dict.fromkeys(table["curve"]))
    names = [name for name in names if name not in (PLANNER, BOUND)] + [PLANNER, BOUND]
    lines = [Line2D([], [], color=CURVES[name][0], marker=CURVES[name][1], ms=3, lw=1.1, label=name) for name in names]
    if len(set(table["scheme"])) > 1:
        lines += [Line2D([], [], color="#444444", ls=line, lw=1.0, label=words) for line, words in SCHEMES.values()]
    return lines
