"""The manifest of a campaign (checksum, verdict and split parts of every walk), and the card that describes it.

The manifest holds no time, machine or number of workers, so it has the same bytes wherever it is written. No person
and no terrain is in two parts of one split. They are assigned in order of their first walk, by the fractional parts of
multiples of the golden ratio (a Weyl sequence): shares hold for any number of them, and further walks do not change
earlier assignments.
"""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypedDict

import numpy as np

from stridetwin.scenarios.campaign.campaign_file import Campaign, Splits
from stridetwin.scenarios.campaign.walk import ACCEPTED, WalkRow

_GOLDEN = (5**0.5 - 1) / 2
_KEYS = {"person": 2, "terrain": 3}  # keys of the random numbers of each split
_BARS = "▁▂▃▄▅▆▇█"
_BINS = 16
_FILES = {
    "manifest.json": "every walk: seed, drawn values, person, terrain, checksum, verdict, splits",
    "recordings/": "the accepted walks",
    "rejected/": "recordings of walks that were not accepted",
    "scenarios/": "the scenario file of each walk",
    "files/": "parts, exoskeletons and meshes that the scenarios name",
    "request.json": "campaign, seed and options that the folder belongs to",
    "rows/": "the rows of the manifest, from which `generate` resumes",
}
_READ = """```python
import json
from pathlib import Path

from stridetwin.streams.recording.reader import Recording

folder = Path(".")  # where this file lies
for walk in json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["walks"]:
    if walk["status"] == "accepted" and walk["split"]["person"] == "{part}":
        recording = Recording(folder / walk["recording"])
        pelvis = recording.block("/truth/pelvis/odometry").columns["p_frame_in_world"]  # (N, 3) m
        print(walk["walk"], sorted(recording.topics), pelvis.shape)
```"""


class QualityLimits(TypedDict):
    """The criteria of a campaign by which walks are rejected; see `campaign_file.Quality`."""

    falls: str
    sensors: str
    help_pct: float


class Manifest(TypedDict):
    """The manifest of a campaign.

    Attributes:
        format: `FORMAT`.
        campaign: Name of its file.
        description: Its purpose.
        seed: Seed of all random numbers.
        sampling: Method that spreads the draws.
        scenarios: Names of the scenarios.
        ranges: Varying values with their distributions as text.
        quality: Criteria by which walks are rejected.
        shares: Requested share of each part of a split.
        terrain_by: Property in which two terrains differ.
        versions: Versions of the code that generated the walks.
        files: Digests of the user's files by name.
        people: Body measures by person.
        splits: Part by name, of each person (`person`) and terrain (`terrain`).
        walks: Rows of all walks.
    """

    format: str
    campaign: str
    description: str
    seed: int
    sampling: str
    scenarios: list[str]
    ranges: dict[str, str]
    quality: QualityLimits
    shares: dict[str, float]
    terrain_by: str
    versions: dict[str, str]
    files: dict[str, str]
    people: dict[str, dict[str, object]]
    splits: dict[str, dict[str, str]]
    walks: list[WalkRow]


def assign_splits(rows: Sequence[WalkRow], splits: Splits, seed: int) -> dict[str, dict[str, str]]:
    """Assigns each person and each terrain of all walks to a part of its split.

    Returns:
        By `person` and `terrain`: name to part.
    """
    parts = {}
    for by in _KEYS:
        groups = [group for row in rows if (group := group_of(row, by, splits))]
        names = list(dict.fromkeys(groups))  # each once, in the order of its first walk
        parts[by] = _assign_parts(names, splits.shares, seed, by)
    return parts


def group_of(row: WalkRow, by: str, splits: Splits) -> str | None:
    """Name of the person or the terrain of a walk, whichever the split is by.

    Args:
        row: Row of the walk.
        by: `person` or `terrain`.
        splits: Tells whether a terrain is a geometry or a scenario.

    Returns:
        None where the walk's scenario is invalid, so that it has neither.
    """
    if "person" not in row:
        return None
    if by == "person":
        return row["person"]
    return row["scenario"] if splits.terrain_by == "scenario" else row.get("terrain")


def _assign_parts(names: Sequence[str], shares: Mapping[str, float], seed: int, by: str) -> dict[str, str]:
    """Part of each name: of the i-th one by the fractional part of start + i (√5 - 1) / 2; a seed gives the start.

    Args:
        names: Persons or terrains, in the order of their first walk.
        shares: Share of each part; they add up to 1.
        seed: Seed of the campaign.
        by: `person` or `terrain`, which have starts of their own.
    """
    start = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEYS[by],))).random()
    parts, ends = list(shares), np.cumsum(list(shares.values()))
    start *= ends[0]  # the first name is in the first part
    part_of = {}
    for i, name in enumerate(names):
        fraction = (start + i * _GOLDEN) % 1.0
        number = int(np.searchsorted(ends, fraction, side="right"))
        part_of[name] = parts[min(number, len(parts) - 1)]  # rounding may leave the last end just below 1
    return part_of


FORMAT = "stridetwin-campaign-1"
NAME, CARD_NAME = "manifest.json", "dataset_card.md"


def manifest(
    campaign: Campaign, rows: Sequence[WalkRow], versions: Mapping[str, str], file_digests: Mapping[str, str]
) -> Manifest:
    """The manifest of a campaign as JSON: its request, versions, people, splits and the rows of its walks, in order.

    Args:
        campaign: The campaign.
        rows: Rows of all walks.
        versions: Versions of the code that generated them.
        file_digests: Checksums of the user's files.
    """
    parts = assign_splits(rows, campaign.splits, campaign.seed)
    walks, bodies = list[WalkRow](), dict[str, dict[str, object]]()
    for row in rows:
        entry = row.copy()  # without the body, which `people` has once per person
        entry.pop("body", None)
        if "person" in row:
            bodies[row["person"]] = row["body"]
        if row["status"] == ACCEPTED:
            entry["split"] = {by: parts[by][str(group_of(row, by, campaign.splits))] for by in parts}
        walks.append(entry)
    return {
        "format": FORMAT,
        "campaign": campaign.path.stem,
        "description": campaign.description,
        "seed": campaign.seed,
        "sampling": campaign.sampling,
        "scenarios": sorted({base.name for base in campaign.bases}),
        "ranges": varying_values(campaign),
        "quality": {
            "falls": campaign.quality.falls,
            "sensors": campaign.quality.sensors,
            "help_pct": campaign.quality.help_pct,
        },
        "shares": campaign.splits.shares,
        "terrain_by": campaign.splits.terrain_by,
        "versions": dict(versions),
        "files": dict(file_digests),
        "people": bodies,
        "splits": parts,
        "walks": walks,
    }


def varying_values(campaign: Campaign) -> dict[str, str]:
    """Each varying value, with its distribution as text; values of one scenario begin with its name."""
    texts = {v.name: v.distribution.description for v in campaign.variables if v.varies}
    for base in campaign.bases:
        texts |= {f"{base.name}: {v.name}": v.distribution.description for v in base.variables if v.varies}
    for i, people in enumerate(campaign.people):
        if people.names:
            texts[f"people[{i}]"] = ", ".join(people.names)
        for key, distribution in people.body.items():
            texts[f"people[{i}].{key}"] = distribution.description
    return texts


def card_text(manifest: Manifest) -> str:
    """The card of a data set as Markdown, from the campaign's manifest alone."""
    walks = manifest["walks"]
    accepted = [w for w in walks if w["status"] == ACCEPTED]
    hours = sum(w["duration_s"] for w in accepted) / 3600
    mebibytes = sum(w["bytes"] for w in accepted) / 2**20
    blocks = [
        f"# {manifest['description']}",
        f"{len(accepted)} walks of {len(walks)} requested, {hours:.2f} h, {mebibytes:.0f} MiB, "
        f"by {len({w['person'] for w in accepted})} people over {len({w['terrain'] for w in accepted})} terrains: "
        "synthetic recordings of a simulated person who walks in a lower-limb exoskeleton, every sensor with the truth "
        f"beside it. Made by the campaign `{manifest['campaign']}`, seed {manifest['seed']}, "
        f"{manifest['sampling'].replace('_', ' ')} sampling.",
        "## Contents",
        "\n".join(_file_lines(manifest)),
        "## Reading the data",
        _READ.format(part=next(iter(manifest["shares"]))),
        "A recording is one MCAP file of ROS 2 messages, which Foxglove, Rerun, `mcap` and `rosbags` can open; "
        "it contains the calibration (Kalibr YAML). "
        "`stridetwin generate scenarios/walk_00000.yaml --seed SEED -o x.mcap` generates "
        "a walk again, with equal bytes, with the versions below.",
        "## Distributions",
        "Values of the accepted walks (numbers: lowest, mean, highest, and a histogram between lowest and highest).",
        "\n".join(_value_lines(manifest, accepted)),
        "## Splits",
        "Two independent splits: no person is in two parts of the split by person, no terrain in two parts of the "
        f"split by terrain (terrains differ by their {manifest['terrain_by']}). Walks in `test` of both splits share "
        "neither person nor terrain with `train`.",
        "\n".join(_split_lines(manifest, accepted)),
        "## Rejected walks",
        "\n".join(_reject_lines(manifest, walks)),
        "## Versions",
        "\n".join(f"- {name} {version}" for name, version in manifest["versions"].items()),
        "Made with StrideTwin, which is licensed under Apache-2.0.",
    ]
    return "\n\n".join(blocks) + "\n"


def _file_lines(manifest: Manifest) -> Iterator[str]:
    """Yields the lines of the card's table of files."""
    yield "| | |\n|---|---|"
    for name, what in _FILES.items():
        if name != "files/" or manifest["files"]:
            yield f"| `{name}` | {what} |"


def _value_lines(manifest: Manifest, accepted: Sequence[WalkRow]) -> Iterator[str]:
    """Lines of the table of distributions: each varying value with the values of the accepted walks."""
    yield "| value | distribution | walks | drawn |\n|---|---|---|---|"
    yield _row("scenario", ", ".join(manifest["scenarios"]), [w["scenario"] for w in accepted])
    for name, text in manifest["ranges"].items():
        if name.startswith("people["):
            yield _row(name, text, [])
            continue
        # `NAME` is set in all scenarios, `BASE: NAME` in one, where it replaces the value of all
        first, colon, second = name.partition(": ")
        base, value_name = (first, second) if colon else ("", name)
        values = [
            w["values"][value_name]
            for w in accepted
            if value_name in w["values"]
            and (w["scenario"] == base if base else f"{w['scenario']}: {name}" not in manifest["ranges"])
        ]
        yield _row(name, text, values)
    # the measures that the people actually have, instead of drawn quantities such as `bmi`
    bodies = [manifest["people"][w["person"]] for w in accepted]
    for key in ("sex", "height_m", "mass_kg", "shoe_mm"):
        values = [body[key] for body in bodies if key in body]
        if values:
            yield _row(f"person: {key}", "", values)
    yield _row("duration_s", "", [w["duration_s"] for w in accepted])


def _row(name: str, text: str, values: Sequence[object]) -> str:
    """A row of the card's table of varying values: name, distribution, and the values of the walks."""
    return f"| {_cell(name)} | {_cell(text)} | {len(values) or ''} | {_cell(_distribution_text(values))} |"


def _distribution_text(values: Sequence[object]) -> str:
    """Lowest, mean and highest of numbers with a histogram, or the counts of other values."""
    if not values:
        return ""
    numbers = [v for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(numbers) == len(values):
        low, high = min(numbers), max(numbers)
        return f"{low:g}, {statistics.fmean(numbers):.4g}, {high:g} {_histogram(numbers, low, high)}".strip()
    counts = Counter(str(v) for v in values)
    return ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))


def _histogram(values: Sequence[float], low: float, high: float) -> str:
    """A histogram of values between two limits as a word of bars; "" if the limits are equal."""
    if low == high:
        return ""
    counts = Counter(min(int((v - low) / (high - low) * _BINS), _BINS - 1) for v in values)
    max_count = max(counts.values())
    heights = [round(counts[i] / max_count * (len(_BARS) - 1)) for i in range(_BINS)]
    return "".join(_BARS[height] if counts[i] else " " for i, height in enumerate(heights))  # an empty bin is a blank


def _split_lines(manifest: Manifest, accepted: Sequence[WalkRow]) -> Iterator[str]:
    """Lines of the table of splits: people, terrains and accepted walks in each part."""
    parts = list(manifest["shares"])
    yield f"| split | | {' | '.join(parts)} |\n|---|---|{'---|' * len(parts)}"
    yield f"| requested | share | {' | '.join(f'{share:g}' for share in manifest['shares'].values())} |"
    for by, part_of in manifest["splits"].items():
        groups = Counter(part_of.values())
        walks = Counter(w["split"][by] for w in accepted)
        yield f"| by {by} | {'people' if by == 'person' else 'terrains'} | {_cells(groups[p] for p in parts)} |"
        yield f"| by {by} | walks | {_cells(walks[p] for p in parts)} |"
    # walks whose person and terrain are in the same part, by this part
    both = Counter(w["split"]["person"] for w in accepted if len(set(w["split"].values())) == 1)
    yield f"| in the same part of both | walks | {_cells(both[p] for p in parts)} |"


def _reject_lines(manifest: Manifest, walks: Iterable[WalkRow]) -> Iterator[str]:
    """The criteria, and the table of the walks that were not accepted with the reasons."""
    quality = manifest["quality"]
    yield (
        f"Infeasible walks; walks with more external force at the root than {quality['help_pct']:g} % of the body "
        f"weight; falls ({quality['falls']}); walks with a stream that `check` finds invalid "
        f"({quality['sensors']}), except streams with an injected fault.\n"
    )
    rejected = [w for w in walks if w["status"] != ACCEPTED]
    if not rejected:
        yield "None."
        return
    yield "| walk | reason |\n|---|---|"
    for walk in rejected:
        yield f"| `{walk['walk']}` | {_cell('; '.join(walk['reasons']))} |"


def _cells(counts: Iterable[int]) -> str:
    """Counts as cells of a Markdown table."""
    return " | ".join(str(count) for count in counts)


def _cell(text: str) -> str:
    """Text with characters that have a meaning in a Markdown table replaced."""
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())
