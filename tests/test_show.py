# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import os

os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo reads it when it is imported

from dataclasses import replace

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from matplotlib.image import imread

from mjris.config import ConfigError, preset
from mjris.radio.links import Links
from mjris.show.overlay import phase_rgb
from mjris.show.palette import BLOCKED, CLEAR, USERS, rgb, user_colour
from mjris.show.rollout import record
from mjris.show.trajectory import plot_trajectory, shadow
from mjris.show.video import link_lines, snapshot, write_video
from mjris.simulation.task import Task

CONFIG = preset("classic")
SLOTS = 3


@pytest.fixture(scope="module")
def task():
    return Task(CONFIG)


@pytest.fixture(scope="module")
def office(task):
    return task.simulator.world.office(0)


def drive_south_west(task):
    def act(observation):
        assert observation.shape == (1, task.observation_size)
        action = np.zeros((1, task.action_size))
        action[0, :2] = -0.6, -0.6
        return action

    return act


@pytest.fixture(scope="module")
def rollout(task):
    return record(task, drive_south_west(task), SLOTS, seed=5)


def test_a_rollout_keeps_every_tick_and_every_slot(task, office, rollout):
    ticks, users = CONFIG.world.ticks_per_slot, CONFIG.world.num_users
    assert rollout.qpos.shape == (SLOTS * ticks, office.model.nq)
    assert rollout.mocap_pos.shape == (SLOTS * ticks, users, 3)
    assert rollout.blockers.shape == (SLOTS, 2 * users + 1)
    assert rollout.rover_xy.shape == (SLOTS + 1, 2)
    assert [rollout.slot_of(frame) for frame in (0, ticks - 1, ticks, rollout.frames - 1)] == [0, 0, 1, SLOTS - 1]
    np.testing.assert_array_equal(rollout.rover_xy[0], office.layout.start)
    # The last tick of a slot is where the next slot begins, for rover and people.
    start = office.rover_qpos
    np.testing.assert_array_equal(rollout.qpos[ticks - 1 :: ticks, start : start + 2], rollout.rover_xy[1:])
    walks = rollout.mocap_pos[ticks - 1 :: ticks][:, office.mocap_ids, :2]
    np.testing.assert_array_equal(walks, rollout.users_xy[1:])
    assert task.simulator.world.on_tick is None


def test_a_rollout_is_what_the_task_gives(rollout):
    task = Task(CONFIG)
    act = drive_south_west(task)
    observation = task.reset(5)
    for t in range(SLOTS):
        np.testing.assert_array_equal(task.simulator.scene.blockers[0], rollout.blockers[t])
        outcome = task.step(act(observation))
        observation = outcome.observation
        np.testing.assert_array_equal(outcome.slot.rates_bps[0], rollout.rates_bps[t])
        assert outcome.reward[0] == rollout.reward[t]


def test_lines_are_coloured_by_sight():
    ap, panel = np.array([0.0, 0, 2.6]), np.array([4.0, 0, 1.5])
    receivers = np.array([[1.0, 2, 1.1], [3, 3, 1.1]])
    blockers = np.array([0, 2, 1, 0, 0])
    lines = link_lines(Links(2, np.array([4])), ap, panel[None], receivers, blockers)
    users = [(person, end) for end in (ap, panel) for person in receivers]
    ends = [*users, (ap, panel)]
    for line, (start, end), count in zip(lines, ends, blockers, strict=True):
        np.testing.assert_array_equal(line.start, start)
        np.testing.assert_array_equal(line.end, end)
        np.testing.assert_allclose(line.rgba[:3] * 255, rgb(BLOCKED if count else CLEAR))
    assert lines[1].rgba[3] < lines[0].rgba[3]
    assert lines[1].radius_m < lines[0].radius_m


def test_a_video_has_a_frame_a_tick_and_nothing_else_stays(office, rollout, tmp_path):
    heard = []
    path = tmp_path / "new" / "film.mp4"
    write_video(
        CONFIG, office, rollout, path, width=320, height=240, progress=lambda done, total: heard.append((done, total))
    )
    reader = imageio_ffmpeg.read_frames(path)
    header = next(reader)
    assert header["size"] == (320, 240)
    assert header["fps"] == 10
    film = [np.frombuffer(frame, np.uint8).reshape(240, 320, 3) for frame in reader]
    assert len(film) == rollout.frames
    assert heard == [(done, rollout.frames) for done in range(1, rollout.frames + 1)]
    assert list(path.parent.iterdir()) == [path]
    difference = np.abs(film[0].astype(float) - film[-1]).max(-1)
    assert (difference > 30).sum() > 20


def test_a_broken_film_leaves_no_file(office, rollout, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(CONFIG, office, rollout, tmp_path / "film.mp4", width=320, height=240, progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("camera", ["overview", "rover/chase"])
def test_a_snapshot_shows_something(office, rollout, camera):
    picture = snapshot(CONFIG, office, rollout, -1, camera=camera, width=320, height=240)
    assert picture.shape == (240, 320, 3)
    assert picture.dtype == np.uint8
    office_side = picture[:, 100:].reshape(-1, 3)
    assert office_side.std(0).min() > 15
    assert len(np.unique(office_side, axis=0)) > 500


def test_a_snapshot_changes_nothing_in_the_office(office, rollout):
    before = office.scenery.geom_rgba.copy(), office.scenery.geom_matid.copy(), office.scenery.cam_fovy.copy()
    snapshot(CONFIG, office, rollout, 0, width=320, height=240)
    after = office.scenery.geom_rgba, office.scenery.geom_matid, office.scenery.cam_fovy
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old, new)


def test_without_a_panel_its_links_are_not_drawn(office, rollout):
    bare = replace(CONFIG, task=replace(CONFIG.task, ris="none"))
    picture, without = (
        snapshot(config, office, rollout, 0, width=640, height=480)[:, 167:].astype(int) for config in (CONFIG, bare)
    )
    assert (np.abs(picture - without).max(-1) > 30).sum() > 50


def test_bad_wishes_are_refused_in_words(office, rollout, tmp_path):
    with pytest.raises(ConfigError, match="321 × 240"):
        write_video(CONFIG, office, rollout, tmp_path / "film.mp4", width=321, height=240)
    with pytest.raises(ConfigError, match="camera: 'side' is not known: it is one of overview"):
        snapshot(CONFIG, office, rollout, 0, camera="side")


def test_missing_opengl_says_what_to_install(office, rollout, monkeypatch):
    def refuse(model, height, width):
        raise RuntimeError("Cannot initialize a EGL device display")

    monkeypatch.setattr(mujoco, "Renderer", refuse)
    with pytest.raises(ConfigError, match="libegl1 and libgl1-mesa-dri"):
        snapshot(CONFIG, office, rollout, 0)


def test_the_chase_camera_follows_without_turning(office):
    data = mujoco.MjData(office.scenery)
    start = office.rover_qpos
    camera = office.scenery.camera("rover/chase").id
    seen = []
    for x, y, yaw in ((2.0, 3.0, 0.0), (9.0, 12.0, 2.0)):
        data.qpos[start : start + 7] = x, y, 0.08, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
        mujoco.mj_kinematics(office.scenery, data)
        mujoco.mj_camlight(office.scenery, data)
        seen.append((data.cam_xpos[camera] - [x, y, 0], data.cam_xmat[camera].copy()))
    np.testing.assert_allclose(seen[0][0], seen[1][0], atol=1e-12)
    np.testing.assert_allclose(seen[0][1], seen[1][1], atol=1e-12)
    assert seen[0][0][2] > 3


def test_phases_go_round_the_hues():
    assert phase_rgb(-np.pi) == pytest.approx(phase_rgb(np.pi))
    assert phase_rgb(0.0) == pytest.approx((1, 0.25, 0.25))
    assert phase_rgb(2 * np.pi / 3) == pytest.approx((0.25, 1, 0.25))


def test_users_colours_repeat_only_after_all():
    assert len(set(USERS)) == len(USERS)
    assert user_colour(len(USERS)) == user_colour(0)
    assert rgb("#0a80ff") == (10, 128, 255)


def test_the_shadow_is_that_of_the_sight(task, office):
    x, y, hidden = shadow(office, 0.5)
    assert hidden.shape == (len(y), len(x)) == (40, 30)
    points = np.stack([*np.meshgrid(x, y), np.full(hidden.shape, CONFIG.world.user_height_m)], -1).reshape(1, -1, 3)
    start = np.broadcast_to(office.ap_position, points.shape)
    count = task.simulator.world.sight.blockers(start, points)
    np.testing.assert_array_equal(hidden, (count > 0).reshape(hidden.shape))
    assert 0.25 < hidden.mean() < 0.8


def test_the_trajectory_is_drawn(office, rollout, tmp_path):
    path = tmp_path / "new" / "trajectory.png"
    plot_trajectory(office, rollout, path)
    height, width = imread(path).shape[:2]
    assert 900 < width < 1200  # half a page at 300 dpi
    assert 1.0 < height / width < 1.6  # the room is 15 m × 20 m, and a legend is below it
    assert imread(path)[..., :3].min() < 0.2


def test_furniture_before_the_rover_lets_it_be_seen(office, rollout):
    def orange(x, y):
        qpos = rollout.qpos.copy()
        qpos[:, office.rover_qpos : office.rover_qpos + 2] = x, y
        picture = snapshot(CONFIG, office, replace(rollout, qpos=qpos), 0, camera="rover/chase", width=320, height=240)
        red, _, blue = np.moveaxis(picture[:, 90:].astype(int), -1, 0)
        return ((red - blue) > 40).sum()

    pillar = next(item for item in office.layout.obstacles if item.name == "pillar_3")
    x, y = pillar.position
    # The cameras look from the south; the ring round the rover is about as large as the pillar hides.
    assert orange(x, y + 0.7) > 0.6 * orange(x + 3, y + 0.7)
