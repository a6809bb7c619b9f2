"""Speed of mjris as a table, medians and ranges; ratios compare runs of the same minute.

python scripts/bench.py [PART ...] [--quick] [--check] [--save]

Parts are simulator, sight, training, optimum, filming and starting; all by default. The committed ratios stand in
docs/bench.json: --check ends with status 1 where one has lost more than a quarter, --save writes them anew.
"""

import json
import os
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mjris.config import preset

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is loaded
import measures

Part = Literal["simulator", "sight", "training", "optimum", "filming", "starting"]
EVERYTHING: tuple[Part, ...] = get_args(Part)
REFERENCE = Path(__file__).parent.parent / "docs" / "bench.json"
_LOSS = 0.25
"""What a ratio may lose before a check fails."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What to measure."""

    parts: tyro.conf.Positional[tuple[Part, ...]] = EVERYTHING
    """What to measure."""
    quick: bool = False
    """A tenth of the work: a check that it runs, not a measure."""
    check: bool = False
    """Fail where a ratio has lost more than a quarter of the committed one."""
    save: bool = False
    """Write the ratios to docs/bench.json, over those of the same names."""


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    name: str
    values: list[float]
    form: str
    wanted: str = ""
    ratio: bool = False
    """Whether the committed value is a yardstick: rates depend on the machine, ratios hardly."""

    @property
    def median(self) -> float:
        """Of all turns."""
        return statistics.median(self.values)


def main(options: Options) -> int:
    """Measure, print, and compare or save."""
    console, rows = Console(), list[Row]()
    for part in options.parts:
        rows += _show(console, part, _PARTS[part](options.quick))
    found = {row.name: row.median for row in rows if row.ratio}
    known: dict[str, float] = json.loads(REFERENCE.read_text()) if REFERENCE.exists() else {}
    if options.save:
        REFERENCE.write_text(
            json.dumps(known | {name: round(value, 3) for name, value in found.items()}, indent=2) + "\n"
        )
    if not options.check:
        return 0
    lost = [name for name, value in found.items() if name in known and value < (1 - _LOSS) * known[name]]
    for name in lost:
        console.print(f"{name}: {found[name]:.3g}, where {known[name]:.3g} is committed", markup=False)
    return int(bool(lost))


def _show(console: Console, part: Part, rows: list[Row]) -> list[Row]:
    table = Table("measured", "median", "least … most", "wanted", title=part)
    for row in rows:
        low, high = min(row.values), max(row.values)
        table.add_row(escape(row.name), f"{row.median:{row.form}}", f"{low:{row.form}} … {high:{row.form}}", row.wanted)
    console.print(table)
    return rows


def ratios(values: list[float], others: list[float]) -> list[float]:
    """Each value by that of the same turn."""
    return [a / b for a, b in zip(values, others, strict=True)]


def simulator(quick: bool) -> list[Row]:
    """Slots a second, everything included, under random actions."""
    repeats, slots = (3, 5) if quick else (7, 50)
    one, two, single, bare = measures.kinematic(preset("paper"), repeats, slots)
    office = measures.kinematic(preset("classic"), repeats, max(2, slots // 5))
    few, many = measures.elements(preset("classic"), repeats, 4 * slots)
    ours, physics = measures.wheels(preset("paper"), repeats, max(2, slots // 5))
    return [
        Row("kinematic, E = 64, one process [slots/s]", one, ",.0f"),
        Row("kinematic, E = 64, two processes [slots/s]", two, ",.0f", "20,000"),
        Row("kinematic, E = 1 [slots/s]", single, ",.0f", "2,000"),
        Row("matrices of one cell alone [steps/s]", bare, ",.0f"),
        Row("kinematic, E = 64, one process / matrices alone", ratios(one, bare), ".2f", ratio=True),
        Row("kinematic, E = 64, two processes / matrices alone", ratios(two, bare), ".2f", "2", ratio=True),
        Row("kinematic, E = 1 / matrices alone", ratios(single, bare), ".3f", ratio=True),
        Row("classic task, E = 64, one process [slots/s]", office[0], ",.0f"),
        Row("classic task, E = 64, two processes [slots/s]", office[1], ",.0f"),
        Row("classic task, E = 1 [slots/s]", office[2], ",.0f"),
        Row("classic task, E = 64, one process / matrices alone", ratios(office[0], office[3]), ".3f", ratio=True),
        Row("classic task, E = 1, N = 16 [ms a slot]", few, ".2f"),
        Row("classic task, E = 1, N = 1,024 [ms a slot]", many, ".2f"),
        Row("N = 16 / N = 1,024", ratios(few, many), ".2f", "0.40", ratio=True),
        Row("wheels, E = 64 [slots/s]", ours, ",.0f"),
        Row("bare Batch.step of the same model [slots/s]", physics, ",.0f"),
        Row("wheels / bare Batch.step", ratios(ours, physics), ".2f", "0.80", ratio=True),
    ]


def sight(quick: bool) -> list[Row]:
    """Links a second."""
    ours, rays = measures.sight(3 if quick else 7, 5 if quick else 100)
    return [
        Row("links, all obstacles counted, E = 64 [1/s]", ours, ",.0f", "1,500,000"),
        Row("MuJoCo's rays, first hit, E = 64 [1/s]", rays, ",.0f"),
        Row("links / MuJoCo's rays", ratios(ours, rays), ".2f", ratio=True),
    ]


def training(quick: bool) -> list[Row]:
    """Agent-steps a second, environment and update, of the classic preset and of agents of the paper's size."""
    processes = [{"backend": "processes", "workers": workers} for workers in (1, 2)]
    stacked = {"backend": "stacked"}
    repeats, slots = (1, 20) if quick else (5, 100)
    stock, one, two, stack = measures.federation(preset("classic"), repeats, 4, slots, [*processes, stacked])
    rows = [
        Row("SB3's DDPG MlpPolicy agents, one after another [agent-steps/s]", stock, ",.0f"),
        Row("4 cells, one process [agent-steps/s]", one, ",.0f"),
        Row("4 cells, two workers [agent-steps/s]", two, ",.0f"),
        Row("4 cells, stacked [agent-steps/s]", stack, ",.0f"),
        Row("4 cells, two workers / one process", ratios(two, one), ".2f", "1.60", ratio=True),
        Row("4 cells, stacked / stock SB3", ratios(stack, stock), ".2f", "5", ratio=True),
    ]
    for name, cells, wanted in (("classic", 16, "10"), ("paper", 4, "5"), ("paper", 16, "10")):
        stock, stack = measures.federation(preset(name), repeats, cells, slots, [stacked])
        size = "" if name == "classic" else ", paper's size"
        rows += [
            Row(f"SB3's DDPG beside {cells} cells{size} [agent-steps/s]", stock, ",.0f"),
            Row(f"{cells} cells, stacked{size} [agent-steps/s]", stack, ",.0f"),
            Row(f"{cells} cells, stacked / stock SB3{size}", ratios(stack, stock), ".2f", wanted, ratio=True),
        ]
    return rows


def optimum(quick: bool) -> list[Row]:
    """Milliseconds a slot of the reference optimum, its rival and an agent."""
    theirs, ours, acting = measures.optimum(1 if quick else 5)
    return [
        Row("pymanopt, one start [ms a slot]", [1e3 * time for time in theirs], ".0f"),
        Row("reference optimum [ms a slot]", [1e3 * time for time in ours], ".1f"),
        Row("agent's phases and powers [ms a slot]", [1e3 * time for time in acting], ".2f"),
        Row("pymanopt / reference optimum", ratios(theirs, ours), ".0f", "10", ratio=True),
        Row("reference optimum / agent's", ratios(ours, acting), ".0f", "20", ratio=True),
    ]


def filming(quick: bool) -> list[Row]:
    """Frames a second."""
    return [
        Row(
            "video of 640 × 480, encoded [frames/s]",
            measures.filming(1 if quick else 5, 2 if quick else 10),
            ".1f",
            "15",
        )
    ]


def starting(quick: bool) -> list[Row]:
    """Seconds until something happens."""
    shown, imported = measures.starting(1 if quick else 7)
    return [Row("mjris --help [s]", shown, ".2f", "0.5"), Row("import mjris [s]", imported, ".2f", "1")]


_PARTS: dict[Part, Callable[[bool], list[Row]]] = {
    "simulator": simulator,
    "sight": sight,
    "training": training,
    "optimum": optimum,
    "filming": filming,
    "starting": starting,
}


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
