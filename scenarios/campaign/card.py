"""The card of a data set (Markdown): contents, distributions, splits, rejected walks, and how to read it."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from stridetwin.scenarios.campaign.walk import ACCEPTED

NAME = "dataset_card.md"
_BARS = "▁▂▃▄▅▆▇█"
_BINS = 16
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


def card(manifest: Mapping[str, Any]) -> str:
    """The card, from the campaign's manifest alone."""
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
        "\n".join(_files(manifest)),
        "## Reading the data",
        _READ.format(part=next(iter(manifest["shares"]))),
        "A recording is one MCAP file of ROS 2 messages, which Foxglove, Rerun, `mcap` and `rosbags` can open; "
        "it contains the calibration (Kalibr YAML). "
        "`stridetwin generate scenarios/walk_00000.yaml --seed SEED -o x.mcap` generates "
        "a walk again, with equal bytes, with the versions below.",
        "## Distributions",
        "Values of the accepted walks (numbers: lowest, mean, highest, and a histogram between lowest and highest).",
        "\n".join(_values(manifest, accepted)),
        "## Splits",
        "Two independent splits: no person is in two parts of the split by person, no terrain in two parts of the "
        f"split by terrain (terrains differ by their {manifest['terrain_by']}). Walks in `test` of both splits share "
        "neither person nor terrain with `train`.",
        "\n".join(_splits(manifest, accepted)),
        "## Rejected walks",
        "\n".join(_rejects(manifest, walks)),
        "## Versions",
        "\n".join(f"- {name} {version}" for name, version in manifest["versions"].items()),
        "Made with StrideTwin, which is licensed under Apache-2.0.",
    ]
    return "\n\n".join(blocks) + "\n"


def _files(manifest: Mapping[str, Any]) -> Iterator[str]:
    yield "| | |\n|---|---|"
    yield "| `manifest.json` | every walk: seed, drawn values, person, terrain, checksum, verdict, splits |"
    yield "| `recordings/` | the accepted walks |"
    yield "| `rejected/` | recordings of walks that were not accepted |"
    yield "| `scenarios/` | the scenario file of each walk |"
    if manifest["files"]:
        yield "| `files/` | parts, exoskeletons and meshes that the scenarios name |"
    yield "| `rows/` | the rows of the manifest, from which `generate` resumes |"


def _values(manifest: Mapping[str, Any], accepted: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "| value | distribution | walks | drawn |\n|---|---|---|---|"
    yield _row("scenario", ", ".join(manifest["scenarios"]), [w["scenario"] for w in accepted])
    for name, words in manifest["ranges"].items():
        if name.startswith("people["):
            yield _row(name, words, [])
            continue
        base, colon, own = name.partition(": ")
        drawn = [
            w["values"][own or base]
            for w in accepted
            if (own or base) in w["values"]
            and (w["scenario"] == base if colon else f"{w['scenario']}: {name}" not in manifest["ranges"])
        ]
        yield _row(name, words, drawn)
    bodies = [manifest["people"][w["person"]] for w in accepted]
    for key in ("sex", "height_m", "mass_kg", "shoe_mm"):
        drawn = [body[key] for body in bodies if key in body]
        if drawn:
            yield _row(f"person: {key}", "", drawn)
    yield _row("duration_s", "", [w["duration_s"] for w in accepted])


def _row(name: str, words: str, drawn: Sequence[Any]) -> str:
    return f"| {_cell(name)} | {_cell(words)} | {len(drawn) or ''} | {_cell(_drawn(drawn))} |"


def _drawn(values: Sequence[Any]) -> str:
    if not values:
        return ""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        low, high = min(values), max(values)
        return f"{low:g}, {statistics.fmean(values):.4g}, {high:g} {_histogram(values, low, high)}".strip()
    counts = Counter(str(v) for v in values)
    return ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))


def _histogram(values: Sequence[float], low: float, high: float) -> str:
    if low == high:
        return ""
    counts = Counter(min(int((v - low) / (high - low) * _BINS), _BINS - 1) for v in values)
    most = max(counts.values())
    return "".join(_BARS[round(counts[i] / most * (len(_BARS) - 1))] if counts[i] else " " for i in range(_BINS))


def _splits(manifest: Mapping[str, Any], accepted: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    parts = list(manifest["shares"])
    yield f"| split | | {' | '.join(parts)} |\n|---|---|{'---|' * len(parts)}"
    yield f"| requested | share | {' | '.join(f'{share:g}' for share in manifest['shares'].values())} |"
    for by, dealt in manifest["splits"].items():
        groups = Counter(dealt.values())
        walks = Counter(w["split"][by] for w in accepted)
        yield f"| by {by} | {'people' if by == 'person' else 'terrains'} | {_cells(groups[p] for p in parts)} |"
        yield f"| by {by} | walks | {_cells(walks[p] for p in parts)} |"
    both = Counter(w["split"]["person"] for w in accepted if len(set(w["split"].values())) == 1)
    yield f"| in the same part of both | walks | {_cells(both[p] for p in parts)} |"


def _rejects(manifest: Mapping[str, Any], walks: Iterable[Mapping[str, Any]]) -> Iterator[str]:
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
    return " | ".join(str(count) for count in counts)


def _cell(text: str) -> str:
    """Text escaped for a table cell."""
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())
