"""The command line `stridetwin`: arguments in; one line a result, or one JSON object, out."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from stridetwin.scenarios.commands import (
    ESTIMATORS,
    Outcome,
    check_command,
    estimate_command,
    experiment_command,
    export_command,
    generate_command,
    history_command,
    import_command,
    list_command,
    live_command,
    place_command,
    run_command,
    score_command,
    send_command,
    view_command,
)
from stridetwin.scenarios.commands.outputs import check_outputs
from stridetwin.scenarios.console import Console
from stridetwin.scenarios.experiments.studies import STUDIES
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.files import asked_name

METHODS = (
    "stridetwin",
    "published",
    "zupt_relative_position",
    "zupt_relative_distance",
    "zupt",
    "dvio",
    "vins_rgbd",
    "vins_mono",
)
FORMATS = ("euroc", "tum", "rosbag2", "opensim", "table")
KINDS = ("mcap", "rosbag1", "rosbag2", "euroc", "tum", "7scenes", "table")
_MOST = 1_000_000
_PIPE_CLOSED = 128 + 13  # as a shell reports SIGPIPE


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error here."""

    def error(self, message: str) -> NoReturn:
        print(f"stridetwin: error: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)


def parser() -> argparse.ArgumentParser:
    """The arguments of every command."""
    top = _Parser(
        prog="stridetwin",
        description="A person in an exoskeleton walks; every sensor is recorded, every estimator scored.",
        epilog="Exit codes: 0 done, 1 worse than the baseline or not fit for use, 2 something to put right.",
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    def command(name: str, words: str, act: object) -> argparse.ArgumentParser:
        p = commands.add_parser(name, help=words, description=words[:1].upper() + words[1:] + ".")
        p.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else there")
        p.set_defaults(act=act)
        return p

    def walk(p: argparse.ArgumentParser, name: str, seed: int | None, default: str) -> None:
        p.add_argument("scenario", metavar=name, help="name in the catalogue (see `list`), or a .yaml file")
        p.add_argument("--physics", help="how the body moves: kinematic, dynamic (default: as the scenario says)")
        p.add_argument("--seed", type=_seed, default=seed, help=f"fixes every byte (default {default})")
        p.add_argument("--no-cameras", action="store_true", help="leave every camera of the rig off: much faster")

    p = command("run", "walk, estimate and score in one go", run_command)
    walk(p, "SCENARIO", 0, "0")
    p.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for the files (default runs/SCENARIO)")
    p.add_argument("--no-film", action="store_true", help="leave the film out of the report")

    command("list", "list scenarios, sensors, parts, estimators and experiments", list_command)

    p = command(
        "generate", "make a recording of a walk, or the data set of a campaign, without estimates", generate_command
    )
    walk(p, "SCENARIO|CAMPAIGN", None, "0, or the campaign's own")
    p.add_argument("--workers", type=_whole, metavar="N", help="campaign: walks at a time (default 1)")
    p.add_argument("--scheduler", metavar="ADDRESS", help="campaign: walk on the workers of this Dask scheduler")
    p.add_argument("--subset", type=_whole, metavar="K", help="campaign: only the first K walks")
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="PATH",
        required=True,
        help="recording to write, .mcap; of a campaign: folder, of which what is there already is not made again",
    )

    p = command(
        "check", "say whether a recording is fit for use; exit 1 where something would spoil an estimate", check_command
    )
    _importable(p)

    p = command("import", "read another tool's recording into one of ours", import_command)
    _importable(p)
    p.add_argument("-o", "--output", type=Path, metavar="RECORDING", required=True, help="recording to write, .mcap")

    p = command("export", "write a recording in another tool's format", export_command)
    _source(p, "RECORDING", "recording, or anything that import reads")
    p.add_argument(
        "--format", required=True, choices=FORMATS, help="tum: path of a frame (FILE.txt) or RGB-D folder; table: IMU"
    )
    p.add_argument("--frame", help="tum, table: whose path or IMU, such as pelvis (default foot_l/imu)")
    p.add_argument("--camera", metavar="TOPIC", help="euroc, tum: which camera (default the first with depth)")
    p.add_argument(
        "--stereo-baseline", type=_positive, metavar="M", help="euroc: make a right camera at this distance from depth"
    )
    p.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap", help="rosbag2: storage (default mcap)")
    p.add_argument(
        "--model", choices=("rajagopal", "gait2392"), default="rajagopal", help="opensim: whose names and signs "
        "(default rajagopal)"
    )  # fmt: skip
    p.add_argument("-o", "--output", type=Path, metavar="PATH", required=True, help="file or folder to make")

    p = command("estimate", "run one estimator on a recording or an IMU table", estimate_command)
    p.add_argument(
        "estimator",
        choices=tuple(ESTIMATORS),
        metavar="ESTIMATOR",
        help="foot_ins: IMU of one foot; foot_to_foot: both feet, with cameras and sonars where there are any; "
        "contact_terrain: exoskeleton; dvio: RGB-D camera with IMU on head or chest; "
        "terrain_map: depth camera and poses; locomotion_mode: these and insoles",
    )
    _importable(p)
    p.add_argument("--foot", choices=("l", "r"), help="foot_ins: which foot of a recording (default l)")
    p.add_argument(
        "--lag",
        type=float,
        metavar="S",
        help="foot_ins: smooth each pose with what follows it within S seconds, up to 10",
    )
    p.add_argument(
        "--method",
        choices=METHODS,
        default="stridetwin",
        help="foot_to_foot, contact_terrain, dvio, locomotion_mode: which algorithm (default stridetwin)",
    )
    p.add_argument(
        "--poses",
        type=Path,
        metavar="FILE",
        help="terrain_map, locomotion_mode: TUM trajectory of the depth camera's optical frame (default: poses of the "
        "recording)",
    )
    p.add_argument("--mesh", action="store_true", help="terrain_map: write the ground as a .glb as well")
    p.add_argument(
        "--exoskeleton", type=Path, metavar="FILE", help="contact_terrain: geometry, where the recording tells none"
    )
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        required=True,
        help="TUM trajectory to write (foot_to_foot: _l and _r are added); contact_terrain, locomotion_mode: "
        "table, .csv; "
        "terrain_map: .json, and a .ply beside it",
    )

    p = command("live", "run one estimator on samples as hardware sends them, record them, or both", live_command)
    p.add_argument("estimator", nargs="?", choices=tuple(ESTIMATORS), metavar="ESTIMATOR", help="as of estimate")
    p.add_argument("--listen", default="", metavar="HOST:PORT", help="where to listen (default 127.0.0.1:7365)")
    p.add_argument("--rig", type=Path, metavar="FILE", help="calibration (Kalibr YAML) before what the senders tell")
    p.add_argument("--record", type=Path, metavar="FILE", help="recording of all that comes, .mcap")
    p.add_argument("--foot", choices=("l", "r"), help="foot_ins: which foot (default l)")
    p.add_argument("--method", choices=METHODS, default="stridetwin", help="as of estimate (default stridetwin)")
    p.add_argument(
        "--exoskeleton", type=Path, metavar="FILE", help="contact_terrain: geometry, where the sender tells none"
    )
    p.add_argument("--budget", type=_positive, metavar="MS", help="exit 1 where 1 %% of a stream's samples take longer")
    p.add_argument(
        "--window",
        type=_share,
        metavar="MS",
        help="how long samples wait for older ones of other streams (10; maps 60)",
    )
    p.add_argument(
        "--skip-pictures",
        type=_positive,
        metavar="MS",
        help="leave out pictures that have waited longer, so that a slow estimator keeps up (default: none)",
    )
    p.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="as of estimate; without it each estimate is a row on stdout"
    )

    p = command("send", "play a recording to `live` in real time, as hardware would", send_command)
    _importable(p)
    p.add_argument("--to", default="", metavar="HOST:PORT", help="who listens (default 127.0.0.1:7365)")
    p.add_argument(
        "--speed", type=_share, default=1.0, metavar="N", help="times real time (default 1); 0: as fast as it is taken"
    )
    p.add_argument("--topic", action="append", metavar="TOPIC", help="a stream to send (default all but the truth)")
    p.add_argument(
        "--patience", type=_positive, default=10.0, metavar="S", help="how long to look for the listener (default 10)"
    )

    p = command("score", "score estimates against the truth of recordings, and against a baseline", score_command)
    p.add_argument(
        "recordings", nargs="+", type=Path, metavar="RECORDING|CAMPAIGN", help="recordings, or folders of campaigns"
    )
    p.add_argument("--lenient", action="store_true", help="read a damaged recording as far as it goes")
    p.add_argument("--workers", type=_whole, default=1, metavar="N", help="recordings at a time (default 1)")
    p.add_argument(
        "--estimate", action="append", default=[], metavar="NAME=FILE", help="score a TUM file made elsewhere"
    )
    p.add_argument(
        "--estimator",
        action="append",
        default=[],
        metavar="NAME=MODULE:CLASS",
        help="score a Python class with update(sample)",
    )
    p.add_argument(
        "--program",
        action="append",
        default=[],
        metavar="NAME=COMMAND",
        help="score a program that reads {recording} and writes the TUM file {output}, both words of the command",
    )
    p.add_argument("--timeout", type=_positive, default=600.0, metavar="S", help="of a program, s (default 600)")
    p.add_argument("--frame", default="foot_l/imu", help="frame of these three (default foot_l/imu)")
    p.add_argument(
        "--align", default="start", choices=("start", "yaw", "se3"), help="how paths are laid over the truth"
    )
    p.add_argument("--baseline", type=Path, metavar="FILE", help="an earlier `score --json`; exit 1 where one is worse")
    p.add_argument(
        "--least",
        type=_share,
        default=1.0,
        metavar="PCT",
        help="a smaller change is none: %% of an error, points of a share (default 1)",
    )
    p.add_argument(
        "--false-alarms",
        type=_probability,
        default=1.0,
        metavar="PCT",
        help="in so many of a hundred comparisons may a score seem worse by chance (default 1)",
    )
    p.add_argument(
        "--tolerance", type=_share, default=10.0, metavar="PCT", help="how much worse means of few walks may be "
        "(default 10 %%)"
    )  # fmt: skip
    p.add_argument("--junit", type=Path, metavar="FILE", help="write the comparison as JUnit XML")
    p.add_argument("--markdown", type=Path, metavar="FILE", help="write the comparison for a pull request")
    p.add_argument("--history", type=Path, metavar="FILE", help="add a line with means and verdict, .jsonl")
    p.add_argument("--label", metavar="TEXT", help="--history: which version this is")

    p = command("history", "draw how scores went from version to version", history_command)
    p.add_argument("history", type=Path, metavar="FILE", help="what `score --history` has written, .jsonl")
    p.add_argument("--title", default="History", help="of the page")
    p.add_argument("-o", "--output", type=Path, metavar="FILE", required=True, help="page to write, .html")

    p = command("experiment", "run a paper's experiment and print its table beside ours", experiment_command)
    p.add_argument("experiment", choices=tuple(STUDIES), metavar="NAME", help=", ".join(STUDIES))
    p.add_argument("--workers", type=_whole, default=1, metavar="N", help="cases at a time (default 1)")
    p.add_argument("--seed", type=_seed, metavar="FIRST", help="seed of the first case (default 1000)")
    p.add_argument("--subset", type=_whole, metavar="K", help="so many cases (default all)")
    p.add_argument(
        "--physics",
        choices=("kinematic", "dynamic"),
        default="dynamic",
        help="how the body moves, where one walks (default dynamic)",
    )
    p.add_argument("--resume", action="store_true", help="go on where an earlier run of it stopped")
    p.add_argument("--keep", action="store_true", help="leave the recordings of the walks in the folder")
    p.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for the cases (default runs/NAME)")

    p = command("place", "sweep or optimise where sensors sit, or which parts they are", place_command)
    p.add_argument(
        "problem",
        metavar="SENSOR|PROBLEM",
        help="a placement of the catalogue (see `list`), such as foot_camera, or a .yaml file",
    )
    p.add_argument("--scenario", metavar="SCENARIO", help="walk this one instead")
    p.add_argument("--walks", type=_whole, metavar="K", help="walks of each scenario (default as the file says)")
    p.add_argument("--seed", type=_seed, metavar="FIRST", help="seed of the first walk (default as the file says)")
    p.add_argument("--budget", type=_whole, metavar="N", help="optimise: places to try (default as the file says)")
    p.add_argument("--workers", type=_whole, default=1, metavar="N", help="walks at a time (default 1)")
    p.add_argument("--resume", action="store_true", help="go on where an earlier run of it stopped")
    p.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder for the files (default runs/NAME)")

    p = command("view", "look at a recording in Rerun", view_command)
    _source(p, "RECORDING", "recording, .mcap")
    p.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="Rerun file to write (default beside the recording)"
    )
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit code."""
    arguments = parser().parse_args(argv)
    console = Console()
    try:
        check_outputs(arguments)
        outcome: Outcome = arguments.act(arguments, console)
    except StrideTwinError as error:
        return _failed(console, str(error))
    except OSError as error:
        return _failed(
            console, f"{asked_name(str(error.filename))}: {error.strerror}" if error.filename else str(error)
        )
    except KeyboardInterrupt:
        return _failed(console, "stopped") + 128
    console.close()
    if arguments.json:
        result = json.dumps(outcome.data, indent=2, sort_keys=True, allow_nan=False)
    else:
        result = "\n".join(outcome.lines)
    try:
        print(result, flush=True)
    except BrokenPipeError:  # who reads, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter fails at its own flush
        return _PIPE_CLOSED
    return outcome.code


def _failed(console: Console, message: str) -> int:
    console.close()
    print(f"stridetwin: error: {' '.join(message.split())}", file=sys.stderr)
    return 2


def _source(p: argparse.ArgumentParser, name: str, words: str) -> None:
    p.add_argument("source", type=Path, metavar=name, help=words)
    p.add_argument("--lenient", action="store_true", help="read a damaged or suspicious source as far as it goes")


def _importable(p: argparse.ArgumentParser) -> None:
    _source(p, "PATH", "recording, MCAP file, ROS 1 or 2 bag, EuRoC, TUM or 7-Scenes folder, IMU table")
    p.add_argument(
        "--as", dest="kind", metavar="KIND", help=f"what it is, where its content deceives: {', '.join(KINDS)}"
    )
    p.add_argument("--map", action="append", default=[], metavar="FROM=TO", help="topic for a stream of the source")
    p.add_argument("--rig", type=Path, metavar="FILE", help="calibration (Kalibr YAML) in place of the source's")
    p.add_argument(
        "--depth-scale", type=_positive, metavar="N", help="units a metre in a folder's depth (TUM 5000, 7-Scenes 1000)"
    )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; valid: a number above 0")
    return value


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; valid: a whole number from 0 on")
    return int(text)


def _whole(text: str) -> int:
    if not text.isdecimal() or len(text) > len(str(_MOST)) or not 1 <= int(text) <= _MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; valid: a whole number from 1 to {_MOST}")
    return int(text)


def _probability(text: str) -> float:
    if not 0.01 <= (value := _share(text)) <= 50:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; valid: 0.01-50")
    return value


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} is not valid; valid: 0-1000")
    return value
