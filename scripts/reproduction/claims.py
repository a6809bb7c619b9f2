"""What the paper says of its figures in numbers, beside what is measured and what stands behind it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from points import by_scene
from reference_table import markdown_table, number

from mjris.config import preset
from mjris.eval.intervals import gain_percent, interval
from mjris.simulation.streams import Purpose, generator
from reproduction.curves import BASE, FIXED, PARKED, PRESETS, SELECTING, TURNING
from reproduction.results import BOUND, PLANNER, SCENE_SEED

FloatArray = NDArray[np.floating]
Curves = Mapping[tuple[str, str], pd.DataFrame]
"""Mean sum rates [Mb/s] by curve and scheme: a row for every x, a column for every resample."""
Measure = Callable[[Curves], FloatArray]
"""One value for every resample."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One sentence of the paper."""

    what: str
    behind: str
    """What is compared here."""
    printed: str
    """What the paper says, in its words."""
    value: float | None
    """The same as a number; None where it says only that it is above `neutral`."""
    unit: str = "%"
    neutral: float = 0.0
    """Where there is no gain."""
    figure: str
    measure: Measure
    episodes: Callable[[Curves], tuple[FloatArray, FloatArray]] | None = None
    """The two numbers of episodes that the value is a ratio of."""


def over(one: tuple[str, str], other: tuple[str, str]) -> Measure:
    """By how much the sum rate of one (curve, scheme) exceeds another's at the end of training [%]."""
    return lambda curves: gain_percent(last(curves, *one), last(curves, *other))


def last(curves: Curves, curve: str, scheme: str) -> FloatArray:
    """Sum rates [Mb/s] after the last episode; those of who does not learn have no other."""
    return curves[curve, scheme].iloc[-1].to_numpy()


def first_reached(x: FloatArray, curves: FloatArray, level: FloatArray) -> FloatArray:
    """Where curves [X, B] over `x` [X] first have a level [B], on lines between their points; infinite if nowhere."""
    reached, columns = curves >= level, np.arange(curves.shape[1])
    at = reached.argmax(0)
    before = np.maximum(at - 1, 0)
    start, end = curves[before, columns], curves[at, columns]
    share = np.divide(level - start, end - start, out=np.zeros(len(level)), where=at > 0)
    return np.where(reached.any(0), x[before] + share * (x[at] - x[before]), np.inf)


def _mobile_to_fixed(curves: Curves) -> FloatArray:
    """The gain of the mobile RIS over no RIS, over that of the fixed one."""
    return over(_MOBILE, _NONE)(curves) / over(_FIXED, _NONE)(curves)


def _antennas(curves: Curves) -> FloatArray:
    """Four antennas over two [%]: means over all powers and both schemes."""
    ratios = [curves["M = 4", scheme] / curves["M = 2", scheme] for scheme in ("noma", "oma")]
    return 100 * (np.mean([ratio.to_numpy().mean(0) for ratio in ratios], 0) - 1)


def _growth(curves: Curves) -> FloatArray:
    """By how much NOMA's gain over OMA at the highest power exceeds that at the lowest [percent points]."""
    gain = gain_percent(curves["M = 4", "noma"].to_numpy(), curves["M = 4", "oma"].to_numpy())
    return gain[-1] - gain[0]


def _coarse(curves: Curves) -> FloatArray:
    """The learning rate 1e-3 against the mean of 3e-4 and 1e-4, with NOMA [%]."""
    coarse, *others = (last(curves, f"α = {rate:g}", "noma") for rate in (1e-3, 3e-4, 1e-4))
    return gain_percent(coarse, np.mean(others, 0))


def _elements(curves: Curves) -> FloatArray:
    """OMA with 16 elements over NOMA with 4 [%]."""
    return gain_percent(curves[BASE, "oma"].loc[16.0].to_numpy(), curves[BASE, "noma"].loc[4.0].to_numpy())


def _episodes(curves: Curves) -> tuple[FloatArray, FloatArray]:
    """Episodes after which a federation's curve, and that of an agent alone, first have the best of the latter."""
    together, alone = curves["federation", "noma"], curves["one cell", "noma"]
    best = alone.to_numpy().max(0)
    reached = [first_reached(curve.index.to_numpy(float), curve.to_numpy(), best) for curve in (together, alone)]
    return reached[0], reached[1]


def _time(curves: Curves) -> FloatArray:
    together, alone = _episodes(curves)
    return together / alone


_MOBILE, _FIXED, _NONE = (BASE, "noma"), (FIXED, "noma"), ("no RIS", "noma")
_ALIKE, _UNLIKE, _SINGLE = ("DF = 0", "noma"), ("DF = 1", "noma"), ("one cell", "noma")
_FADING = "three cells with averaging"
CLAIMS = (
    Claim(
        what="fixed RIS over no RIS",
        behind="parked at the start, facing between AP and the room's middle",
        printed="12.4 %",
        value=12.4,
        figure="gain",
        measure=over(_FIXED, _NONE),
    ),
    Claim(
        what="mobile RIS over fixed RIS",
        behind="the mobile panel turns to AP and users where the preset's pan is auto, the fixed one does not",
        printed="15.1 %",
        value=15.1,
        figure="gain",
        measure=over(_MOBILE, _FIXED),
    ),
    Claim(
        what="mobile RIS over a parked one that turns",
        behind="both panels turn: what driving alone gives",
        printed="15.1 %",
        value=15.1,
        figure="gain",
        measure=over(_MOBILE, (TURNING, "noma")),
    ),
    Claim(
        what="mobile RIS over the best-placed fixed RIS",
        behind="closed forms at the one place and heading that are best over other scenes; not in the paper",
        printed="–",
        value=None,
        figure="gain",
        measure=over(_MOBILE, (PARKED, "noma")),
    ),
    Claim(
        what="mobile RIS over no RIS",
        behind="an agent that learned without RIS",
        printed="30.1 %",
        value=30.1,
        figure="gain",
        measure=over(_MOBILE, _NONE),
    ),
    Claim(
        what="gain of the mobile RIS / of the fixed one",
        behind="both over no RIS",
        printed="about 3 times",
        value=3.0,
        unit="times",
        neutral=1.0,
        figure="gain",
        measure=_mobile_to_fixed,
    ),
    Claim(
        what="random phases over no RIS",
        behind="phases drawn anew in every slot",
        printed="diminutive gain",
        value=None,
        figure="gain",
        measure=over(("random phases", "noma"), _NONE),
    ),
    Claim(
        what="dynamic over static order",
        behind="powers and phases know the order; who has no power decodes for nobody",
        printed="10.2 %",
        value=10.2,
        figure="gain",
        measure=over(_MOBILE, ("static order", "noma")),
    ),
    Claim(
        what="NOMA over OMA",
        behind="OMA serves every user; NOMA may leave users out where QoS cannot be had",
        printed="42 %",
        value=42.0,
        figure="gain",
        measure=over(_MOBILE, (BASE, "oma")),
    ),
    Claim(
        what="NOMA over OMA that selects users",
        behind="both may leave users out: what superposition gives; not in the paper",
        printed="–",
        value=None,
        figure="gain",
        measure=over(_MOBILE, (SELECTING, "oma")),
    ),
    Claim(
        what="NOMA's gain: 30 dBm less 10 dBm",
        behind="OMA serves every user",
        printed="higher with power",
        value=None,
        unit="points",
        figure="power",
        measure=_growth,
    ),
    Claim(
        what="4 antennas over 2",
        behind="mean over powers and schemes",
        printed="11.6 %",
        value=11.6,
        figure="power",
        measure=_antennas,
    ),
    Claim(
        what="α = 1e-3 over 3e-4 and 1e-4",
        behind="NOMA, after the last episode",
        printed="−7 %",
        value=-7.0,
        figure="learning_rate",
        measure=_coarse,
    ),
    Claim(
        what="OMA, N = 16 over NOMA, N = 4",
        behind="OMA serves every user",
        printed="equivalent",
        value=0.0,
        figure="elements",
        measure=_elements,
    ),
    Claim(
        what="DF = 0 over DF = 1",
        behind=_FADING,
        printed="better",
        value=None,
        figure="difference_factor",
        measure=over(_ALIKE, _UNLIKE),
    ),
    Claim(
        what="DF = 1 over one cell",
        behind=f"{_FADING}, and one by itself",
        printed="equivalent",
        value=0.0,
        figure="difference_factor",
        measure=over(_UNLIKE, _SINGLE),
    ),
    Claim(
        what="episodes for equal sum rate, federation / one cell",
        behind="until the mean curve has the best of one cell's mean curve",
        printed="150 / 250 episodes",
        value=150 / 250,
        unit="times",
        neutral=1.0,
        figure="federation",
        measure=_time,
        episodes=_episodes,
    ),
)


def compare(table: pd.DataFrame) -> pd.DataFrame:
    """A row for every claim and preset whose figure is in the table of `results.measure`.

    With the printed value, the measured one, its 95 % interval over seeds and scenes together, and a verdict.
    """
    rng = generator(SCENE_SEED, Purpose.RESAMPLING)
    rows = []
    for claim in CLAIMS:
        for name in PRESETS:
            part: Any = table[(table["preset"] == name) & (table["figure"] == claim.figure)]
            if len(part):
                rows.append(_row(claim, name, part[~part["curve"].isin((PLANNER, BOUND))], rng))
    return pd.DataFrame(rows)


def _row(claim: Claim, name: str, part: pd.DataFrame, rng: np.random.Generator) -> dict[str, Any]:
    groups: dict[Any, dict[Any, Any]] = {
        key: dict(list(rows.groupby("x", dropna=False))) for key, rows in part.groupby(["curve", "scheme"])
    }
    samples = [np.stack([by_scene(rows, "sum_rate_mbps") for rows in points.values()]) for points in groups.values()]

    def curves(means: Sequence[FloatArray]) -> Any:
        pairs = zip(groups.items(), means, strict=True)
        return {key: pd.DataFrame(mean, index=pd.Index(list(points))) for (key, points), mean in pairs}

    found = curves([sample.mean((-2, -1))[:, None] for sample in samples])
    low, high = interval(lambda *means: claim.measure(curves(means)), *samples, rng=rng)
    said = ""
    if claim.episodes is not None:
        first = min(x for points in groups.values() for x in points)
        said = " / ".join(_count(episodes[0], first) for episodes in claim.episodes(found)) + " episodes"
    return {
        "claim": claim.what,
        "behind": claim.behind,
        "printed": claim.printed,
        "unit": claim.unit,
        "preset": name,
        "measured": claim.measure(found)[0],
        "low": low,
        "high": high,
        "in_its_form": said,
        "agrees": verdict(claim, low, high),
    }


def _count(episodes: float, first: float) -> str:
    """Episodes in words, of which nothing is known before the first judgement."""
    if np.isinf(episodes):
        return "never"
    return f"at most {episodes:.0f}" if episodes == first else f"{episodes:.0f}"


def verdict(claim: Claim, low: float, high: float) -> str:
    """Whether the interval of what is measured has the printed value, or what else it says."""
    value, neutral = claim.value, claim.neutral
    if value is None:
        return "yes" if low > neutral else "no" if high < neutral else "not decided"
    if low <= value <= high:
        # An interval that has the value and no gain at all agrees with both.
        return "not decided" if value != neutral and low <= neutral <= high else "yes"
    same_side = low > neutral if value > neutral else high < neutral
    if value == neutral or not same_side:
        return "no"
    nearer = abs((low + high) / 2 - neutral) < abs(value - neutral)
    return "in sign, less" if nearer else "in sign, more"


def markdown(table: pd.DataFrame) -> str:
    """The comparison as Markdown, a row a claim; below it, what the presets are."""
    cells = []
    for what, group in table.groupby("claim", sort=False):
        row: dict[str, Any] = group.iloc[0].to_dict()
        cells.append([str(what), row["behind"], row["printed"], *_measured(group)])
    heading = ["claim", "what stands behind it here", "the paper"]
    names = list(dict.fromkeys(table["preset"]))
    for name in names:
        heading += [f"`{name}` preset", "agrees"]
    return "\n".join([markdown_table(tuple(heading), cells), "", *(f"- {setting(name)}" for name in names)])


def setting(name: str) -> str:
    """What of a preset its gains depend on most, in words."""
    config = preset(name)
    world, radio = config.world, config.radio
    return (
        f"`{name}`: {world.drive} drive, {radio.num_elements} {radio.element_pattern} elements, pan {world.pan}, "
        f"{number(radio.noise_dbm_per_mhz, 'g')} dBm/MHz of noise, QoS {config.task.qos_bps / 1e3:g} kb/s"
    )


def _measured(group: pd.DataFrame) -> list[str]:
    cells = []
    rows: Sequence[dict[str, Any]] = group.to_dict("records")  # pyright: ignore[reportAssignmentType]
    for row in rows:
        form = ".2f" if row["unit"] == "times" else "+.1f"
        value = number(row["measured"], form)
        if not np.isnan(row["measured"]):
            value += f" {row['unit']}"
        if not np.isnan(row["low"]):
            value += f" ({number(row['low'], form)} … {number(row['high'], form)})"
        cells += [f"{row['in_its_form']}: {value}" if row["in_its_form"] else value, row["agrees"]]
    return cells
