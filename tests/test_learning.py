"""A short training in a real office: it would not get anywhere if any part of learning broke."""

from dataclasses import replace
from pathlib import Path

from mjris.config import Config, preset
from mjris.eval.evaluate import play
from mjris.eval.policies import agent_policies, reference_controls
from mjris.learn.policy import load_policy
from mjris.learn.run import train


def config() -> Config:
    """Two users in an open office; action zero stays where it is, and whoever follows the map goes elsewhere."""
    office = preset("classic")
    return replace(
        office,
        seed=2,
        world=replace(office.world, layout="open", num_users=2),
        radio=replace(office.radio, num_clusters=1, num_antennas=2),
        task=replace(office.task, motion="waypoint", map_potential=10.0, slots=40),
        agent=replace(
            office.agent, caution=0.1, learning_rate=1e-3, hidden=(64, 64), warmup_slots=100, target_rate=0.01
        ),
        federation=replace(office.federation, episodes=40, round_episodes=5),
    )


def test_three_federated_cells_learn_where_to_drive(tmp_path: Path):
    made = config()
    train(made, tmp_path / "run")
    agent = load_policy(tmp_path / "run")
    agents = agent_policies(lambda observation: agent.predict(observation, deterministic=True)[0])
    judged = {each.name: play(made, each, 24, 77) for each in agents if each.name in ("learned", "no RIS")}
    value = {name: played.value_bps.mean() / 1e6 for name, played in judged.items()}
    still = play(made, reference_controls(), 24, 77).value_bps.mean() / 1e6
    # Three seeds had 0.13 to 0.25 over standing still, and what the map's goals give is 0.32.
    assert value["learned"] > still + 0.06
    assert still > value["no RIS"]
    assert judged["learned"].collisions == 0
