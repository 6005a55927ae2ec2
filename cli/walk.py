"""`run` and `generate`: walks of the twin, and data sets of many walks."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from stridetwin.cli.commands import GenerateOptions, RunOptions
from stridetwin.cli.options import Outcome, Progress, check_executor, check_recording_name
from stridetwin.cli.score import score_tables, warn_of_partial
from stridetwin.estimators.registry import names as estimator_names
from stridetwin.outputs.parameters import check_used, parse_parameters
from stridetwin.scenarios import record
from stridetwin.scenarios.campaign import manifest
from stridetwin.scenarios.campaign.campaign_file import Campaign, campaigns, find_campaign, read_campaign
from stridetwin.scenarios.campaign.extremes import base_scenarios, valid_scenarios
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate
from stridetwin.scenarios.campaign.plan import Extra, PlannedWalk
from stridetwin.scenarios.campaign.walk import ACCEPTED, FAILED
from stridetwin.scenarios.cost import Cost, cost_of, scale_cost
from stridetwin.scenarios.scenario_file import CAMERAS, Scenario, catalogue, load_scenario
from stridetwin.scenarios.score_needs import estimators_of, sensors_of, with_sensors_for
from stridetwin.sim.parts.sensor_config import KIND
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.notices import note
from stridetwin.streams.validation import suggest

_PRICED_WALKS = 20  # of a campaign, whose cost is announced by that of these


def run_command(arguments: RunOptions, progress: Progress) -> Outcome:
    """Runs `run`: walks a scenario, runs every estimator, scores it, and writes report and film into a folder.

    Returns:
        Scores, and the files written; the folder is that of `-o`, or `runs/` and the scenario's name.
    """
    from stridetwin.report.runner import run_scenario

    parameters = parse_parameters(arguments.parameters)
    check_used(parameters, estimators_of(arguments.only, "--only") if arguments.only else estimator_names())
    scenario = _load_scenario(arguments)
    _announce(
        cost_of([_restrict_sensors(scenario, arguments).config]),
        more="; estimates, film and report take two to three times as long",
    )
    folder = arguments.output or Path("runs") / scenario.config.name
    run = run_scenario(
        scenario,
        arguments.seed,
        folder,
        _how_to_repeat(arguments),
        progress,
        film=not arguments.no_film,
        backend=arguments.backend or "",
        only=arguments.only,
        parameters=parameters,
    )
    warn_of_partial([(scenario.config.name, run.scores)])
    data = {"folder": str(run.folder), "files": list(run.files), "estimators": run.scores}
    report = (run.folder / "report.html").absolute().as_uri()
    return Outcome(data=data, lines=[*score_tables(run.scores), "", f"report  {report}", f"files   {folder}/"])


def generate_command(arguments: GenerateOptions, progress: Progress) -> Outcome:
    """Runs `generate`; the contents of the file decide whether it is a scenario or a campaign.

    Raises:
        StrideTwinError: There is no such scenario or campaign, or an option is only valid for the other.
    """
    name, names = arguments.scenario, [*catalogue(), *campaigns()]
    if name not in names and not Path(name).suffix and Path(name).parent == Path("."):
        valid = f"{suggest(name, names)}, or the path of a .yaml file"
        raise StrideTwinError(f"invalid scenario or campaign {name!r}: expected {valid}")
    path = find_campaign(name)
    if path is not None:
        return _generate_campaign(path, arguments, progress)
    for limited in ("workers", "scheduler", "subset"):
        if (value := getattr(arguments, limited)) is not None:
            raise ConfigError("command line", f"--{limited}", value, f"no --{limited}, as {name} is a scenario")
    return _record_walk(arguments, progress)


def _generate_campaign(path: Path, arguments: GenerateOptions, progress: Progress) -> Outcome:
    """Generates the walks of a campaign into a folder, and sums up how many were accepted and why others were not.

    Args:
        path: File of the campaign.
        arguments: Options of the command.
        progress: Receives the stage and its progress (0-1).

    Returns:
        Counts, hours and files; the exit code is 1 if a walk has failed or none was accepted.

    Raises:
        StrideTwinError: The output is a file, the campaign is invalid, or an option does not fit it.
    """
    if arguments.output.suffix == ".mcap" or arguments.output.is_file():
        raise ConfigError("command line", "--output", str(arguments.output), "a folder, as this is a campaign")
    check_executor(arguments.workers, arguments.scheduler)
    folder, campaign = arguments.output, read_campaign(path)
    options = CampaignOptions(
        folder=folder,
        workers=arguments.workers or 1,
        scheduler=arguments.scheduler,
        seed=arguments.seed,
        subset=arguments.subset,
        extra=Extra(physics=arguments.physics, off=_list_switched_off(campaign, arguments)),
    )
    result = generate(campaign, options, progress, lambda missing: _announce_campaign(campaign, options, missing))
    walks, verdicts = result.manifest["walks"], result.verdicts
    # of the accepted walks
    hours = sum(w["duration_s"] for w in walks if w["status"] == ACCEPTED) / 3600
    data = {
        "campaign": result.manifest["campaign"],
        "folder": str(folder),
        "walks": len(walks),
        "made": result.generated,
        "accepted": verdicts[ACCEPTED],
        "rejected": dict(result.reasons),
        "empty_parts": result.empty_parts,
        "hours": hours,
        "manifest": str(folder / manifest.NAME),
        "card": str(folder / manifest.CARD_NAME),
    }
    lines = [f"{folder}: {verdicts[ACCEPTED]} of {len(walks)} walks, {hours:.2f} h ({result.generated} generated now)"]
    lines += [f"  rejected, {kind}: {count}" for kind, count in sorted(result.reasons.items())]
    if verdicts[ACCEPTED] == 0:
        lines.append("WARNING: no walk was accepted")
    elif result.empty_parts:
        lines.append(
            f"WARNING: no accepted walk in {', '.join(result.empty_parts)}: expected more walks, or fewer parts"
        )
    code = 1 if verdicts[FAILED] or not verdicts[ACCEPTED] else 0
    return Outcome(data=data, lines=[*lines, f"card  {folder / manifest.CARD_NAME}"], code=code)


def _announce_campaign(campaign: Campaign, options: CampaignOptions, missing: Sequence[PlannedWalk]) -> None:
    """Prints the cost of a campaign's missing walks on stderr if it is long, estimated from a few of them."""
    few = missing[:: max(1, len(missing) // _PRICED_WALKS)]  # evenly spaced over all
    configs = [scenario.config for scenario in valid_scenarios(campaign, few)]
    if configs:  # none if all of the few are invalid with the values drawn: then nothing is announced
        _announce(scale_cost(cost_of(configs), len(missing)), options.workers)


def _announce(cost: Cost, workers: int = 1, more: str = "") -> None:
    """Prints the cost of walks on stderr if it is long."""
    if cost.is_long:
        note(f"{cost.describe(workers)}{more}")


def _list_switched_off(campaign: Campaign, arguments: GenerateOptions) -> tuple[str, ...]:
    """Groups of sensors that the walks of a campaign do without, because of `--no-cameras` and `--only`.

    With `--only`, a group stays if one of the campaign's scenarios needs it for one of these estimators.
    """
    off = set(CAMERAS if arguments.no_cameras else ())
    if arguments.only:
        asked = estimators_of(arguments.only, "--only")
        needed = {group for base in base_scenarios(campaign) for group in sensors_of(asked, base.config)}
        off |= set(KIND) - needed
    return tuple(group for group in KIND if group in off)


def _record_walk(arguments: GenerateOptions, progress: Progress) -> Outcome:
    """Generates the walk of one scenario as a recording."""
    check_recording_name("generate -o", arguments.output)
    scenario = _restrict_sensors(_load_scenario(arguments), arguments)
    _announce(cost_of([scenario.config]))
    seed = arguments.seed or 0
    twin = record.make_twin(scenario, seed)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    record.record(twin, arguments.output, progress)
    data = {"recording": str(arguments.output), "duration_s": twin.duration_s, "seed": seed}
    return Outcome(data=data, lines=[f"{arguments.output}: {twin.duration_s:.1f} s of {scenario.config.name}"])


def load_with_notes(name: str) -> Scenario:
    """Loads a scenario by its name in the catalogue or its file, and prints its notes on stderr."""
    scenario = load_scenario(name)
    for text in scenario.notes:
        note(text)
    return scenario


def _load_scenario(arguments: RunOptions | GenerateOptions) -> Scenario:
    """Loads the scenario of the command line, with the physics and without the cameras as its options say."""
    scenario = load_with_notes(arguments.scenario)
    if arguments.physics is not None:
        scenario = replace(scenario, config=replace(scenario.config, physics=arguments.physics))
    return record.without_cameras(scenario) if arguments.no_cameras else scenario


def _restrict_sensors(scenario: Scenario, arguments: RunOptions | GenerateOptions) -> Scenario:
    """The scenario with only those sensors that the estimators of `--only` read; unchanged without that option."""
    if not arguments.only:
        return scenario
    return with_sensors_for(scenario, estimators_of(arguments.only, "--only"))


def _how_to_repeat(arguments: RunOptions) -> str:
    """The command line that makes the same run again, for the report."""
    command = ["stridetwin", "run", arguments.scenario, "--seed", str(arguments.seed)]
    command += ["--physics", arguments.physics] if arguments.physics else []
    command += ["--no-cameras"] if arguments.no_cameras else []
    command += ["--no-film"] if arguments.no_film else []
    command += ["--backend", arguments.backend] if arguments.backend else []
    command += [word for name in arguments.only for word in ("--only", name)]
    command += [word for text in arguments.parameters for word in ("--set", text)]
    return shlex.join(command)
