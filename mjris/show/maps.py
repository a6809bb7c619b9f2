"""Fields over the floor as figures, and laid on the floor of the rendered office."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's names come from a compiled module.
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pandas as pd
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mjris.config import Config, ConfigError
from mjris.eval.floormap import FloorMap
from mjris.show.palette import BOARD, rgb, user_colour
from mjris.world.footprints import footprints
from mjris.world.office import Office, compose

FloatArray = NDArray[np.floating]
FIELDS = ("sight", "snr", "snr_ris", "ris_gain", "rate", "rate_ris", "place_gain")
"""Names of the fields that can be drawn."""

_WIDTH_IN = 3.5
"""Half a page."""
_INK = "#222222"
_TALL, _LOW = "#8a8a8a", "#dedede"
_NOWHERE = "#c4c4c4"
_TEXELS_PER_M = 20
_BAR_M = 0.9
_SHOWN_GROUPS = (0, 1, 2, 3)
_PICTURE = 840, 720
"""Width and height of the rendered office [px]."""


class _Drawn(NamedTuple):
    """A field as it is drawn: values [ny, nx], what they are, and their colours."""

    values: NDArray[Any]
    title: str
    label: str
    norm: Normalize
    colours: Colormap
    ticks: Any = None


def write_maps(
    config: Config, office: Office, floor: FloorMap, leakage: pd.DataFrame | None, on_floor: str, folder: Path
) -> list[Path]:
    """Write map.npz, a figure for each of `FIELDS`, office.png with the field `on_floor` unless that is "none", and
    leakage.csv if there is such a table; all of them or nothing. Returns the paths.

    Raises `ConfigError` for an unknown field, where nothing can be rendered, or where the folder cannot be written.
    """
    if on_floor not in (*FIELDS, "none"):
        raise ConfigError(f"on_floor: {on_floor!r} is not known: it is one of {', '.join(FIELDS)}, none")
    with tempfile.TemporaryDirectory() as scratch:
        drafts = Path(scratch)
        floor.save(drafts / "map.npz")
        for name in FIELDS:
            draw_field(config, office, floor, name, drafts / f"{name}.png")
        if on_floor != "none":
            draw_office(config, office, floor, on_floor, drafts / "office.png")
        if leakage is not None:
            leakage.to_csv(drafts / "leakage.csv", index=False, float_format="%.6g")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            return [Path(shutil.copy(draft, folder)) for draft in sorted(drafts.iterdir())]
        except OSError as error:
            raise ConfigError(f"out: {folder} cannot be written: {error.strerror}") from None


def draw_field(config: Config, office: Office, floor: FloorMap, name: str, path: Path) -> None:
    """Write a field over the plan of the office, with furniture, AP, users and RIS, as a PNG or PDF file."""
    drawn = _drawn(floor)[name]
    x, y, _ = office.layout.room.size
    with rc_context({"font.size": 7, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(_WIDTH_IN, (_WIDTH_IN - 1.0) * y / x + 1.1), dpi=300, layout="compressed")
        axes = figure.add_subplot()
        axes.imshow(drawn.values, origin="lower", extent=(0, x, 0, y), norm=drawn.norm, cmap=drawn.colours, zorder=1)
        draw_furniture(axes, office, config.world.user_height_m)
        draw_boards(axes, office)
        _draw_marks(axes, office, floor)
        axes.set(xlim=(0, x), ylim=(0, y), aspect="equal", xlabel="x [m]", ylabel="y [m]", title=drawn.title)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(6, integer=True))
        _colour_bar(figure, axes, drawn)
        figure.legend(loc="outside lower center", ncols=3, frameon=False, columnspacing=1.0, handletextpad=0.4)
        figure.savefig(path)


def draw_office(config: Config, office: Office, floor: FloorMap, name: str, path: Path) -> None:
    """Write a picture of the office with a field on its floor.

    Raises `ConfigError` where nothing can be rendered.
    """
    drawn = _drawn(floor)[name]
    picture = _render(config, office, floor, _texture(office, drawn))
    width, height = _PICTURE
    with rc_context({"font.size": 8, "axes.linewidth": 0.6}):
        figure = Figure(figsize=(width / 150, (height + 110) / 150), dpi=200, layout="compressed")
        axes = figure.add_subplot()
        axes.imshow(picture, interpolation="antialiased")
        axes.set(title=drawn.title)
        axes.set_axis_off()
        _colour_bar(figure, axes, drawn, location="bottom", shrink=0.6, aspect=40, pad=0.02)
        figure.savefig(path)


def _drawn(floor: FloorMap) -> dict[str, _Drawn]:
    """Every field with its words and colours, named as in `FIELDS`. With and without RIS share one scale."""
    most = int(floor.blockers.max())
    obstacles = BoundaryNorm(np.arange(most + 2) - 0.5, most + 1)
    steps = ListedColormap(colormaps["cividis"](np.linspace(1, 0, most + 1)))
    viridis = colormaps["viridis"].with_extremes(bad=_NOWHERE)
    bare_rate, ris_rate, worth = floor.rate_bps / 1e6, floor.ris_rate_bps / 1e6, floor.place_gain_bps / 1e6
    gain_db = floor.ris_snr_db - floor.snr_db
    snr, rate, gain, value = _span(floor.snr_db, floor.ris_snr_db), _span(ris_rate), _span(gain_db), _span(worth)
    sight_label, value_label = "obstacles in the way (0: line of sight)", "predicted sum rate over no RIS [Mb/s]"
    return {
        "sight": _Drawn(floor.blockers, "Line of sight to the AP", sight_label, obstacles, steps, np.arange(most + 1)),
        "snr": _Drawn(floor.snr_db, "SNR without RIS", "SNR [dB]", snr, viridis),
        "snr_ris": _Drawn(floor.ris_snr_db, "SNR with RIS", "SNR [dB]", snr, viridis),
        "ris_gain": _Drawn(gain_db, "What the RIS adds", "SNR over that without RIS [dB]", gain, viridis),
        "rate": _Drawn(bare_rate, "Rate without RIS", "rate [Mb/s]", rate, viridis),
        "rate_ris": _Drawn(ris_rate, "Rate with RIS", "rate [Mb/s]", rate, viridis),
        "place_gain": _Drawn(worth, "Worth of a place to the RIS", value_label, value, viridis),
    }


def _span(*values: FloatArray) -> Normalize:
    """A linear scale over the values; the highest percent share one colour, as AP and RIS would outshine all else."""
    low, high = np.nanmin(values), max(np.nanpercentile(each, 99) for each in values)
    return Normalize(float(low), float(high))


def draw_furniture(axes: Axes, office: Office, receiver_m: float) -> None:
    """Outlines of all furniture, darker where it stands taller than the receivers [m]."""
    top = office.layout.room.size[2]
    for low, high, colour, words in ((0.0, top, _LOW, "furniture"), (receiver_m, top, _TALL, "above the receivers")):
        style: dict[str, Any] = {"facecolor": colour, "edgecolor": _INK, "linewidth": 0.3, "zorder": 2}
        axes.add_collection(PolyCollection(list(_outlines(office, low, high)), label=words, **style))


def draw_boards(axes: Axes, office: Office) -> None:
    """Fixed panels, as bars with a short arrow where they face; no panel is so wide that its own width would show."""
    for index, panel in enumerate(office.layout.ris):
        facing = np.array([math.cos(panel.facing), math.sin(panel.facing)])
        along = _BAR_M / 2 * np.array([-facing[1], facing[0]])
        middle = np.array(panel.at[:2])
        label = None if index else "fixed panel"
        ends = np.stack([middle - along, middle + along]).T
        axes.plot(*ends, color=BOARD, lw=2.2, solid_capstyle="butt", clip_on=False, zorder=5, label=label)
        arrow = {"arrowstyle": "-|>", "color": BOARD, "lw": 0.8, "mutation_scale": 6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tuple(middle + 0.7 * facing), tuple(middle), arrowprops=arrow, zorder=5)


def _outlines(office: Office, low_m: float, high_m: float) -> FloatArray:
    """Corners of what stands between two heights [m], [B, 4, 2] [m]."""
    solid = footprints([office], low_m, high_m)
    centre, half, axis = (np.moveaxis(part[:, 0], 0, -1) for part in (solid.centre, solid.half, solid.axis))
    along = axis * half[:, :1]
    across = np.stack([-axis[:, 1], axis[:, 0]], -1) * half[:, 1:]
    return np.stack([centre + i * along + j * across for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], 1)


def _draw_marks(axes: Axes, office: Office, floor: FloorMap) -> None:
    style: dict[str, Any] = {"ls": "", "color": "white", "mec": _INK, "mew": 0.7, "clip_on": False, "zorder": 5}
    turn = math.degrees(office.layout.ap.facing) - 90
    axes.plot(*floor.ap_xyz_m[:2], marker=(3, 0, turn), ms=8, label="AP", **style)
    axes.plot(*floor.users_xy_m.T, marker="o", ms=4.5, label="users", **style)
    axes.plot(*floor.ris_xy_m, marker="s", ms=5, label="RIS", **style)
    heading = float(floor.ris_heading_rad)
    tip = floor.ris_xy_m + 1.2 * np.array([math.cos(heading), math.sin(heading)])
    arrow = {"arrowstyle": "-|>", "color": "white", "lw": 1.2, "shrinkA": 2.5, "shrinkB": 0}
    axes.annotate("", tuple(tip), tuple(floor.ris_xy_m), arrowprops=arrow, zorder=4)


def _colour_bar(figure: Figure, axes: Axes, drawn: _Drawn, **place: Any) -> None:
    finite = drawn.values[np.isfinite(drawn.values)]
    above = "max" if finite.max() > (drawn.norm.vmax or np.inf) else "neither"
    bar = figure.colorbar(
        ScalarMappable(drawn.norm, drawn.colours),
        ax=axes,
        label=drawn.label,
        ticks=drawn.ticks,
        extend="neither" if drawn.ticks is not None else above,
        **({"shrink": 0.7, "aspect": 18} | place),
    )
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(which="minor", length=0)


def _texture(office: Office, drawn: _Drawn) -> NDArray[np.uint8]:
    """The field as a picture of the floor [rows, columns, 3], the first row in the north."""
    rows, cols = (round(length * _TEXELS_PER_M) for length in office.layout.room.size[1::-1])
    i, j = (np.arange(n) * size // n for n, size in zip((rows, cols), drawn.values.shape, strict=True))
    values = np.ma.masked_invalid(drawn.values[np.ix_(i, j)][::-1])
    return drawn.colours(drawn.norm(values), bytes=True)[..., :3]


def _render(config: Config, office: Office, floor: FloorMap, texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The overview of the office [height, width, 3] with a texture on the floor."""
    width, height = _PICTURE
    model = _with_floor(config, office, texture)
    data = mujoco.MjData(model)
    heading = float(floor.ris_heading_rad)
    data.qpos[office.rover_qpos : office.rover_qpos + 2] = floor.ris_xy_m
    data.qpos[office.rover_qpos + 3 : office.rover_qpos + 7] = math.cos(heading / 2), 0, 0, math.sin(heading / 2)
    data.mocap_pos[office.mocap_ids, :2] = floor.users_xy_m
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    option = mujoco.MjvOption()
    option.geomgroup[:] = np.isin(np.arange(mujoco.mjNGROUP), _SHOWN_GROUPS)
    with _renderer(model, width, height) as renderer:
        # A shadow on the floor would read as another value.
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.update_scene(data, "overview", option)
        return renderer.render()


def _with_floor(config: Config, office: Office, texture: NDArray[np.uint8]) -> mujoco.MjModel:
    """The office compiled again, with a texture on the floor and its users in their colours."""
    spec = compose(config, office.layout)
    rows, cols, channels = texture.shape
    image = spec.add_texture(
        name="map", type=mujoco.mjtTexture.mjTEXTURE_2D, width=cols, height=rows, nchannel=channels
    )
    image.data = texture.tobytes()
    slots = [""] * mujoco.mjtTextureRole.mjNTEXROLE
    slots[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "map"
    # Gloss would change the colours from those of the colour bar.
    spec.add_material(name="map", textures=slots, specular=0, shininess=0)
    spec.geom("floor").material = "map"
    model = spec.compile()
    for user in range(config.world.num_users):
        torso = model.geom(f"person{user}/torso").id
        model.geom_matid[torso] = -1
        model.geom_rgba[torso] = np.array([*rgb(user_colour(user)), 255]) / 255
    # The camera looks from the south, over this wall.
    south = model.geom("wall_south").id
    model.geom_matid[south] = -1
    model.geom_rgba[south] = 0.93, 0.92, 0.89, 0.25
    return model


def _renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    try:
        return mujoco.Renderer(model, height, width)
    # OpenGL loaders raise errors of many kinds, AttributeError among them.
    except Exception as error:
        raise ConfigError(
            "rendering: no OpenGL context can be made off screen: install the system packages libegl1 and "
            "libgl1-mesa-dri and set MUJOCO_GL=egl, or set MUJOCO_GL=osmesa with libosmesa6, or leave out the picture "
            "with --on-floor none"
        ) from error
