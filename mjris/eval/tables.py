"""Tables for the console, at most 120 columns wide."""

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mjris.simulation.constraints import NAMES


def print_comparison(console: Console, table: pd.DataFrame) -> None:
    """Print the rows of `evaluate.compare`, and below them what cannot stand in columns."""
    console.print(rate_table(table), fairness_table(table))
    for row in table.dropna(subset="heading_deg").to_dict("records"):
        where = f"{row['x_m']:.2f} {row['y_m']:.2f} m, facing {row['heading_deg']:.0f}°"
        console.print(f"{row['policy']}: at {where}, found in other scenes", highlight=False)
    for row in table.dropna(subset="qos_share").to_dict("records"):
        broken = ", ".join(f"{name.removeprefix('violated_')} {row[name]}" for name in _broken_columns() if row[name])
        if broken:
            console.print(f"{row['policy']}: slots that broke a constraint: {broken}", highlight=False)


def print_leakage(table: pd.DataFrame) -> None:
    """Print the rows of `building.leakage_table`."""
    shown = Table(
        title=f"Leakage between floors so far apart: mean (worst) over the floor; noise {table.noise_dbm[0]:.1f} dBm"
    )
    for name in ("apart", "same band", "interference [dBm]", "INR [dB]", "rate lost [%]"):
        shown.add_column(Text(name), justify="right", no_wrap=True)
    for row in table.to_dict("records"):
        shown.add_row(
            str(row["floors_apart"]),
            "yes" if row["same_band"] else "no",
            f"{row['interference_dbm']:.1f} ({row['interference_worst_dbm']:.1f})",
            f"{row['inr_db']:.1f} ({row['inr_worst_db']:.1f})",
            f"{row['rate_lost_percent']:.3f} ({row['rate_lost_worst_percent']:.3f})",
        )
    Console().print(shown)


def rate_table(table: pd.DataFrame) -> Table:
    """Sum rates, gains and what went wrong, of the rows of `evaluate.compare`."""
    shares = [name for name in ("planner", "bound") if f"percent_of_{name}" in table]
    caption = "over no RIS: against the best powers known for the same slots, with the row's own multiple access"
    if shares:
        caption += "; bound: of the slots along the planner's drive"
    shown = _table(f"{table.scenes[0]} held-out scenes, means and 95 % intervals", caption)
    for heading in (
        "sum rate\n\\[Mb/s]",
        "over no RIS\n\\[%]",
        "penalised\n\\[Mb/s]",
        "QoS\nmet",
        *(f"% of\n{name}" for name in shares),
        "broken\nslots",
        "clearance\n\\[m]",
    ):
        shown.add_column(heading, justify="right", overflow="fold")
    for row in table.to_dict("records"):
        played = not pd.isna(row["qos_share"])
        shown.add_row(
            row["policy"],
            f"{row['sum_rate_mbps']:.3f} ({row['sum_rate_low']:.2f}…{row['sum_rate_high']:.2f})",
            f"{row['gain_percent']:+.1f} ({row['gain_low']:+.1f}…{row['gain_high']:+.1f})",
            f"{row['penalised_mbps']:.3f}" if played else "",
            f"{row['qos_share']:.1%}" if played else "",
            *(f"{row[f'percent_of_{name}']:.1f}" for name in shares),
            str(sum(row[name] for name in _broken_columns())) if played else "",
            f"{row['clearance_m']:.3f}" if played else "",
        )
    return shown


def fairness_table(table: pd.DataFrame) -> Table:
    """Who gets the rate, of the same rows but the bound."""
    caption = "low rate: 5th percentile of a scene's users and slots; Jain's: of a slot's users"
    shown = _table("Who gets the rate, means over scenes", caption)
    for heading in (
        "sum rate\n\\[Mb/s]",
        "users' slots\nwith QoS",
        "low rate\n\\[kb/s]",
        "Jain's\nindex",
        "clusters' slots\nthat superpose",
    ):
        shown.add_column(heading, justify="right", overflow="fold")
    for row in table.dropna(subset="qos_share").to_dict("records"):
        shown.add_row(
            row["policy"],
            f"{row['sum_rate_mbps']:.3f}",
            f"{row['user_qos_share']:.1%}",
            f"{row['user_rate_p5_mbps'] * 1e3:.2f}",
            f"{row['jain']:.3f}",
            f"{row['superposing_share']:.1%}",
        )
    return shown


def _broken_columns() -> list[str]:
    """Columns that count slots with a broken constraint; but for QoS, which has a column of its own."""
    return [f"violated_{name}" for name in NAMES if name != "qos"]


def _table(title: str, caption: str) -> Table:
    shown = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown.add_column("policy", overflow="fold")
    return shown
