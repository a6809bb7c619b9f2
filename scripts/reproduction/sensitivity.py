"""How the headline gains move with what the paper leaves open or fixes without a reason, one parameter at a time."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from judging import Scores, each, kept, rival_file
from matplotlib import rc_context
from matplotlib.figure import Figure
from reference_table import statistic

from mjris.assets import assets_dir
from mjris.config import Config
from mjris.eval.intervals import gain_percent
from mjris.eval.playing import play
from mjris.eval.policies import reference_controls
from mjris.simulation.streams import Purpose, generator
from reproduction.curves import Scale, base
from reproduction.drawing import STYLE, WIDTH_IN
from reproduction.results import SCENE_SEED

CASES: dict[str, dict[str, dict[str, Any]]] = {
    "mobile": {},
    "fixed": {"task": {"ris": "fixed"}},
    "none": {"task": {"ris": "none"}},
    "OMA": {"radio": {"scheme": "oma"}},
    "selecting OMA": {"radio": {"scheme": "oma", "oma_selection": True}},
}
"""What is played: closed forms, and what each case changes."""
GAINS = {
    "mobile over no RIS": ("mobile", "none"),
    "fixed over no RIS": ("fixed", "none"),
    "NOMA over OMA": ("mobile", "OMA"),
    "NOMA over OMA that selects users": ("mobile", "selecting OMA"),
}
"""The headline gains: the one case over the other."""
_STYLES = (("#0072b2", "o"), ("#d55e00", "^"), ("#e69f00", "s"), ("#009e73", "D"))
"""Their colours and markers."""
_AS_IS = "as it is"


@dataclass(frozen=True)
class Variant:
    """One parameter with another value, or one and what goes with it."""

    parameter: str
    value: str
    config: Config


def variants(scale: Scale, layouts: Path) -> list[Variant]:
    """The `classic` preset, and each open parameter with other values; layouts of their own go to a folder."""
    changes: dict[str, Mapping[str, Mapping[str, Any]]] = {
        _AS_IS: {},
        "AP place: north-west corner": {"world": {"layout": _with_ap(layouts, "corner", (0.4, 19.6, 2.6), 315.0)}},
        "AP place: east wall": {"world": {"layout": _with_ap(layouts, "east", (14.8, 10.0, 2.6), 180.0)}},
        "antennas M: 2": {"radio": {"num_antennas": 2}},
        "antennas M: 8": {"radio": {"num_antennas": 8}},
        "noise: −45 dBm/MHz": {"radio": {"noise_dbm_per_mhz": -45.0}},
        "noise: −60 dBm/MHz": {"radio": {"noise_dbm_per_mhz": -60.0}},
        "noise: −107 dBm/MHz, thermal": {"radio": {"noise_dbm_per_mhz": -107.0}},
        "power: 10 dBm": {"radio": {"tx_power_dbm": 10.0}},
        "power: 30 dBm": {"radio": {"tx_power_dbm": 30.0}},
        "QoS: 1 kb/s": {"task": {"qos_bps": 1e3}},
        "QoS: 100 kb/s": {"task": {"qos_bps": 1e5}},
        "QoS: 1 Mb/s, thermal noise": {"task": {"qos_bps": 1e6}, "radio": {"noise_dbm_per_mhz": -107.0}},
        "elements N: 4": {"radio": {"panel_rows": 2, "panel_cols": 2}},
        "elements N: 64": {"radio": {"panel_rows": 8, "panel_cols": 8}},
        "Rician K: 0 dB": {"radio": {"rician_k_db": 0.0}},
        "Rician K: 13 dB": {"radio": {"rician_k_db": 13.0}},
        "element gain: isotropic": {"radio": {"element_pattern": "isotropic"}},
        "element gain: isotropic, no pan": {"radio": {"element_pattern": "isotropic"}, "world": {"pan": "locked"}},
        "element gain: cosine, no pan": {"world": {"pan": "locked"}},
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
        config = base("classic", scale)
        config = replace(config, **{key: replace(getattr(config, key), **fields) for key, fields in sections.items()})
        found.append(Variant(parameter, value, config))
    return found


def measure(scale: Scale, runs: Path) -> pd.DataFrame:
    """A row for every variant and gain: value, low and high [%], and the commit that judged.

    The closed forms of the `classic` preset, which its agents come within some percent of, tell what an environment is
    worth. They learn nothing, so that intervals are over scenes.
    """
    plain = variants(scale, runs / "layouts")
    scores = each([(headline, variant.config, scale.scenes, runs) for variant in plain])
    rng = generator(SCENE_SEED, Purpose.RESAMPLING)
    return pd.DataFrame(
        {"parameter": variant.parameter, "value": variant.value, "gain": gain}
        | statistic("percent", gain_percent, rates[one], rates[other], rng=rng)
        | {"judged": rates["judged"]}
        for variant, rates in zip(plain, scores, strict=True)
        for gain, (one, other) in GAINS.items()
    )


def headline(config: Config, scenes: int, runs: Path) -> Scores:
    """Sum rates [S] [Mb/s] of the closed forms, by `CASES`."""

    def judge() -> Scores:
        closed = reference_controls()
        rates: Scores = {}
        for name, sections in CASES.items():
            fields = {key: {**closed.changes.get(key, {}), **sections.get(key, {})} for key in ("task", "radio")}
            policy = replace(closed, changes=fields)
            rates[name] = play(config, policy, scenes, SCENE_SEED).sum_rate_bps / 1e6
        return rates

    return kept(rival_file(config, runs, f"headline_{scenes}_{SCENE_SEED}"), judge)


def draw_sensitivity(table: pd.DataFrame, path: Path) -> None:
    """Write a row for every value of every parameter, with a mark for each gain."""
    names = list(dict.fromkeys(zip(table["parameter"], table["value"], strict=True)))
    with rc_context(STYLE):
        sheet = Figure(figsize=(WIDTH_IN, 0.2 * len(names) + 0.9), dpi=300, layout="constrained")
        axes = sheet.add_subplot()
        for offset, gain, (colour, marker) in zip((-0.27, -0.09, 0.09, 0.27), GAINS, _STYLES, strict=True):
            rows: Any = table[table["gain"] == gain]
            places = [names.index(key) + offset for key in zip(rows["parameter"], rows["value"], strict=True)]
            spread = np.abs(rows[["percent_low", "percent_high"]].to_numpy().T - rows["percent"].to_numpy())
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
        sheet.legend(loc="outside lower center", ncols=2, handlelength=1, columnspacing=1)
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
