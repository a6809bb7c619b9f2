"""Configs with names."""

from dataclasses import replace

from mjris.config.errors import ConfigError
from mjris.config.radio import Radio
from mjris.config.schema import Agent, Config, Federation, Task, World

_THERMAL_DBM_PER_MHZ = -107.0
"""−174 dBm/Hz and a noise figure of 7 dB."""

_PAPER = Config(radio=Radio(element_pattern="isotropic"))

_CLASSIC = Config(
    world=World(drive="kinematic"),
    task=Task(
        end="time_limit",
        motion="goal",
        phase_control="weights",
        power_reference="qos",
        observation="map",
        reward="gain",
    ),
    agent=Agent(network="mlp", batch_size=128, discount=0.9, target_rate=0.005, noise_scale=0.3, caution=1.0),
    federation=Federation(episodes=100, round_episodes=10),
)

_OFFICE = replace(
    _CLASSIC,
    world=replace(_CLASSIC.world, layout="practice", walk_scale_m=0.1),
    radio=Radio(
        carrier_hz=10e9,
        bandwidth_hz=400e6,
        noise_dbm_per_mhz=_THERMAL_DBM_PER_MHZ,
        tx_power_dbm=10.0,
        panel_rows=20,
        panel_cols=20,
    ),
    task=replace(_CLASSIC.task, qos_bps=100e6, horizon_slots=30, ascent_steps=20),
)

_DEMO = replace(_OFFICE, federation=Federation(episodes=30, round_episodes=5))

_WIFI = replace(
    _OFFICE,
    world=replace(_OFFICE.world, layout="office"),
    radio=replace(_OFFICE.radio, carrier_hz=5e9, bandwidth_hz=80e6, panel_rows=16, panel_cols=16),
    task=replace(_OFFICE.task, qos_bps=50e6),
)

_MMWAVE = replace(
    _WIFI,
    radio=replace(_OFFICE.radio, carrier_hz=28e9, tx_power_dbm=15.0, panel_rows=32, panel_cols=32),
)

_PRESETS = {
    "office": _OFFICE,
    "demo": _DEMO,
    "wifi": _WIFI,
    "mmwave": _MMWAVE,
    "paper": _PAPER,
    "classic": _CLASSIC,
}


def preset(name: str) -> Config:
    """A named config.

    "office" is the recommended one, "demo" the same with training of minutes, "wifi" and "mmwave" are other carriers
    in an open office, "paper" the paper's literal agent, and "classic" the recommended agent in the paper's radio.
    docs/regime.md says why. Raises `ConfigError` for any other name.
    """
    if name not in _PRESETS:
        raise ConfigError(f"preset: {name!r} is not known: it is one of {', '.join(_PRESETS)}")
    return _PRESETS[name]
