"""Stairs and ramps beside each other, with and without a landing between them: can every such walk be planned?

Run as `python -m benchmarks.neighbours [--landings 0 0.3 0.6 1.2] [--seed N] [--json]`. It plans every ordered pair of
stairs (40, 120, 220 mm) and ramps (3, 8, 15 deg), up and down, over each landing in m, and prints the pairs that are
refused or fail. Two flights without a landing are one flight, and two ramps without one are one bend: the flights are
refused. The exit code is 1 if a pair fails for another reason than a refusal in one line.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import product
from typing import Any

from benchmarks.command import command
from stridetwin.sim.config import Level, Ramp, Route, Stairs, TwinConfig
from stridetwin.sim.twin import Twin
from stridetwin.streams.errors import StrideTwinError

RISERS_MM, SLOPES_DEG = (40, 120, 220), (3, 8, 15)
LANDINGS_M = (0.0, 0.3, 0.6, 1.2)
_RISE_M = 0.35


def neighbours() -> Iterator[tuple[str, Stairs | Ramp]]:
    """Every stair and ramp, by name."""
    for way, down in (("up", False), ("down", True)):
        for mm in RISERS_MM:
            yield f"stair {mm} mm {way}", Stairs(risers=3, riser_m=1e-3 * mm, down=down)
        for deg in SLOPES_DEG:
            yield f"ramp {deg} deg {way}", Ramp(angle_rad=math.radians(deg), rise_m=_RISE_M, down=down)


def planned(one: Stairs | Ramp, other: Stairs | Ramp, landing_m: float, seed: int) -> tuple[str, str]:
    """`ok`, `refused` or `failed`, and why."""
    between = (Level(length_m=landing_m),) if landing_m else ()
    segments = (Level(length_m=2.0), one, *between, other, Level(length_m=2.0))
    try:
        Twin(TwinConfig(name="neighbours", route=Route(segments=segments), sensors=()), seed)  # plans the walk
    except StrideTwinError as error:
        return ("failed" if "misses its footstep" in str(error) else "refused"), str(error)
    return "ok", ""


def main() -> int:
    """Prints what is not planned, and the counts."""
    parser = command(__doc__)
    parser.add_argument("--landings", type=float, nargs="+", default=LANDINGS_M, metavar="M")
    parser.add_argument("--seed", type=int, default=1000)
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    not_planned: list[dict[str, Any]] = []
    for landing, (a, one), (b, other) in product(given.landings, neighbours(), neighbours()):
        verdict, why = planned(one, other, landing, given.seed)
        counts[verdict] += 1
        if verdict != "ok":
            not_planned.append({"landing_m": landing, "first": a, "second": b, "verdict": verdict, "why": why})
            if not given.json:
                print(f"{verdict}: {a}, {landing:g} m, {b}: {why}", flush=True)
    if given.json:
        print(json.dumps({"counts": counts, "not_planned": not_planned}))
    else:
        print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    return int(counts["failed"] > 0)


if __name__ == "__main__":
    sys.exit(main())
