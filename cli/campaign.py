"""`generate`: records the walk of a scenario, or the data set of a campaign."""

from __future__ import annotations

import re
from pathlib import Path

from stridetwin.cli.outcome import Outcome, Progress
from stridetwin.cli.walk import GenerateOptions, record_command
from stridetwin.streams.errors import ConfigError, StrideTwinError

_SCHEDULER = re.compile(r"([a-z]+://)?[^\s/]+:\d{1,5}")


def generate_command(arguments: GenerateOptions, progress: Progress) -> Outcome:
    """`generate`; the contents of a file decide whether it is a scenario or a campaign."""
    from stridetwin.scenarios.campaign.campaign_file import campaigns, find_campaign
    from stridetwin.scenarios.scenario_file import catalogue
    from stridetwin.streams.validation import suggest

    name, names = arguments.scenario, [*catalogue(), *campaigns()]
    if name not in names and not Path(name).suffix and Path(name).parent == Path("."):
        valid = f"{suggest(name, names)}, or the path of a .yaml file"
        raise StrideTwinError(f"there is no scenario or campaign {name!r}: expected {valid}")
    path = find_campaign(name)
    if path is not None:
        return campaign_command(path, arguments, progress)
    for option in ("workers", "scheduler", "subset"):
        if (value := getattr(arguments, option)) is not None:
            raise ConfigError("command line", f"--{option}", value, f"a campaign to go with it; {name} is a scenario")
    return record_command(arguments, progress)


def campaign_command(path: Path, arguments: GenerateOptions, progress: Progress) -> Outcome:
    """`generate` of a campaign."""
    from stridetwin.scenarios.campaign import card, manifest
    from stridetwin.scenarios.campaign.campaign_file import read_campaign
    from stridetwin.scenarios.campaign.generate import Options, generate
    from stridetwin.scenarios.campaign.plan import Extra
    from stridetwin.scenarios.campaign.walk import ACCEPTED, FAILED
    from stridetwin.scenarios.scenario_file import PHYSICS

    if arguments.physics not in (None, *PHYSICS):
        raise ConfigError("command line", "--physics", arguments.physics, ", ".join(PHYSICS))
    if arguments.output.suffix == ".mcap" or arguments.output.is_file():
        raise ConfigError("command line", "--output", str(arguments.output), "a folder, as this is a campaign")
    if arguments.workers and arguments.scheduler:
        raise ConfigError("command line", "--workers", arguments.workers, "either --workers or --scheduler")
    if arguments.scheduler is not None and not _SCHEDULER.fullmatch(arguments.scheduler):
        valid = "HOST:PORT or PROTOCOL://HOST:PORT, such as tcp://10.0.0.5:8786"
        raise ConfigError("command line", "--scheduler", arguments.scheduler, valid)
    folder = arguments.output
    options = Options(
        folder=folder,
        workers=arguments.workers or 1,
        scheduler=arguments.scheduler,
        seed=arguments.seed,
        subset=arguments.subset,
        extra=Extra(physics=arguments.physics, cameras=not arguments.no_cameras),
    )
    done = generate(read_campaign(path), options, progress)
    walks, verdicts = done.manifest["walks"], done.verdicts
    hours = sum(w["duration_s"] for w in walks if w["status"] == ACCEPTED) / 3600
    data = {
        "campaign": done.manifest["campaign"],
        "folder": str(folder),
        "walks": len(walks),
        "made": done.made,
        "accepted": verdicts[ACCEPTED],
        "rejected": dict(done.reasons),
        "hours": hours,
        "manifest": str(folder / manifest.NAME),
        "card": str(folder / card.NAME),
    }
    lines = [f"{folder}: {verdicts[ACCEPTED]} of {len(walks)} walks, {hours:.2f} h ({done.made} made now)"]
    lines += [f"  rejected, {kind}: {count}" for kind, count in sorted(done.reasons.items())]
    return Outcome(data=data, lines=[*lines, f"card  {folder / card.NAME}"], code=1 if verdicts[FAILED] else 0)
