import json
import math

import pytest

from mjris.config import (
    Config,
    ConfigError,
    Federation,
    Radio,
    World,
    dbm_to_w,
    from_dict,
    load,
    preset,
    w_to_dbm,
)

PRESETS = ["paper", "office", "demo", "classic", "wifi", "mmwave"]


@pytest.mark.parametrize("name", PRESETS)
def test_json_round_trip(name, tmp_path):
    path = tmp_path / "config.json"
    path.write_text(preset(name).to_json())
    assert load(path) == preset(name)
    assert from_dict(json.loads(path.read_text())) == preset(name)
    assert from_dict(preset(name).to_dict()) == preset(name)


def test_changed_values_survive_the_round_trip():
    config = Config(
        world=World(num_users=12), radio=Radio(num_clusters=3), federation=Federation(averaging=False), seed=7
    )
    assert from_dict(json.loads(config.to_json())) == config != Config()


def test_missing_fields_take_their_defaults():
    assert from_dict({}) == Config()
    assert from_dict({"radio": {"num_antennas": 8}}) == Config(radio=Radio(num_antennas=8))


def test_presets_are_the_paper_and_what_is_recommended():
    paper, office = preset("paper"), preset("office")
    assert paper.radio.element_pattern == "isotropic"
    assert paper.agent.discount == 1
    assert (paper.task.observation, paper.task.reward) == ("csi", "sum_rate")
    assert (office.task.observation, office.task.reward) == ("map", "gain")
    assert preset("demo").federation.episodes < office.federation.episodes


def test_derived_values():
    radio = Radio(panel_rows=3, panel_cols=5, tx_power_dbm=20, noise_dbm_per_mhz=-30, bandwidth_hz=2e6)
    assert radio.num_elements == 15
    assert radio.tx_power_w == pytest.approx(0.1)
    assert radio.noise_w == pytest.approx(2e-6)
    assert radio.wavelength_m == pytest.approx(0.149896229)
    assert w_to_dbm(dbm_to_w(-37.5)) == pytest.approx(-37.5)


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"radio": {"tx_power_dbm": -3.0}}, "radio.tx_power_dbm"),
        ({"radio": {"tx_power_dbm": math.nan}}, "radio.tx_power_dbm"),
        ({"radio": {"bandwidth_hz": math.inf}}, "radio.bandwidth_hz"),
        ({"radio": {"bandwidth_hz": 0}}, "radio.bandwidth_hz"),
        ({"radio": {"num_antennas": 2.5}}, "radio.num_antennas"),
        ({"radio": {"scheme": "tdma"}}, "radio.scheme"),
        ({"radio": {"difference_factor": 1.1}}, "radio.difference_factor"),
        ({"radio": {"carrier": 2e9}}, "radio.carrier"),
        ({"radio": {"num_clusters": 3}}, "world.num_users"),
        ({"radio": {"num_antennas": 1}}, "radio.num_clusters"),
        ({"world": {"num_users": 0}}, "world.num_users"),
        ({"world": {"num_users": 5}}, "world.num_users"),
        ({"world": {"slot_s": -1}}, "world.slot_s"),
        ({"world": {"drive": "legs"}}, "world.drive"),
        ({"world": {"bumper_m": 0.001}}, "world.bumper_m"),
        ({"world": {"timestep_s": 0.1}}, "world.timestep_s"),
        ({"task": {"qos_penalty": 0.5}}, "task.qos_penalty"),
        ({"task": {"slots": 0}}, "task.slots"),
        ({"agent": {"batch_size": 1}}, "agent.batch_size"),
        ({"agent": {"caution": 0.5}}, "agent.caution"),
        ({"agent": {"hidden": [128, 0]}}, "agent.hidden.1"),
        ({"federation": {"workers": -1}}, "federation.workers"),
        ({"federation": {"first_weights": "mine"}}, "federation.first_weights"),
        ({"seed": -1}, "seed"),
        ({"sede": 1}, "sede"),
    ],
)
def test_bad_values_are_named(data, field):
    with pytest.raises(ConfigError) as raised:
        from_dict(data)
    message = str(raised.value)
    assert message.startswith(f"config: {field}")
    assert "\n" not in message


def test_a_bad_value_is_quoted():
    with pytest.raises(ConfigError, match=r"radio.tx_power_dbm: -3.0 is not allowed: .*greater than or equal to 0"):
        from_dict({"radio": {"tx_power_dbm": -3.0}})


def test_unknown_preset_names_the_valid_ones():
    with pytest.raises(ConfigError, match="preset: 'attic' is not known: it is one of office, demo, wifi"):
        preset("attic")


def test_bad_files(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.json: cannot be read"):
        load(tmp_path / "nothing.json")
    path = tmp_path / "bad.json"
    path.write_text("{radio")
    with pytest.raises(ConfigError, match=r"bad\.json"):
        load(path)
    path.write_text('{"radio": {"num_antennas": 0}}')
    with pytest.raises(ConfigError, match=r"bad\.json: radio\.num_antennas: 0 is not allowed"):
        load(path)


def test_sections_made_by_hand_name_their_field():
    with pytest.raises(ConfigError, match=r"world\.num_users: 0 is not allowed"):
        World(num_users=0)


@pytest.mark.parametrize(
    ("values", "field"),
    [({"bumper_m": 0.05}, "bumper_m"), ({"clearance_m": 0.05}, "clearance_m"), ({"ticks_per_slot": 2}, "bumper_m")],
)
def test_rover_must_be_able_to_stop(values, field):
    with pytest.raises(ConfigError, match=rf"world\.{field}: .* the rover needs 0\.\d+ m to notice and stop"):
        World(**values)


@pytest.mark.parametrize(
    ("field", "value"),
    [("phase_bits", 0), ("phase_bits", 9), ("dead_share", 1.1), ("least_amplitude", -0.1), ("phase_noise_deg", 181.0)],
)
def test_a_surface_that_cannot_be_is_refused(field, value):
    with pytest.raises(ConfigError, match=rf"radio\.surface\.{field}: {value} is not allowed") as error:
        from_dict({"radio": {"surface": {field: value}}})
    assert "\n" not in str(error.value)
