"""Quality check of a walk: falls, external force at the root, and the findings of `check` on its streams."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stridetwin.scenarios import injected
from stridetwin.scenarios.campaign.campaign_file import Quality
from stridetwin.scenarios.check import Finding, check_recording
from stridetwin.sim.config import Person
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.recording.reader import Recording

_RESIDUAL = "/truth/root_residual"


def measured(recording: Recording, person: Person, fell_at_s: float | None) -> dict[str, Any]:
    """Figures of the quality check, as the manifest holds them.

    Args:
        recording: Opened leniently.
        person: The walker; the force at the root is given in % of the body weight.
        fell_at_s: When the walker fell according to the twin, s.

    Returns:
        `duration_s`, `fell_at_s`, `help_mean_pct`, and the errors that `check` finds: `findings`, and
        `expected_findings` about streams with an injected fault.
    """
    broken = {i.topic for i in injected.from_metadata(recording.metadata)}
    errors = [f for f in check_recording(recording).findings if f.is_error]
    return {
        "duration_s": _rounded(recording.duration),
        "fell_at_s": None if fell_at_s is None else _rounded(fell_at_s),
        "help_mean_pct": _root_help_pct(recording, person),
        "findings": [_words(f) for f in errors if f.topic not in broken],
        "expected_findings": [_words(f) for f in errors if f.topic in broken],
    }


def reasons(figures: Mapping[str, Any], quality: Quality) -> list[str]:
    """Why a walk is rejected; empty where it is accepted.

    Args:
        figures: Of `measured`.
        quality: The campaign's limits.
    """
    found = []
    if figures["fell_at_s"] is not None and quality.falls == "reject":
        found.append(f"fell: at {figures['fell_at_s']:.2f} s")
    if (help_pct := figures["help_mean_pct"]) > quality.help_pct:
        found.append(f"help: {help_pct:g} % of the body weight at the root: expected up to {quality.help_pct:g} %")
    if quality.sensors == "reject":
        found += [f"sensors: {words}" for words in figures["findings"]]
    return found


def _root_help_pct(recording: Recording, person: Person) -> float:
    """Mean external force at the root besides the ground's, % of the body weight; 0 for a kinematic walk."""
    force = np.linalg.norm(recording.block(_RESIDUAL).columns["force_in_world"], axis=1)
    return _rounded(100.0 * float(force.mean()) / (person.mass_kg * NOMINAL_GRAVITY_MPS2))


def _words(finding: Finding) -> str:
    return finding.what if finding.what.startswith(finding.topic) else f"{finding.topic}: {finding.what}"


def _rounded(value: float) -> float:
    """Three decimals; -0 becomes 0."""
    return round(value, 3) + 0.0
