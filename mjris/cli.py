"""The console command: train, evaluate, render, map, export."""

import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union

import tyro

from mjris.assets import assets_dir
from mjris.config import Config, ConfigError, load, preset

if TYPE_CHECKING:
    import pandas as pd

    from mjris.eval.policies import Act

_SHIPPED_OUT = Path("runs/shipped")
T = TypeVar("T")
Flags = Annotated[T, tyro.conf.arg(name="")]


@dataclass(kw_only=True)
class Train:
    """Train the agents of all cells and keep the run in a folder."""

    out: Path
    """Run folder; it must be new or empty."""
    preset: str = "office"
    """Where defaults come from: office (recommended), paper (the paper's literal agent) or demo (minutes)."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the agents of a stack learn."""
    config: Flags[Config] = field(default_factory=Config)

    def run(self) -> None:
        """Train."""
        from mjris.learn.progress import progress_bar
        from mjris.learn.run import train
        from mjris.learn.workers import describe

        print(describe(self.config, self.device))
        with progress_bar(self.config) as report:
            train(self.config, self.out, report=report, device=self.device)
        print(f"run folder: {self.out}")


@dataclass(kw_only=True)
class Evaluate:
    """Play the trained agent and its rivals on the same held-out scenes: parked, random phases, no RIS, OMA, planner.

    Beside the table come figures of the learning curve, of where the agent heads from every place, and of its phases.
    """

    run_dirs: Annotated[tuple[Path, ...], tyro.conf.arg(name="run")] = ()
    """Run folder of `mjris train`, whose agent is played and whose config is where defaults come from; and more of the
    same config with other seeds, for the learning curve. Without any, the trained policy that comes with mjris."""
    out: Path | None = None
    """Where the table goes (.csv), with the figures beside it; evaluation.csv in the (first) run folder by default, and
    in runs/shipped without one."""
    scenes: int = 50
    """Held-out scenes, played together."""
    scene_seed: int = 1_000_003
    """The scenes follow from this seed."""
    cell: int = 0
    """Whose agent is played."""
    planner: bool = True
    """Also the planner with the best phases and powers known, the upper bound, and every policy's share of both; this
    takes about as long as all other policies together."""
    config: Flags[Config] = field(default_factory=Config)

    def run(self) -> None:
        """Evaluate, print the table, write it and draw."""
        from rich.console import Console

        from mjris.eval.evaluate import compare
        from mjris.eval.tables import print_comparison
        from mjris.show.curves import training_gain

        run_dirs = self.run_dirs or (_shipped(),)
        _check_alike(run_dirs)
        if self._have_curves():
            training_gain(run_dirs)  # what cannot be drawn shows here, before anything is played
        console = Console()
        if not console.is_terminal:
            # A file has no width; the 80 columns that rich takes it for would fold the cells.
            console.width = 120
        act = _learned(run_dirs[0], self.cell, self.config)
        with console.status("") as status:
            table = compare(
                self.config,
                act,
                self.scenes,
                self.scene_seed,
                lambda name: status.update(f"{name}: {self.scenes} scenes"),
                with_planner=self.planner,
            )
        print_comparison(console, table)
        path = self.out or (self.run_dirs[0] if self.run_dirs else _SHIPPED_OUT) / "evaluation.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        table.to_csv(path, index=False, float_format="%.6g")
        console.print(f"table: {path}", highlight=False, soft_wrap=True)
        with console.status("figures") as status:
            figures = self._draw(act, table, path.parent, lambda name: status.update(f"{name}: {self.scenes} scenes"))
        for figure in figures:
            console.print(f"figure: {figure}", highlight=False, soft_wrap=True)

    def _have_curves(self) -> bool:
        return bool(self.run_dirs) and all((run / "metrics.csv").exists() for run in self.run_dirs)

    def _draw(self, act: "Act", table: "pd.DataFrame", folder: Path, report: Callable[[str], None]) -> list[Path]:
        """Write the figures; returns their paths. `report` hears of every checkpoint that is played."""
        from mjris.eval.checkpoints import judge
        from mjris.learn.policy import load_policy, without_noise
        from mjris.show.curves import plot_learning, plot_phases, track_phases
        from mjris.show.field import motion_field, plot_motion_field

        field, phases = paths = [folder / "motion_field.png", folder / "phases.png"]
        plot_motion_field(self.config, motion_field(self.config, act, self.scene_seed), field)
        plot_phases(track_phases(self.config, act, self.scene_seed), phases)
        if self._have_curves():

            def checkpoint(run: Path, round_: int) -> "Act":
                return without_noise(load_policy(run, self.cell, round_=round_))

            judged = judge(self.config, self.run_dirs, checkpoint, self.scenes, self.scene_seed, report)
            paths.insert(0, folder / "learning_curve.png")
            plot_learning(self.run_dirs, judged, table, paths[0])
        return paths


@dataclass(kw_only=True)
class Render:
    """Film one episode of the trained agent, and draw its way over the floor."""

    run_dir: Annotated[Path | None, tyro.conf.arg(name="run")] = None
    """Run folder of `mjris train`; its config is where defaults come from. Without one, the trained policy that comes
    with mjris."""
    out: Path | None = None
    """Folder for video.mp4, frame.png and trajectory.png; the run folder by default, and runs/shipped without one."""
    slots: int = 30
    """Slots to film."""
    scene_seed: int = 1_000_003
    """The scene follows from this seed."""
    cell: int = 0
    """Whose agent is played."""
    config: Flags[Config] = field(default_factory=Config)

    def run(self) -> None:
        """Play, film and draw."""
        _load_opengl()
        from mjris.show.film import film

        act = _learned(self.run_dir or _shipped(), self.cell, self.config)
        if self.slots < 1:
            raise ConfigError(f"slots: {self.slots} is not allowed: it must be at least 1")
        film(self.config, act, self.out or self.run_dir or _SHIPPED_OUT, self.slots, self.scene_seed)


@dataclass(kw_only=True)
class Export:
    """Write the actor of a run as a small policy folder, which `--run` takes like a run."""

    run_dir: Annotated[Path, tyro.conf.arg(name="run")]
    """Run folder of `mjris train`."""
    out: Path
    """Folder for config.json and actor.safetensors."""
    cell: int = 0
    """Whose agent it is."""

    def run(self) -> None:
        """Load and write."""
        from mjris.learn.policy import export_policy

        for path in export_policy(self.run_dir, self.out, self.cell):
            print(path)


@dataclass(kw_only=True)
class Map:
    """Draw sight, SNR and rate over the floor without and with RIS, and what every place is worth to the RIS."""

    out: Path
    """Folder for map.npz, a figure of each field, office.png and leakage.csv."""
    run_dir: Annotated[Path | None, tyro.conf.arg(name="run")] = None
    """Run folder of `mjris train`, if its config is where defaults come from."""
    preset: str = "office"
    """Where defaults come from without a run: office, demo, wifi, mmwave, paper or classic."""
    scene_seed: int = 1_000_003
    """Where people stand follows from this seed."""
    resolution_m: float = 0.1
    """Longest side of the floor's cells [m]."""
    place_resolution_m: float = 0.25
    """Longest side of the cells that the RIS is tried in [m]."""
    rover: tuple[float, float] | None = None
    """Where the RIS stands, x and y [m]; the layout's start by default."""
    heading_deg: float | None = None
    """Where the panel faces, counter-clockwise from +x; by default as --world.pan says."""
    on_floor: str = "snr_ris"
    """The field on the floor of the rendered office, named like its figure; none for no such picture."""
    leakage: bool = False
    """Also what the floors of the building let through to each other, as a table."""
    bands: int = 2
    """Bands that the floors take in turn; there are --federation.num-cells floors."""
    slab_m: float = 0.3
    """Thickness of the slab between two floors [m]."""
    config: Flags[Config] = field(default_factory=Config)

    def run(self) -> None:
        """Compute, draw and write; all files or none."""
        if self.on_floor != "none":
            _load_opengl()
        from mjris.eval.building import leakage_table, storey_height_m
        from mjris.eval.floormap import floor_map
        from mjris.eval.tables import print_leakage
        from mjris.show.maps import write_maps
        from mjris.simulation.simulator import Simulator

        if self.scene_seed < 0:
            raise ConfigError(f"scene_seed: {self.scene_seed} is not allowed: it must be at least 0")
        simulator = Simulator(self.config)
        simulator.seed(self.scene_seed)
        simulator.reset()
        office = simulator.world.office(0)
        floor = floor_map(
            simulator,
            resolution_m=self.resolution_m,
            place_resolution_m=self.place_resolution_m,
            rover_xy_m=self.rover,
            panel_heading_rad=None if self.heading_deg is None else math.radians(self.heading_deg),
        )
        table = None
        if self.leakage:
            table = leakage_table(floor, self.config, storey_height_m(office, self.slab_m), self.bands)
        paths = write_maps(self.config, office, floor, table, self.on_floor, self.out)
        if table is not None:
            print_leakage(table)
        for path in paths:
            print(path)


def main(argv: list[str] | None = None) -> None:
    """Run the command line; bad input ends in one sentence on standard error and status 2."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        _parse(argv).run()
    except ConfigError as error:
        sys.exit(_fail(str(error)))


def _parse(argv: list[str]) -> Train | Evaluate | Render | Map | Export:
    """The command with all of its flags; defaults come from the preset or the run folder that is named."""
    run_dir, name = _value(argv, "--run"), _value(argv, "--preset")
    if "--run" in argv and (run_dir is None or run_dir.startswith("-")):
        raise ConfigError("run: no folder is given")
    config = preset(name or "office")
    if run_dir is not None:
        if not Path(run_dir).is_dir():
            raise ConfigError(f"run: {run_dir} is not allowed: there is no such folder")
        config = load(Path(run_dir) / "config.json")
    elif argv[:1] in (["evaluate"], ["render"]):
        config = load(_shipped() / "config.json")
    missing = tyro.MISSING
    commands = Union[  # noqa: UP007 - built at run time
        Annotated[Train, tyro.conf.subcommand("train", default=Train(out=missing, config=config))],
        Annotated[Evaluate, tyro.conf.subcommand("evaluate", default=Evaluate(config=config))],
        Annotated[Render, tyro.conf.subcommand("render", default=Render(config=config))],
        Annotated[Map, tyro.conf.subcommand("map", default=Map(out=missing, config=config))],
        Annotated[Export, tyro.conf.subcommand("export", default=Export(run_dir=missing, out=missing))],
    ]
    try:
        return tyro.cli(commands, prog="mjris", description=__doc__, args=argv)  # type: ignore[arg-type]
    except BrokenPipeError:
        # Whoever reads the help has seen enough, as with `| head`. What is still unwritten goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _value(argv: list[str], flag: str) -> str | None:
    """The value of a flag that decides the defaults of the others, and so must be known before they are parsed."""
    for here, after in zip(argv, [*argv[1:], None], strict=True):
        if here == flag:
            return after
        if here.startswith(f"{flag}="):
            return here.removeprefix(f"{flag}=")
    return None


def _shipped() -> Path:
    """Folder of the trained policy that comes with mjris."""
    return assets_dir() / "policies" / "office"


def _check_alike(run_dirs: Sequence[Path]) -> None:
    """Raise `ConfigError` unless the configs of the runs differ in nothing but their seeds."""
    configs = [load(run / "config.json") for run in run_dirs]
    first, *others = [_fields(config) for config in configs]
    for run, other in zip(run_dirs[1:], others, strict=True):
        for name, value in other.items():
            if value != first[name]:
                raise ConfigError(
                    f"run: {run} is not allowed beside {run_dirs[0]}: its {name} is {value!r} and not {first[name]!r}, "
                    "and only seeds may differ"
                )
    seeds = [config.seed for config in configs]
    if len(set(seeds)) < len(seeds):
        raise ConfigError(f"run: seeds {seeds} are not allowed: every run must have a seed of its own")


def _fields(config: Config) -> dict[str, Any]:
    """Every field but the seed, by names like world.layout."""
    sections = config.to_dict()
    del sections["seed"]
    return {f"{section}.{name}": value for section, fields in sections.items() for name, value in fields.items()}


def _load_opengl() -> None:
    """Make MuJoCo load what it renders with. Raises `ConfigError` if it cannot."""
    # Rendering needs no screen; MuJoCo reads this when it is first imported.
    os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco  # noqa: F401
    except (ImportError, AttributeError, OSError) as error:
        raise ConfigError(
            f"MUJOCO_GL: {os.environ['MUJOCO_GL']!r} cannot be loaded ({error}): "
            "install the system packages libegl1 and libgl1-mesa-dri, or set it to osmesa or glfw"
        ) from None


def _learned(run_dir: Path, cell: int, config: Config) -> "Act":
    """The trained agent of a cell, acting without noise. Raises `ConfigError` if the task's sizes are others."""
    from mjris.learn.policy import load_policy, without_noise
    from mjris.simulation.task import Task

    agent = load_policy(run_dir, cell)
    task = Task(config)
    for what, size, space in (
        ("observation", task.observation_size, agent.observation_space),
        ("action", task.action_size, agent.action_space),
    ):
        if space.shape != (size,):
            raise ConfigError(
                f"config: the {what} has {size} entries and the agent in {run_dir} was trained with {space.shape}: "
                "leave out the flags that change it"
            )
    return without_noise(agent)


def _fail(sentence: str) -> int:
    print(f"mjris: {sentence}", file=sys.stderr)
    return 2
