"""The commands. Heavy dependencies are imported where they are needed, so that help appears at once."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from stridetwin.cli.bridge import LiveOptions, SendOptions, live_command, send_command
from stridetwin.cli.conform import ConformOptions, conform_command
from stridetwin.cli.estimate import EstimateOptions, estimate_command
from stridetwin.cli.listing import ListOptions, list_command
from stridetwin.cli.options import Options, Outcome
from stridetwin.cli.recording import (
    CheckOptions,
    ExportOptions,
    ImportCommandOptions,
    ViewOptions,
    check_command,
    export_command,
    import_command,
    view_command,
)
from stridetwin.cli.scene import SceneOptions, scene_command
from stridetwin.cli.schema import SchemaOptions, schema_command
from stridetwin.cli.score import HistoryOptions, ScoreOptions, history_command, score_command
from stridetwin.cli.studies import ExperimentOptions, PlaceOptions, experiment_command, place_command
from stridetwin.cli.walk import GenerateOptions, RunOptions, generate_command, run_command

__all__ = ["COMMANDS", "Command", "Options", "Outcome"]


@dataclass(frozen=True)
class Command:
    """A command: its class of options, whose docstring is the help, and the function that runs it."""

    options: type[Options]
    run: Callable[[Any, Callable[[str, float], None]], Outcome]


COMMANDS = {
    "run": Command(RunOptions, run_command),
    "list": Command(ListOptions, list_command),
    "generate": Command(GenerateOptions, generate_command),
    "check": Command(CheckOptions, check_command),
    "import": Command(ImportCommandOptions, import_command),
    "export": Command(ExportOptions, export_command),
    "estimate": Command(EstimateOptions, estimate_command),
    "live": Command(LiveOptions, live_command),
    "send": Command(SendOptions, send_command),
    "score": Command(ScoreOptions, score_command),
    "conform": Command(ConformOptions, conform_command),
    "history": Command(HistoryOptions, history_command),
    "experiment": Command(ExperimentOptions, experiment_command),
    "place": Command(PlaceOptions, place_command),
    "scene": Command(SceneOptions, scene_command),
    "schema": Command(SchemaOptions, schema_command),
    "view": Command(ViewOptions, view_command),
}
