"""What each command does. Heavy parts are imported where they are needed, so that help comes at once."""

from stridetwin.scenarios.commands.bridge import live_command, send_command
from stridetwin.scenarios.commands.campaign import generate_command
from stridetwin.scenarios.commands.estimate import estimate_command
from stridetwin.scenarios.commands.experiment import experiment_command
from stridetwin.scenarios.commands.listing import list_command
from stridetwin.scenarios.commands.outcome import Outcome
from stridetwin.scenarios.commands.place import place_command
from stridetwin.scenarios.commands.recording import check_command, export_command, import_command, view_command
from stridetwin.scenarios.commands.schema import schema_command
from stridetwin.scenarios.commands.score import history_command, score_command
from stridetwin.scenarios.commands.walk import run_command

__all__ = [
    "Outcome",
    "check_command",
    "estimate_command",
    "experiment_command",
    "export_command",
    "generate_command",
    "history_command",
    "import_command",
    "list_command",
    "live_command",
    "place_command",
    "run_command",
    "schema_command",
    "score_command",
    "send_command",
    "view_command",
]
