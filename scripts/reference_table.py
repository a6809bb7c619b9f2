"""What an RIS is worth in random scenes of the office, with the best phases and powers known, beside an upper bound.

python scripts/reference_table.py [--scenes S] [--slots T] [--every T] [--seed S] [--layout NAME] [--out FILE.csv]

Rows, for NOMA and OMA: no RIS; the RIS parked where it starts, its panel turning to AP and users; the planner's drive;
the best placement; and the upper bound for the channels of the best placement. Every scene is an episode with places,
walks and fading of its own.
The best placement is no drive: in every slot the RIS stands where the radio map promises most over the reachable floor,
wherever it stood before, and people walk as if it were parked. It is a best-known place, chosen without knowledge of
the fading. Prints the table as Markdown.
"""

import math
import sys
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from rich.progress import Progress

from mjris.config import Config, ConfigError, preset
from mjris.eval.bound import upper_bound
from mjris.eval.intervals import gain_percent, interval
from mjris.eval.optimum import best_known
from mjris.eval.planner import best_places
from mjris.eval.policies import parked, planned
from mjris.planning.radio_map import penalised
from mjris.radio.links import Channels
from mjris.radio.powers import best_powers
from mjris.simulation.simulator import Simulator
from mjris.simulation.streams import CellId, Purpose, generator

FloatArray = NDArray[np.floating]
T = TypeVar("T")

SCHEMES = ("noma", "oma")


@dataclass(frozen=True, kw_only=True)
class Scenes:
    """What scenes are simulated."""

    scenes: int = 200
    """Random scenes, stepped together."""
    seed: int = 1_000_003
    """The scenes follow from this seed."""
    out: Path | None = None
    """Where the table goes as .csv as well."""

    def __post_init__(self) -> None:
        for name, least in (("scenes", 2), ("slots", 1), ("every", 1), ("seed", 0)):
            if getattr(self, name, least) < least:
                raise ConfigError(f"{name}: {getattr(self, name)} is not allowed: it must be at least {least}")


@dataclass(frozen=True, kw_only=True)
class Study(Scenes):
    """How much is simulated."""

    slots: int = 100
    """Slots of every scene's episode."""
    every: int = 5
    """One of so many slots is judged, the episode's first among them."""
    layout: str = "office"
    """Name of a layout or the path of a layout file."""

    @property
    def judged(self) -> int:
        """Slots of every scene that are judged."""
        return len(range(0, self.slots, self.every))

    @property
    def config(self) -> Config:
        """The recommended config, with fading of its own in every scene."""
        config = preset("classic")
        radio = replace(config.radio, difference_factor=1.0)
        return replace(config, world=replace(config.world, layout=self.layout), radio=radio)


@dataclass(frozen=True)
class Judged:
    """One case in S scenes: means over the judged slots."""

    sum_rate_bps: FloatArray
    """[S] [bit/s]"""
    value_bps: FloatArray
    """The same with the QoS penalty of eq. (R) [S] [bit/s]; NaN for a bound."""
    qos_share: FloatArray
    """Share of slots in which every user meets QoS [S]; NaN for a bound."""
    bound_bps: FloatArray
    """Upper bound for the same channels [S] [bit/s]; NaN without RIS."""
    bare_bps: FloatArray
    """What the same slots give without RIS [S] [bit/s]."""


def main(study: Study) -> None:
    """Play all cases, print the table and write it."""
    with Progress() as progress:
        bar = progress.add_task("slots", total=3 * len(SCHEMES) * study.judged)
        parts = [rows(scheme, compare(scheme, study, lambda: progress.advance(bar)), study) for scheme in SCHEMES]
    finish(pd.concat(parts, ignore_index=True), markdown, study.out)


def compare(scheme: str, study: Study, advance: Callable[[], None]) -> dict[str, Judged]:
    """All cases in the same scenes; `advance` is called 3 times a judged slot."""
    config = replace(study.config, radio=replace(study.config.radio, scheme=scheme))
    bare, parked_ris, placed = standing(config, study, advance)
    nothing = np.full(study.scenes, np.nan)
    bound = Judged(placed.bound_bps, nothing, nothing, placed.bound_bps, placed.bare_bps)
    planner = driving(config, study, advance)
    return {
        "no RIS": bare,
        "parked RIS": parked_ris,
        "planner": planner,
        "best placement": placed,
        "upper bound": bound,
    }


def standing(config: Config, study: Study, advance: Callable[[], None]) -> tuple[Judged, Judged, Judged]:
    """No RIS, the parked RIS and the best placement in the very same slots."""
    rng = generator(study.seed, Purpose.SEARCH)
    bare, fixed, placed = [], [], []
    for simulator in episode(config, study, parked):
        bare.append(without_ris(simulator))
        fixed.append(with_ris(simulator, simulator.scene.channels, rng))
        advance()
        placed.append(with_ris(simulator, channels_at(simulator, best_places(simulator)[0]), rng))
        advance()
    return Judged(*np.mean(bare, 0)), Judged(*np.mean(fixed, 0)), Judged(*np.mean(placed, 0))


def driving(config: Config, study: Study, advance: Callable[[], None]) -> Judged:
    """The planner's drive."""
    rng = generator(study.seed, Purpose.SEARCH)
    judged = []
    for simulator in episode(config, study, planned):
        judged.append(with_ris(simulator, simulator.scene.channels, rng))
        advance()
    return Judged(*np.mean(judged, 0))


def episode(config: Config, study: Study, drive: Callable[[Simulator], FloatArray]) -> Iterator[Simulator]:
    """The simulator in every judged slot of an episode in which `drive` says where to, [E, 2] [m]."""
    simulator = Simulator(config, [CellId(study.seed, scene) for scene in range(study.scenes)])
    phases = np.zeros((study.scenes, simulator.num_elements))
    powers = np.zeros((study.scenes, config.world.num_users))
    for slot in range(study.slots):
        if slot % study.every == 0:
            yield simulator
        simulator.step(drive(simulator), phases, powers)


def channels_at(simulator: Simulator, places: FloatArray) -> Channels:
    """The present channels if the RIS stood at `places` [E, 2] [m] instead; nothing stays moved.

    A panel with a pan joint faces as it would there, and a locked one as it does now.
    """
    fleet, cells = simulator.world.fleet, np.arange(simulator.num_cells)
    here, heading = fleet.xy, fleet.heading
    fleet.place(cells, places, heading)
    channels = simulator.look().channels
    fleet.place(cells, here, heading)
    simulator.look()
    return channels


def without_ris(simulator: Simulator) -> FloatArray:
    """What a slot gives without RIS and with the best powers known: the fields of `Judged`, [5, S]."""
    rates = _bare_rates(simulator)
    return np.stack([*_scores(simulator, rates), np.full(len(rates), np.nan), rates.sum(-1)])


def with_ris(simulator: Simulator, channels: Channels, rng: np.random.Generator) -> FloatArray:
    """What a slot gives over `channels` with the best phases and powers known: the fields of `Judged`, [5, S]."""
    config, clusters = simulator.config, simulator.clusters
    rates = best_known(channels, clusters, config.radio, config.task.qos_bps, rng).rates_bps
    bound = upper_bound(channels, clusters, config.radio)
    return np.stack([*_scores(simulator, rates), bound, _bare_rates(simulator).sum(-1)])


def rows(scheme: str, cases: dict[str, Judged], study: Study) -> pd.DataFrame:
    """One row a case: means over the scenes, with 95 % intervals.

    Gains are over what the very same slots give without RIS: people may stand elsewhere where a rover drives among
    them, because they wait for it.
    """
    rng = generator(study.seed, Purpose.RESAMPLING)
    return pd.DataFrame(
        {
            "scheme": scheme,
            "case": name,
            "scenes": study.scenes,
            "judged_slots": study.judged,
            **statistic("sum_rate_mbps", lambda mean: mean / 1e6, judged.sum_rate_bps, rng=rng),
            **statistic("gain_percent", gain_percent, judged.sum_rate_bps, judged.bare_bps, rng=rng),
            **statistic("penalised_mbps", lambda mean: mean / 1e6, judged.value_bps, rng=rng),
            "qos_percent": 100 * judged.qos_share.mean(),
            "percent_of_its_bound": 100 * judged.sum_rate_bps.mean() / judged.bound_bps.mean(),
        }
        for name, judged in cases.items()
    )


def statistic(
    name: str, of_means: Callable[..., FloatArray], *samples: FloatArray, rng: np.random.Generator
) -> dict[str, float]:
    """A statistic of the samples' means under its `name`, and its interval under name_low and name_high."""
    low, high = interval(of_means, *samples, rng=rng)
    return {name: float(of_means(*(sample.mean() for sample in samples))), f"{name}_low": low, f"{name}_high": high}


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    heading = (
        "scheme",
        "case",
        "sum rate [Mb/s]",
        "over no RIS [%]",
        "penalised [Mb/s]",
        "QoS met [%]",
        "of bound [%]",
    )
    return markdown_table(
        heading,
        [
            [
                row["scheme"].upper(),
                row["case"],
                spread(row, "sum_rate_mbps", ".3f"),
                spread(row, "gain_percent", "+.1f"),
                spread(row, "penalised_mbps", ".3f"),
                number(row["qos_percent"], ".1f"),
                number(row["percent_of_its_bound"], ".1f"),
            ]
            for row in table.to_dict("records")
        ],
    )


def markdown_table(heading: tuple[str, ...], cells: list[list[str]]) -> str:
    """Rows of cells as a Markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [heading, ["---"] * len(heading), *cells])


def spread(row: dict[Hashable, Any], name: str, form: str) -> str:
    """A value and its interval; a dash where there is none."""
    if math.isnan(row[name]):
        return "–"
    return f"{number(row[name], form)} ({number(row[f'{name}_low'], form)} … {number(row[f'{name}_high'], form)})"


def number(value: float, form: str) -> str:
    """A number with a proper minus; a dash for NaN."""
    return "–" if math.isnan(value) else format(value, form).replace("-", "−")


def finish(table: pd.DataFrame, as_markdown: Callable[[pd.DataFrame], str], out: Path | None) -> None:
    """Print the table and write it."""
    print(as_markdown(table))
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(out, index=False, float_format="%.6g")


def _bare_rates(simulator: Simulator) -> FloatArray:
    """Rates of the present slot without RIS, with the best powers known [S, K] [bit/s]."""
    direct = simulator.scene.channels.direct
    return simulator.rates(direct, best_powers(simulator.system, direct))


def _scores(simulator: Simulator, rates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sum rate and value [bit/s], and one where QoS is met, else zero, [S] each."""
    task = simulator.config.task
    met = np.where((rates >= task.qos_bps).all(-1), 1.0, 0.0)
    return rates.sum(-1), penalised(rates, task.qos_bps, task.qos_penalty), met


def command(study: type[T], description: str | None, run: Callable[[T], None]) -> None:
    """Run a study with the flags of the command line; bad input ends in one sentence and status 1."""
    try:
        run(tyro.cli(study, description=description))
    except ConfigError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    command(Study, __doc__, main)
