"""What the paper says of its figures in numbers, beside what is measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from reference_table import markdown_table, number

from mjris.show.curves import student_interval
from reproduction.curves import BASE, PRESETS

FloatArray = NDArray[np.floating]
Measure = Callable[[pd.DataFrame], FloatArray]
"""From the table of a preset to one value a seed."""


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper."""

    what: str
    unit: str
    printed: float | None
    """The paper's number; None where it says only that the value is above zero."""
    figure: str
    measure: Measure


def over(figure: str, one: tuple[str, str], other: tuple[str, str]) -> Measure:
    """By how much the sum rate of one (curve, scheme) exceeds another's at the end of training [%], by seed."""
    return lambda table: 100 * (last(table, figure, *one) / last(table, figure, *other) - 1)


def last(table: pd.DataFrame, figure: str, curve: str, scheme: str) -> FloatArray:
    """Sum rates [Mb/s] by seed after the last episode."""
    return at(table, figure, curve, scheme).iloc[-1].to_numpy()


def at(table: pd.DataFrame, figure: str, curve: str, scheme: str) -> Any:
    """Sum rates [Mb/s] of a (curve, scheme), a row for every x and a column for every seed."""
    rows = table[(table["figure"] == figure) & (table["curve"] == curve) & (table["scheme"] == scheme)]
    return rows.pivot_table("sum_rate_mbps", "x", "seed").sort_index()


def _antennas(table: pd.DataFrame) -> FloatArray:
    """Four antennas over two [%]: means over all powers and both schemes, by seed."""
    ratios = [at(table, "power", "M = 4", scheme) / at(table, "power", "M = 2", scheme) for scheme in ("noma", "oma")]
    return 100 * (np.mean([ratio.to_numpy().mean(0) for ratio in ratios], 0) - 1)


def _growth(table: pd.DataFrame) -> FloatArray:
    """By how much NOMA's gain over OMA at the highest power exceeds that at the lowest [percent points], by seed."""
    gain = 100 * (at(table, "power", "M = 4", "noma") / at(table, "power", "M = 4", "oma") - 1).to_numpy()
    return gain[-1] - gain[0]


def _coarse(table: pd.DataFrame) -> FloatArray:
    """The learning rate 1e-3 against the mean of 3e-4 and 1e-4, with NOMA [%], by seed."""
    coarse, *others = (last(table, "learning_rate", f"α = {rate:g}", "noma") for rate in (1e-3, 3e-4, 1e-4))
    return 100 * (coarse / np.mean(others, 0) - 1)


def _elements(table: pd.DataFrame) -> FloatArray:
    """OMA with 16 elements over NOMA with 4 [%], by seed."""
    noma, oma = (at(table, "elements", BASE, scheme) for scheme in ("noma", "oma"))
    return 100 * (oma.loc[16.0].to_numpy() / noma.loc[4.0].to_numpy() - 1)


def _episodes(table: pd.DataFrame) -> FloatArray:
    """Episodes that a federation needs for the best that an agent alone reaches, over those that this one needs.

    By seed, on lines between the judged episodes; infinite for a seed whose federation never gets there.
    """
    together, alone = (at(table, "federation", curve, "noma") for curve in ("federation", "one cell"))
    ratios = []
    for seed in alone.columns:
        best = alone[seed].max()
        ratios.append(first_reached(together[seed], best) / first_reached(alone[seed], best))
    return np.array(ratios)


def first_reached(curve: Any, level: float) -> float:
    """Where a series over episodes first has `level`, on straight lines between its points; infinite if nowhere."""
    x, y = curve.index.to_numpy(float), curve.to_numpy()
    reached = np.flatnonzero(y >= level)
    if not len(reached):
        return np.inf
    i = reached[0]
    return x[0] if i == 0 else x[i - 1] + (level - y[i - 1]) / (y[i] - y[i - 1]) * (x[i] - x[i - 1])


_MOBILE, _FIXED, _NONE = (BASE, "noma"), ("fixed RIS", "noma"), ("no RIS", "noma")
_ALIKE, _UNLIKE, _SINGLE = ("DF = 0", "noma"), ("DF = 1", "noma"), ("one cell", "noma")
CLAIMS = (
    Claim("fixed RIS over no RIS", "%", 12.4, "gain", over("gain", _FIXED, _NONE)),
    Claim("mobile RIS over fixed RIS", "%", 15.1, "gain", over("gain", _MOBILE, _FIXED)),
    Claim("mobile RIS over no RIS", "%", 30.1, "gain", over("gain", _MOBILE, _NONE)),
    Claim("random phases over no RIS", "%", None, "gain", over("gain", ("random phases", "noma"), _NONE)),
    Claim("dynamic over static order", "%", 10.2, "gain", over("gain", _MOBILE, ("static order", "noma"))),
    Claim("NOMA over OMA", "%", 42.0, "gain", over("gain", _MOBILE, (BASE, "oma"))),
    Claim("NOMA's gain: 30 dBm less 10 dBm", "points", None, "power", _growth),
    Claim("4 antennas over 2", "%", 11.6, "power", _antennas),
    Claim("α = 1e-3 over 3e-4 and 1e-4", "%", -7.0, "learning_rate", _coarse),
    Claim("OMA, N = 16 over NOMA, N = 4", "%", 0.0, "elements", _elements),
    Claim("DF = 0 over DF = 1", "%", None, "difference_factor", over("difference_factor", _ALIKE, _UNLIKE)),
    Claim("DF = 1 over one cell", "%", 0.0, "difference_factor", over("difference_factor", _UNLIKE, _SINGLE)),
    Claim("episodes, federation / one cell", "", 150 / 250, "federation", _episodes),
)


def compare(table: pd.DataFrame) -> pd.DataFrame:
    """A row for every claim and preset whose figure is in the table: the printed value and the measured interval."""
    rows = []
    for claim in CLAIMS:
        for name in PRESETS:
            part: Any = table[(table["preset"] == name) & table["seed"].notna()]
            if claim.figure not in set(part["figure"]):
                continue
            values = claim.measure(part)
            low, high = student_interval(values) if np.isfinite(values).all() else (np.nan, np.nan)
            rows.append(
                {
                    "claim": claim.what,
                    "unit": claim.unit,
                    "printed": np.nan if claim.printed is None else claim.printed,
                    "preset": name,
                    "measured": np.median(values) if np.isinf(values).any() else values.mean(),
                    "low": low,
                    "high": high,
                    "agrees": verdict(claim, float(low), float(high)),
                }
            )
    return pd.DataFrame(rows)


def verdict(claim: Claim, low: float, high: float) -> str:
    """Whether the interval of what is measured has the printed value, or what else it says."""
    printed = claim.printed
    if np.isnan(low):
        return "no: not every seed gets there"
    if printed is None:
        return "yes" if low > 0 else "no" if high < 0 else "not decided"
    if low <= printed <= high:
        return "yes"
    # Ratios are against one, differences against zero.
    neutral = 0.0 if claim.unit else 1.0
    if printed == neutral:
        return "no"
    same_side = low > neutral if printed > neutral else high < neutral
    if not same_side:
        return "no"
    nearer = abs((low + high) / 2 - neutral) < abs(printed - neutral)
    return "in sign, less" if nearer else "in sign, more"


def markdown(table: pd.DataFrame) -> str:
    """The comparison as Markdown, a row a claim."""
    cells = []
    for what, group in table.groupby("claim", sort=False):
        row: dict[str, Any] = group.iloc[0].to_dict()
        unit = f" {row['unit']}" if row["unit"] else ""
        printed = "> 0" if np.isnan(row["printed"]) else number(row["printed"], _form(row["unit"])) + unit
        cells.append([str(what), printed, *_measured(group, unit)])
    heading = ["the paper's claim", "printed"]
    for name in dict.fromkeys(table["preset"]):
        heading += [f"`{name}` preset", "agrees"]
    return markdown_table(tuple(heading), cells)


def _measured(group: pd.DataFrame, unit: str) -> list[str]:
    cells = []
    rows: Sequence[dict[str, Any]] = group.to_dict("records")  # pyright: ignore[reportAssignmentType]
    for row in rows:
        form = _form(row["unit"])
        if np.isnan(row["low"]):
            value = "–" if np.isinf(row["measured"]) else number(row["measured"], form)
        else:
            value = f"{number(row['measured'], form)} ± {number((row['high'] - row['low']) / 2, form.strip('+'))}{unit}"
        cells += [value, row["agrees"]]
    return cells


def _form(unit: str) -> str:
    return "+.1f" if unit else ".2f"
