"""Every command: its options, as a dataclass whose docstring is the help, and the function that runs it.

The functions are imported when they run, so that help appears at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import typer

from stridetwin.cli.options import (
    LARGEST_PX,
    BackendOption,
    ImportableOptions,
    OnlyOption,
    Options,
    ParametersOption,
    SchedulerOption,
    ScoreOnlyOption,
    SourceOptions,
    TrajectoryFileOptions,
    WalkOptions,
    count,
    one_of,
    option,
    output_option,
    pixels,
    positive,
    probability,
    share,
    switch,
    whole,
)
from stridetwin.cli.studies import ExperimentOptions, PlaceOptions
from stridetwin.estimators import registry


@dataclass(frozen=True, kw_only=True)
class RunOptions(WalkOptions):
    """Walk, estimate and score in one go."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    seed: Annotated[int, option("Determines every byte.", "N", whole)] = 0
    backend: BackendOption = None
    only: OnlyOption = field(default_factory=list)
    parameters: ParametersOption = field(default_factory=list)
    no_film: Annotated[bool, switch("--no-film", "Leave the film out of the report.")] = False
    output: Annotated[Path | None, output_option("Folder for the files (default runs/SCENARIO).", "DIR")] = None


@dataclass(frozen=True, kw_only=True)
class GenerateOptions(WalkOptions):
    """Record a walk, or the data set of a campaign, without estimates."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO|CAMPAIGN", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    seed: Annotated[int | None, option("Determines every byte (default 0, or the campaign's).", "N", whole)] = None
    only: OnlyOption = field(default_factory=list)
    workers: Annotated[int | None, option("Campaign: walks at a time (default 1).", "N", count)] = None
    scheduler: Annotated[str | None, option("Campaign: walk on the workers of this Dask scheduler.", "ADDRESS")] = None
    subset: Annotated[int | None, option("Campaign: only the first K walks.", "K", count)] = None
    output: Annotated[
        Path,
        output_option("Recording to write (.mcap); for a campaign: output folder, existing walks are kept.", "PATH"),
    ]


@dataclass(frozen=True, kw_only=True)
class ListOptions(Options):
    """List scenarios, sensors, parts, kinds of output, estimators and experiments."""


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ImportableOptions):
    """Validate a recording; exit 1 if a problem would invalidate estimates."""


@dataclass(frozen=True, kw_only=True)
class ImportCommandOptions(ImportableOptions):
    """Convert another tool's recording into one of ours."""

    output: Annotated[Path, typer.Option("-o", "--output", metavar="RECORDING", help="Recording to write (.mcap).")]


@dataclass(frozen=True, kw_only=True)
class ExportOptions(SourceOptions):
    """Write a recording in another tool's format."""

    format: Annotated[
        Literal["euroc", "tum", "rosbag2", "opensim", "table"],
        typer.Option(help="Format; tum: path of a frame (FILE.txt) or RGB-D folder; table: any stream without images."),
    ]
    frame: Annotated[
        str | None,
        typer.Option(
            help="tum: frame of the path, such as pelvis; table: stream, such as truth/joints (default foot_l/imu)."
        ),
    ] = None
    camera: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="euroc, tum: camera (default the first with depth).")
    ] = None
    stereo_baseline: Annotated[
        float | None,
        typer.Option(parser=positive, metavar="M", help="euroc: render a right camera at this distance from depth."),
    ] = None
    storage: Annotated[Literal["mcap", "sqlite3"], typer.Option(help="rosbag2: storage.")] = "mcap"
    model: Annotated[Literal["rajagopal", "gait2392"], typer.Option(help="opensim: names and signs of this model.")] = (
        "rajagopal"
    )
    output: Annotated[Path, typer.Option("-o", "--output", metavar="PATH", help="File or folder to write.")]


@dataclass(frozen=True, kw_only=True)
class ViewOptions(SourceOptions):
    """Open a recording in Rerun, or play a walk in MuJoCo's viewer."""

    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING|SCENARIO",
            help="Recording, or anything that `import` reads; with --mujoco a scenario.",
            show_default=False,
        ),
    ]
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Rerun file to write (default beside the recording)."),
    ] = None
    mujoco: Annotated[bool, switch("--mujoco", "Play the walk of a scenario in MuJoCo's viewer.")] = False
    seed: Annotated[int | None, option("--mujoco: seed of the walk (default 0).", "N", whole)] = None


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(ImportableOptions, TrajectoryFileOptions):
    """Run one estimator on a recording or an IMU table."""

    estimator: Annotated[
        str,
        typer.Argument(
            metavar="ESTIMATOR",
            help="foot_ins: IMU of one foot; foot_to_foot: both feet, with cameras and sonars if recorded; "
            "contact_terrain: exoskeleton; dvio: RGB-D camera with IMU on head or chest; "
            "terrain_map: depth camera and poses; locomotion_mode: these and insoles.",
            **one_of(registry.names()),
        ),
    ]
    foot: Annotated[Literal["l", "r"] | None, option("foot_ins: foot of a recording (default l).")] = None
    lag: Annotated[float | None, option("foot_ins: smooth each pose with the next S seconds, up to 10.", "S")] = None
    calibration_from: Annotated[
        Path | None,
        option(
            "foot_ins: biases, scale and delay that an earlier estimate learnt of this sensor, "
            "the .calibration.json beside its path.",
            "FILE",
        ),
    ] = None
    imu: Annotated[
        str | None,
        option(
            "foot_ins, IMU table: auto reads noise, gyro bias and range from the samples (default); none assumes any "
            "consumer IMU; or the name of a part.",
            "NAME",
        ),
    ] = None
    method: Annotated[
        str | None,
        option("foot_to_foot, contact_terrain, dvio, locomotion_mode: algorithm (default proposed).", "NAME"),
    ] = None
    poses: Annotated[
        str | None,
        option(
            "terrain_map, locomotion_mode: trajectory of the depth camera's optical frame, or `truth` for the "
            "recording's true poses (default: those that dvio estimates).",
            "FILE",
        ),
    ] = None
    backend: BackendOption = None
    mesh: Annotated[
        bool, switch("--mesh", "terrain_map: write the ground as a .glb; with open3d also all surfaces, _mesh.ply.")
    ] = False
    dead_reckoning: Annotated[
        bool, switch("--dead-reckoning", "dvio: also write poses without tracking: on the IMU alone, or lost.")
    ] = False
    exoskeleton: Annotated[
        Path | None, option("contact_terrain: geometry, where the recording provides none.", "FILE")
    ] = None
    parameters: ParametersOption = field(default_factory=list)
    output: Annotated[
        Path,
        output_option(
            "TUM trajectory to write, or .csv with status and covariance (foot_to_foot: _l and _r are added); "
            "contact_terrain, locomotion_mode: table, .csv; terrain_map: .json, and a .ply beside it."
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class LiveOptions(Options):
    """Run one estimator on samples as hardware sends them, record them, or both."""

    estimator: Annotated[
        str | None,
        typer.Argument(
            metavar="ESTIMATOR|MODULE:CLASS",
            help="As in `estimate`, or a Python class with update(sample).",
            **one_of(registry.names(), other="MODULE:CLASS", is_other=lambda text: ":" in text),
        ),
    ] = None
    own_class: Annotated[
        str | None,
        typer.Option(
            "--estimator", metavar="NAME=MODULE:CLASS", help="Python class with update(sample), under a name."
        ),
    ] = None
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Address to listen at (default 127.0.0.1:7365).")] = (
        ""
    )
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Calibration (Kalibr's or another tool's) in place of what the senders provide."
        ),
    ] = None
    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Recording of all samples (.mcap).")] = None
    foot: Annotated[Literal["l", "r"] | None, typer.Option(help="foot_ins: which foot (default l).")] = None
    method: Annotated[str | None, typer.Option(metavar="NAME", help="As in `estimate`.")] = None
    backend: BackendOption = None
    exoskeleton: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="contact_terrain: geometry, where the sender provides none."),
    ] = None
    budget: Annotated[
        float | None,
        typer.Option(parser=positive, metavar="MS", help="Exit 1 if 1 % of a stream's samples take longer."),
    ] = None
    window: Annotated[
        float | None,
        typer.Option(
            parser=share,
            metavar="MS",
            help="How long samples wait for older ones of other streams (default 10; maps 60).",
        ),
    ] = None
    skip_images: Annotated[
        float | None,
        typer.Option(
            parser=positive,
            metavar="MS",
            help="Skip images that have waited longer, so that a slow estimator keeps up (default: none).",
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="As in `estimate`; without it each estimate is a row on stdout."
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class SendOptions(ImportableOptions):
    """Play a recording to `live` in real time, as hardware would."""

    to: Annotated[str, typer.Option(metavar="HOST:PORT", help="Address of `live` (default 127.0.0.1:7365).")] = ""
    speed: Annotated[
        float,
        typer.Option(parser=share, metavar="N", help="Times real time; 0: as fast as the receiver takes it."),
    ] = 1.0
    topic: Annotated[list[str], typer.Option(metavar="TOPIC", help="A stream to send (default all but the truth).")] = (
        field(default_factory=list)
    )
    patience: Annotated[
        float, typer.Option(parser=positive, metavar="S", help="How long to wait for the receiver, s.")
    ] = 10.0


SCORED_FRAME = "foot_l/imu"
"""Frame whose path an estimator of the user gives, where neither it nor an option says which."""


@dataclass(frozen=True, kw_only=True)
class ScoreOptions(TrajectoryFileOptions):
    """Score estimates against the truth of recordings, and against a baseline."""

    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING|CAMPAIGN", help="Recordings, or folders of campaigns.")
    ]
    lenient: Annotated[bool, switch("--lenient", "Read a damaged recording as far as possible.")] = False
    only: ScoreOnlyOption = field(default_factory=list)
    parameters: ParametersOption = field(default_factory=list)
    workers: Annotated[int | None, option("Recordings at a time (default 1).", "N", count)] = None
    scheduler: SchedulerOption = None
    resume: Annotated[
        Path | None,
        option("Keep what is scored in this folder, and reuse what an earlier run with equal options has kept.", "DIR"),
    ] = None
    estimate: Annotated[
        list[str], option("Score an existing trajectory: TUM, EuRoC, ORB-SLAM, OpenVINS, KITTI.", "NAME=FILE")
    ] = field(default_factory=list)
    estimator: Annotated[list[str], option("Score a Python class with update(sample).", "NAME=MODULE:CLASS")] = field(
        default_factory=list
    )
    program: Annotated[
        list[str],
        option(
            "Score a program that reads {recording} and writes the TUM file {output}, both words of the command.",
            "NAME=COMMAND",
        ),
    ] = field(default_factory=list)
    timeout: Annotated[float, option("Time limit of a program, s.", "S", positive)] = 600.0
    frame: Annotated[
        str | None,
        option(f"Frame that these three estimate, unless a class declares its own (default {SCORED_FRAME})."),
    ] = None
    align: Annotated[Literal["start", "yaw", "se3"], option("Alignment of paths with the truth.")] = "start"
    baseline: Annotated[Path | None, option("An earlier `score --json`; exit 1 if a score is worse.", "FILE")] = None
    least: Annotated[
        float | None,
        option("--baseline: ignore smaller changes, % of an error, points of a share (default 1).", "PCT", share),
    ] = None
    false_alarms: Annotated[
        float | None,
        option(
            "--baseline: percentage of comparisons in which a score may seem worse by chance (default 1).",
            "PCT",
            probability,
        ),
    ] = None
    tolerance: Annotated[
        float | None, option("--baseline: how much worse means of few walks may be, % (default 10).", "PCT", share)
    ] = None
    report: Annotated[
        Path | None, option("Page with figures of one recording: errors, bounds and NEES over time (.html).", "FILE")
    ] = None
    junit: Annotated[Path | None, option("Write the comparison as JUnit XML.", "FILE")] = None
    markdown: Annotated[Path | None, option("Write the comparison for a pull request.", "FILE")] = None
    history: Annotated[Path | None, option("Append a line with means and verdict (.jsonl).", "FILE")] = None
    label: Annotated[str | None, option("--history: name of this version.", "TEXT")] = None


@dataclass(frozen=True, kw_only=True)
class HistoryOptions(Options):
    """Draw how scores changed from version to version."""

    history: Annotated[Path, typer.Argument(metavar="FILE", help="File that `score --history` has written (.jsonl).")]
    title: Annotated[str, option("Title of the page.")] = "History"
    output: Annotated[Path, output_option("Page to write (.html).")]


@dataclass(frozen=True, kw_only=True)
class ConformOptions(Options):
    """Check that an estimator is causal, deterministic, bounded in memory, and robust to faulty samples."""

    estimator: Annotated[
        str,
        typer.Argument(
            metavar="ESTIMATOR", help="Name of an installed estimator, or MODULE:CLASS.", show_default=False
        ),
    ]
    method: Annotated[str | None, option("Method in place of the first.", "NAME")] = None
    foot: Annotated[
        str, typer.Option(metavar="l|r", help="Foot, for an estimator of one foot.", **one_of(("l", "r")))
    ] = "l"
    mount: Annotated[str, option("Mount of the camera in place of the first.", "NAME")] = ""
    recording: Annotated[
        Path | None, option("Check on this recording instead of a simulated walk, for sensors of your own.", "FILE")
    ] = None
    only: Annotated[list[str], option("Run only this check; may be repeated.", "CHECK")] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class SceneOptions(Options):
    """Write the scene of a walk as MJCF, which MuJoCo opens without StrideTwin."""

    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Name in the catalogue (see `list`), or a .yaml file.")
    ]
    texture_px: Annotated[int, option("Edge of the textures, pixels: fewer make a smaller folder.", "PX", pixels)] = (
        LARGEST_PX
    )
    output: Annotated[Path, output_option("Folder to write; scenes of one wearer may share it.", "DIR")]


@dataclass(frozen=True, kw_only=True)
class MotionOptions(Options):
    """Fit a wearer to a recording of a person, and show how well: markers, steps, terrain, and an image."""

    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Markers (.trc, .c3d) or joint angles (.mot, .sto, .bvh, .npz), possibly .gz."
        ),
    ]
    height_m: Annotated[float, option("Height of the person, m.", "M")] = 1.75
    mass_kg: Annotated[float, option("Mass of the person, kg.", "KG")] = 75.0
    markers: Annotated[str, option("Set of markers; without it, the one that knows most names.", "SET")] = ""
    duration_s: Annotated[float, option("Loop the recording to this length, s; 0 for its own length.", "S")] = 0.0
    output: Annotated[Path | None, output_option("Image to write, .png; none without it.", "FILE")] = None


SCHEMAS = {
    "scenario": "stridetwin.scenarios.scenario_model:ScenarioFile",
    "campaign": "stridetwin.scenarios.campaign.campaign_file:CampaignFile",
    "placement": "stridetwin.studies.placement.problem_file:PlacementFile",
    "study": "stridetwin.studies.study_file.study:StudyFile",
    "part": "stridetwin.sim.parts.part_file:PartFile",
    "own_exo": "stridetwin.sim.wearer.own_exo_rig:OwnExoFile",
    "exo_geometry": "stridetwin.estimators.contact_terrain.geometry:ExoskeletonFile",
}
"""Kinds of files that users write, and the type of each; imported when it is asked for."""


@dataclass(frozen=True, kw_only=True)
class SchemaOptions(Options):
    """Print the JSON Schema of a kind of file, for editors."""

    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"{', '.join(SCHEMAS)}.", **one_of(tuple(SCHEMAS)))]


@dataclass(frozen=True)
class Command:
    """A command: its class of options, and the function that runs it, as `MODULE:FUNCTION` of this package."""

    options: type[Options]
    function: str


COMMANDS = {
    "run": Command(RunOptions, "walk:run_command"),
    "list": Command(ListOptions, "listing:list_command"),
    "generate": Command(GenerateOptions, "walk:generate_command"),
    "check": Command(CheckOptions, "recording:check_command"),
    "import": Command(ImportCommandOptions, "recording:import_command"),
    "export": Command(ExportOptions, "recording:export_command"),
    "estimate": Command(EstimateOptions, "estimate:estimate_command"),
    "live": Command(LiveOptions, "bridge:live_command"),
    "send": Command(SendOptions, "bridge:send_command"),
    "score": Command(ScoreOptions, "score:score_command"),
    "conform": Command(ConformOptions, "conform:conform_command"),
    "history": Command(HistoryOptions, "history:history_command"),
    "experiment": Command(ExperimentOptions, "studies:experiment_command"),
    "place": Command(PlaceOptions, "studies:place_command"),
    "motion": Command(MotionOptions, "motion:motion_command"),
    "scene": Command(SceneOptions, "scene:scene_command"),
    "schema": Command(SchemaOptions, "listing:schema_command"),
    "view": Command(ViewOptions, "recording:view_command"),
}
