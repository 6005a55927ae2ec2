"""Is a walk fit for the data set: falls, help at the root, and what `check` says of its streams."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stridetwin.scenarios import injected
from stridetwin.scenarios.campaign.campaign_file import Quality
from stridetwin.scenarios.check import Finding, check_recording
from stridetwin.sim.config import Person
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.recording import Recording

_RESIDUAL = "/truth/root_residual"


def measured(recording: Recording, person: Person, fell_at_s: float | None) -> dict[str, Any]:
    """What there is to judge by, as the manifest has it.

    Args:
        recording: Opened leniently.
        person: Who walks: the help is told in % of the body weight.
        fell_at_s: When the walker fell, as the twin says.

    Returns:
        `duration_s`, `fell_at_s`, `help_mean_pct`, and what `check` says that would spoil an estimate: `findings`, and
        `expected_findings` about streams with a fault that was asked for.
    """
    broken = {i.topic for i in injected.from_metadata(recording.metadata)}
    spoils = [f for f in check_recording(recording).findings if f.spoils]
    return {
        "duration_s": _rounded(recording.duration),
        "fell_at_s": None if fell_at_s is None else _rounded(fell_at_s),
        "help_mean_pct": _root_help_pct(recording, person),
        "findings": [_words(f) for f in spoils if f.topic not in broken],
        "expected_findings": [_words(f) for f in spoils if f.topic in broken],
    }


def reasons(figures: Mapping[str, Any], quality: Quality) -> list[str]:
    """Why a walk is rejected; nothing where it is fit.

    Args:
        figures: Of `measured`.
        quality: What is asked.
    """
    found = []
    if figures["fell_at_s"] is not None and quality.falls == "reject":
        found.append(f"fell: at {figures['fell_at_s']:.2f} s")
    if (help_pct := figures["help_mean_pct"]) > quality.help_pct:
        found.append(f"help: {help_pct:g} % of the body weight at the root; valid: up to {quality.help_pct:g} %")
    if quality.sensors == "reject":
        found += [f"sensors: {words}" for words in figures["findings"]]
    return found


def _root_help_pct(recording: Recording, person: Person) -> float:
    """Mean force that helped at the root, beside the ground's, % of the body weight; 0 for a walk that is played."""
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1)
    return _rounded(100.0 * float(force.mean()) / (person.mass_kg * NOMINAL_GRAVITY_MPS2))


def _words(finding: Finding) -> str:
    return finding.what if finding.what.startswith(finding.topic) else f"{finding.topic}: {finding.what}"


def _rounded(value: float) -> float:
    """Three decimals; what rounding errors leave of nothing is nothing."""
    return round(value, 3) + 0.0
