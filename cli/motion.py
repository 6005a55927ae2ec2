"""`motion`: a wearer fitted to a recording of a person."""

from __future__ import annotations

import numpy as np

from stridetwin.cli.commands import MotionOptions
from stridetwin.cli.options import Outcome, Progress
from stridetwin.streams.errors import explain_import_error

_IMAGE_PX = (960, 640)


def motion_command(arguments: MotionOptions, progress: Progress) -> Outcome:
    """Runs `motion`: residuals of the markers, steps and terrain of a recording, and an image of its middle."""
    with explain_import_error("a recorded motion needs the simulator", "twin"):
        from stridetwin.sim.config import Level, Motion, Person, Route, TwinConfig
        from stridetwin.sim.motion.source import angle_format, apply_motion
        from stridetwin.sim.twin import Twin
    recording = Motion(
        file=str(arguments.file), markers=arguments.markers or None, duration_s=arguments.duration_s or None
    )
    config = TwinConfig(
        name=arguments.file.name,
        route=Route(segments=(Level(length_m=1.0),)),
        person=Person(height_m=arguments.height_m, mass_kg=arguments.mass_kg),
        exo=None,
        sensors=(),
        motion=recording,
    )
    progress("fit", 0.0)
    config, fitted = apply_motion(config)
    residuals = {name: 1e3 * value for name, value in fitted.residuals_m.items()}
    rms = float(np.sqrt(np.mean(np.square(list(residuals.values())))))
    twin = Twin(config, 0)
    steps = twin.walk.stances()
    risers, treads = fitted.ground.riser_mm, fitted.ground.tread_mm
    kind = "markers" if angle_format(recording) is None else "points on the segments"
    lines = [f"{arguments.file.name}: {fitted.duration_s:.2f} s, {kind} {rms:.1f} mm RMS with pinned soles"]
    lines += [f"  {name:<16} {value:6.1f} mm" for name, value in sorted(residuals.items(), key=lambda item: -item[1])]
    lines += ["steps: foot, mode, ground, touch-down s, toe-off s"]
    lines += [f"  {s.foot} {s.mode} {s.terrain:<6} {s.t_touch:8.2f} {s.t_off:8.2f}" for s in steps]
    lengths = {name.removesuffix("_m"): 1e3 * value for name, value in vars(fitted.person.segments).items()}
    lines += [f"lengths: {', '.join(f'{name} {value:.0f}' for name, value in lengths.items())} mm"]
    ground = "level ground" if not risers else f"risers {', '.join(f'{r:.0f}' for r in risers)} mm"
    ramp_deg = fitted.ground.ramp_deg
    if ramp_deg is not None:
        ground = f"ramp {'up' if ramp_deg > 0.0 else 'down'}, {abs(ramp_deg):.1f}°"
    lines += [f"terrain: {ground}" + "".join(f", tread {t:.0f} mm" for t in treads)]
    if arguments.output is not None:
        import cv2

        progress("image", 0.9)
        frames = [image for _, image in twin.film(2.0 / twin.duration_s, *_IMAGE_PX)]
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(arguments.output), np.ascontiguousarray(frames[len(frames) // 2][..., ::-1]))
        lines += [f"image: {arguments.output}"]
    data = {
        "duration_s": fitted.duration_s,
        "markers_mm": residuals,
        "rms_mm": rms,
        "lengths_mm": lengths,
        "risers_mm": list(risers),
        "treads_mm": list(treads),
        "ramp_deg": ramp_deg,
        "steps": [
            {"foot": s.foot, "mode": s.mode, "terrain": s.terrain,
             "touch_down_s": s.t_touch if np.isfinite(s.t_touch) else None,
             "toe_off_s": s.t_off if np.isfinite(s.t_off) else None}
            for s in steps
        ],
    }  # fmt: skip
    return Outcome(data=data, lines=lines)
