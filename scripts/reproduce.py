"""Every figure of the paper from agents that are trained here, with intervals, and its claims beside what is measured.

python scripts/reproduce.py [FIGURE ...] [--scale quick|full] [--runs FOLDER] [--out FOLDER]

Figures are path, learning_rate, elements, power, gain, difference_factor, federation, discount, remark and sensitivity;
all by default. Each becomes FIGURE.png and FIGURE.csv in the folder, and the claims whose figures are among them
claims.csv. Intervals are over training seeds and held-out scenes together.
Finished runs and judgements are kept in the folder of runs, so that an interrupted command goes on where it was.
Prints the claims, and who gets the sum rates of the gain figure, as Markdown.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd
import tyro
from judging import commit
from reproduction.claims import compare, markdown
from reproduction.curves import PRESETS, SCALES, TRAINED, Scale
from reproduction.drawing import draw
from reproduction.path import draw_path
from reproduction.remark import draw_remark
from reproduction.remark import measure as measure_remark
from reproduction.results import measure, shares, summary
from reproduction.sensitivity import draw_sensitivity
from reproduction.sensitivity import measure as measure_sensitivity

from mjris.config import ConfigError
from mjris.simulation.streams import Purpose, generator

Name = Literal[
    "path",
    "learning_rate",
    "elements",
    "power",
    "gain",
    "difference_factor",
    "federation",
    "discount",
    "remark",
    "sensitivity",
]

EVERYTHING: tuple[Name, ...] = get_args(Name)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What to reproduce."""

    figures: tyro.conf.Positional[tuple[Name, ...]] = EVERYTHING
    """Figures."""
    scale: Literal["quick", "full"] = "quick"
    """quick: to see them all; full: what docs/reproduction.md shows."""
    runs: Path = Path("runs/reproduction")
    """Where runs and judgements are kept."""
    out: Path | None = None
    """Where figures and tables go, RUNS/SCALE by default."""


def main(options: Options) -> None:
    """Train, judge, draw, compare."""
    out = options.out or options.runs / options.scale
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: {out} cannot be written: {error.strerror}") from None
    reproduce(options.figures, SCALES[options.scale], options.runs, out)


def reproduce(figures: tuple[str, ...], scale: Scale, runs: Path, out: Path) -> None:
    """Make the figures at a scale."""
    trained = [name for name in figures if name in TRAINED]
    if trained:
        curves = [curve for name in PRESETS for figure in trained for curve in TRAINED[figure](name, scale)]
        table = measure(curves, scale, runs)
        points = summary(table)
        for figure in trained:
            rows: Any = points[points["figure"] == figure]
            _write(rows.drop(columns="figure"), out / f"{figure}.csv")
            draw(rows, figure, out / f"{figure}.png")
            if figure == "gain":
                print(f"{shares(rows)}\n")
        claims = compare(table)
        _write(claims, out / "claims.csv")
        print(markdown(claims))
    if "path" in figures:
        draw_path(scale, runs, out / "path.png")
    if "remark" in figures:
        found, rewards = measure_remark(generator(0, Purpose.STUDY))
        _write(pd.concat([found, rewards]).assign(commit=commit()), out / "remark.csv")
        draw_remark(found, rewards, out / "remark.png")
    if "sensitivity" in figures:
        rows = measure_sensitivity(scale, runs)
        _write(rows, out / "sensitivity.csv")
        draw_sensitivity(rows, out / "sensitivity.png")
    print(f"\nThe figures are in {out}.")


def _write(table: pd.DataFrame, path: Path) -> None:
    table.to_csv(path, index=False, float_format="%.6g")


if __name__ == "__main__":
    try:
        main(tyro.cli(Options, description=__doc__))
    except ConfigError as error:
        sys.exit(str(error))
