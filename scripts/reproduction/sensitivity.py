"""How the headline gains move with what the paper leaves open, one parameter at a time."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from judging import Scores, agent_scores, each, kept, rival_file, train
from matplotlib import rc_context
from matplotlib.figure import Figure

from mjris.assets import assets_dir
from mjris.config import Config
from mjris.eval.intervals import gain_percent, interval
from mjris.eval.playing import play
from mjris.eval.policies import reference_controls
from mjris.learn.study import run_folder
from mjris.show.curves import student_interval
from reproduction.curves import Scale, base
from reproduction.drawing import STYLE, WIDTH_IN
from reproduction.results import SCENE_SEED

GAINS = {
    "mobile over no RIS": ("#0072b2", "o"),
    "fixed over no RIS": ("#d55e00", "^"),
    "NOMA over OMA": ("#e69f00", "s"),
}
"""The headline gains, with their colours and markers."""
_AS_IS = "as it is"


@dataclass(frozen=True)
class Variant:
    """One parameter with another value."""

    parameter: str
    value: str
    config: Config


def variants(scale: Scale, layouts: Path) -> list[Variant]:
    """The `office` preset, and each open parameter with other values; layouts of their own go to a folder."""
    changes: dict[str, Mapping[str, Mapping[str, Any]]] = {
        _AS_IS: {},
        "AP place: north-west corner": {"world": {"layout": _with_ap(layouts, "corner", (0.4, 19.6, 2.6), 315.0)}},
        "AP place: east wall": {"world": {"layout": _with_ap(layouts, "east", (14.8, 10.0, 2.6), 180.0)}},
        "antennas M: 2": {"radio": {"num_antennas": 2}},
        "antennas M: 8": {"radio": {"num_antennas": 8}},
        "elements N: 4": {"radio": {"panel_rows": 2, "panel_cols": 2}},
        "elements N: 64": {"radio": {"panel_rows": 8, "panel_cols": 8}},
        "Rician K: 0 dB": {"radio": {"rician_k_db": 0.0}},
        "Rician K: 13 dB": {"radio": {"rician_k_db": 13.0}},
        "element gain: isotropic": {"radio": {"element_pattern": "isotropic"}},
        "element gain: cosine, n = 1": {"radio": {"element_exponent": 1.0}},
        "furniture: jitter of 0.3 m": {"world": {"layout_jitter_m": 0.3}},
        "furniture: open": {"world": {"layout": "open"}},
        "furniture: clinic": {"world": {"layout": "clinic"}},
        "step length: 0 m": {"world": {"walk_scale_m": 0.0}},
        "step length: 0.6 m": {"world": {"walk_scale_m": 0.6}},
        "slots: half": {"task": {"slots": max(1, scale.slots // 2)}},
        "slots: double": {"task": {"slots": 2 * scale.slots}},
    }
    found = []
    for name, sections in changes.items():
        parameter, _, value = name.partition(": ")
        config = base("office", scale)
        config = replace(config, **{key: replace(getattr(config, key), **fields) for key, fields in sections.items()})
        found.append(Variant(parameter, value, config))
    return found


def discounts(scale: Scale) -> list[Variant]:
    """What only training knows: the discount γ."""
    return [
        Variant("discount γ", f"{discount:g}, trained", base("office", scale, agent={"discount": discount}))
        for discount in (0.0, 0.9, 0.99)
    ]


def measure(scale: Scale, runs: Path) -> pd.DataFrame:
    """A row for every variant and gain: value, low and high [%].

    The closed forms of the `office` preset, which its agents come within some percent of, tell what an environment is
    worth, with intervals over scenes. The discount changes agents only: they are trained, with intervals over seeds.
    """
    plain = variants(scale, runs / "layouts")
    trained = discounts(scale)
    seeded = [[replace(variant.config, seed=seed) for seed in scale.seeds] for variant in trained]
    train([config for configs in seeded for config in configs], runs)
    judged = [
        [
            (agent_scores, run_folder(own, runs), variant.config.federation.episodes, 0, scale.scenes, SCENE_SEED)
            for own in configs
        ]
        for variant, configs in zip(trained, seeded, strict=True)
    ]
    scores = each([(headline, variant.config, scale.scenes, runs) for variant in plain])
    rows = [
        {"parameter": variant.parameter, "value": variant.value, "gain": gain, "percent": row[gain]}
        | {end: row[f"{gain}, {end}"] for end in ("low", "high")}
        for variant, row in zip(plain, scores, strict=True)
        for gain in GAINS
    ]
    for variant, jobs in zip(trained, judged, strict=True):
        gains = 100 * (np.array([row["sum_rate_mbps"] for row in each(jobs)]) / scores[0]["no RIS"] - 1)
        low, high = student_interval(gains)
        rows.append(
            {"parameter": variant.parameter, "value": variant.value, "gain": "mobile over no RIS"}
            | {"percent": gains.mean(), "low": low, "high": high}
        )
    return pd.DataFrame(rows)


def headline(config: Config, scenes: int, runs: Path) -> Scores:
    """The gains of `GAINS` [%] with 95 % intervals over scenes, and the sum rate without RIS [Mb/s]."""

    def judge() -> Scores:
        rng = np.random.default_rng(SCENE_SEED)
        closed = reference_controls()
        rates = {}
        for name, ris, scheme in (
            ("mobile", "mobile", "noma"),
            ("fixed", "fixed", "noma"),
            ("none", "none", "noma"),
            ("OMA", "mobile", "oma"),
        ):
            policy = replace(closed, changes={"task": {**closed.changes["task"], "ris": ris}})
            own = replace(config, radio=replace(config.radio, scheme=scheme))
            rates[name] = play(own, policy, scenes, SCENE_SEED).sum_rate_bps
        pairs = dict(zip(GAINS, (("mobile", "none"), ("fixed", "none"), ("mobile", "OMA")), strict=True))
        scores: Scores = {"no RIS": rates["none"].mean() / 1e6}
        for gain, (one, other) in pairs.items():
            scores[gain] = float(gain_percent(rates[one].mean(), rates[other].mean()))
            low, high = interval(gain_percent, rates[one], rates[other], rng=rng)
            scores |= {f"{gain}, low": low, f"{gain}, high": high}
        return scores

    return kept(rival_file(config, runs, f"headline_{scenes}_{SCENE_SEED}"), judge)


def draw_sensitivity(table: pd.DataFrame, path: Path) -> None:
    """Write a row for every value of every parameter, with a mark for each gain."""
    names = list(dict.fromkeys(zip(table["parameter"], table["value"], strict=True)))
    with rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH_IN, 0.17 * len(names) + 0.9), dpi=300, layout="constrained")
        axes = sheet.add_subplot()
        for offset, (gain, (colour, marker)) in zip((-0.22, 0.0, 0.22), GAINS.items(), strict=True):
            rows: Any = table[table["gain"] == gain]
            places = [names.index(key) + offset for key in zip(rows["parameter"], rows["value"], strict=True)]
            spread = np.abs(rows[["low", "high"]].to_numpy().T - rows["percent"].to_numpy())
            axes.errorbar(
                rows["percent"], places, xerr=spread, color=colour, marker=marker, ms=3, ls="", lw=0.7, label=gain
            )
            axes.axvline(rows["percent"].iloc[0], color=colour, lw=0.5, ls=":", zorder=0)
        starts = [i for i, (parameter, _) in enumerate(names) if i and parameter != names[i - 1][0]]
        for start in starts:
            axes.axhline(start - 0.5, color="#dddddd", lw=0.5, zorder=0)
        words = [f"{parameter}: {value}" if value else parameter for parameter, value in names]
        axes.set_yticks(range(len(names)), words)
        axes.set(ylim=(len(names) - 0.5, -0.5), xlabel="gain [%]")
        axes.tick_params(axis="y", length=0)
        sheet.legend(loc="outside lower center", ncols=3, handlelength=1, columnspacing=1)
        sheet.savefig(path)


def _with_ap(folder: Path, name: str, position: tuple[float, float, float], facing_deg: float) -> str:
    """Path of the default office with its AP elsewhere."""
    text = (assets_dir() / "layouts" / "office.toml").read_text()
    text, places = re.subn(r"(?m)^ap\.position = .*$", f"ap.position = {list(position)}", text)
    text, turns = re.subn(r"(?m)^ap\.facing_deg = .*$", f"ap.facing_deg = {facing_deg}", text)
    assert places == turns == 1
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"office_ap_{name}.toml"
    path.write_text(text)
    return str(path)
