"""Validates the ends of every range before the first walk.

Each variable is set to its ends on each scenario, while the others are at their median. Combinations that are invalid
(a route that crosses itself, a landing too short) are rejected when they are generated.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from stridetwin.scenarios.campaign.campaign_file import Campaign, Group
from stridetwin.scenarios.campaign.named_files import (
    FILES,
    SCENARIOS,
    Base,
    Variable,
    copy_files,
    errors_in_user_files,
    parse_scenario,
)
from stridetwin.scenarios.campaign.plan import Extra, PlannedWalk, Walker, draw_people, effective_variables, scenario_of
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.streams.errors import ConfigError, StrideTwinError

_MIDDLE = 0.5  # probability of the median
_STEPS = {"description": "a few steps", "terrain": [{"level": {"length_m": 2}}]}


@contextmanager
def _temporary_folder(campaign: Campaign) -> Iterator[Path]:
    """Yields a temporary output folder with copies of the user's files, in which scenarios are tried."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / SCENARIOS).mkdir()
        copy_files(folder, campaign.user_files)
        yield folder


def base_scenarios(campaign: Campaign) -> list[Scenario]:
    """The campaign's scenarios as their files have them.

    Raises:
        StrideTwinError: One of them is invalid.
    """
    with _temporary_folder(campaign) as folder:
        return [_parse_unchanged(folder, campaign, base) for base in campaign.bases]


def valid_scenarios(campaign: Campaign, walks: Iterable[PlannedWalk]) -> list[Scenario]:
    """The scenarios of some walks, without those that are invalid with the values drawn."""
    scenarios = []
    with _temporary_folder(campaign) as folder:
        for walk in walks:
            with suppress(StrideTwinError):
                scenarios.append(parse_scenario(folder, walk.scenario))
    return scenarios


def check_extremes(campaign: Campaign, extra: Extra) -> None:
    """Tries the ends of every range on each scenario, while the other values are at their median.

    Raises:
        ConfigError: A scenario or a value is invalid; the message names file, field, value and what is valid.
    """
    with _temporary_folder(campaign) as folder:
        for group in campaign.people:
            _try_people(folder, group)
        # one person is enough: the bodies have been checked by themselves
        first_person = next(iter(draw_people(campaign)), None)
        for base in campaign.bases:
            varied = [v for v in effective_variables(campaign, base, extra) if v.varies]
            middle = {v.name: v.distribution.at(_MIDDLE) for v in varied}  # the medians
            _try_base(folder, campaign, base, first_person, middle, extra)
            for variable in varied:
                for end in variable.distribution.ends:
                    try:
                        values = middle | {variable.name: end}  # one value at an end, the others at their median
                        parse_scenario(folder, scenario_of(campaign, base, first_person, values, extra))
                    except StrideTwinError as error:
                        # the error is located in a file of the user, else in the campaign's file
                        if (user_error := errors_in_user_files(error, campaign.user_files)) is not None:
                            raise user_error from error
                        raise _campaign_error(variable, base, end, error) from error


def _parse_unchanged(folder: Path, campaign: Campaign, base: Base) -> Scenario:
    """Parses a scenario as its file has it, without any value of the campaign.

    Args:
        folder: Temporary folder in which the scenario is tried.
        campaign: The campaign, which names the user's files.
        base: The scenario.

    Raises:
        StrideTwinError: The scenario is invalid; the error is in the campaign's file, or in a file of the user.
    """
    try:
        return parse_scenario(folder, base.scenario)
    except StrideTwinError as error:
        user_error = errors_in_user_files(error, campaign.user_files, base.file)
        raise user_error or base.at.error(base.written, f"a valid scenario ({_error_text(error)})") from error


def _try_base(
    folder: Path, campaign: Campaign, base: Base, person: Walker | None, middle: Mapping[str, object], extra: Extra
) -> None:
    """Checks a scenario as its file has it, then with the values that the campaign sets in all of its walks.

    Args:
        folder: Temporary folder in which the scenario is tried.
        campaign: The campaign.
        base: The scenario.
        person: A person of the campaign; None if it draws no people.
        middle: Median of each variable that varies, by its name.
        extra: What the command line adds to the campaign.

    Raises:
        StrideTwinError: The scenario is invalid. The error is in a user's file or in the campaign's file: at the
            variable that sets the refused field, else at the name of the scenario.
    """
    _parse_unchanged(folder, campaign, base)
    scenario = scenario_of(campaign, base, person, middle, extra)
    try:
        parse_scenario(folder, scenario)
    except StrideTwinError as error:
        if (user_error := errors_in_user_files(error, campaign.user_files)) is not None:
            raise user_error from error
        for variable in effective_variables(campaign, base, extra):
            if isinstance(error, ConfigError) and _is_about(error, variable):
                # the file does not have the refused median, but the distribution that it comes from
                if variable.varies and error.value == middle.get(variable.name):
                    raise variable.at.error(variable.distribution.description, error.valid) from error
                raise _campaign_error(variable, base, error.value, error) from error
        raise base.at.error(
            base.written, f"a scenario that allows the values that are set ({_error_text(error)})"
        ) from error


def _try_people(folder: Path, group: Group) -> None:
    """Checks the ends of each distribution of a group's people on a walk of a few steps.

    `bmi` is exempt: a scenario's person has no such field (it only gives the mass), and its range was already checked
    when the campaign's file was read.

    Args:
        folder: Temporary folder in which the walk's scenario is tried.
        group: A group of the campaign's people.

    Raises:
        ConfigError: A person is invalid at an end; the error is in the campaign's file, at the key of the distribution.
    """
    for key, distribution in group.body.items():
        for end in distribution.ends if key != "bmi" else ():
            try:
                parse_scenario(folder, {**_STEPS, "person": {key: end}})
            except ConfigError as error:
                raise group.at.key(key).error(error.value, error.valid) from error


def _campaign_error(variable: Variable, base: Base, value: object, error: StrideTwinError) -> ConfigError:
    """A scenario's error as an error of the campaign's file.

    Args:
        variable: The variable that was set to an end of its range.
        base: The scenario.
        value: That end.
        error: Error of the scenario. One in the variable's field keeps its value and what is valid; another one
            becomes an error of the end.
    """
    if isinstance(error, ConfigError) and _is_about(error, variable):
        return variable.at.error(error.value, error.valid)
    return variable.at.error(value, f"a value that {base.name} allows ({_error_text(error)})")


def _is_about(error: ConfigError, variable: Variable) -> bool:
    """Whether an error of a scenario is in a field that a variable sets, or in a group of fields around it."""
    return any(error.field.startswith(path.text) or path.text.startswith(error.field) for path in variable.paths)


def _error_text(error: StrideTwinError) -> str:
    """The error without the temporary file's path, but with the name of a user's file."""
    if not isinstance(error, ConfigError):
        return str(error)
    is_user_file = FILES in Path(error.source).parts
    file_prefix = f"{Path(error.source).name}: " if is_user_file else ""
    return f"{file_prefix}{error.field}: {error.problem}"
