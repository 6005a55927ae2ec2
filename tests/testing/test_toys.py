"""Each check catches an estimator that breaks its rule, and no other check does."""

from __future__ import annotations

from dataclasses import replace

import pytest
import toys

from stridetwin.estimators.base import Options
from stridetwin.streams.recording.reader import Recording, RecordingWriter
from stridetwin.testing import check_conformance
from stridetwin.testing.cases import CHECKS, FAILED, PASSED, SKIPPED
from stridetwin.testing.walk import find_walk

PAIRS = [(check, toy) for check, broken in toys.BROKEN.items() for toy in broken]
EVERY = 4


@pytest.fixture(scope="module")
def slow_walk(tmp_path_factory):
    """The suite's walk with every fourth sample, on which forty estimators are checked in less time."""
    walk = find_walk(toys.Camera, Options(), None).recording
    topics = ["/foot_l/imu", "/foot_r/imu", "/head/depth", "/truth/foot_l/imu/odometry"]
    imus = {topic: replace(imu, rate_hz=imu.rate_hz / EVERY) for topic, imu in walk.rig.imus.items()}
    cameras = {topic: replace(camera, rate_hz=camera.rate_hz / EVERY) for topic, camera in walk.rig.cameras.items()}
    path, counts = tmp_path_factory.mktemp("toys") / "slow.mcap", dict.fromkeys(topics, 0)
    with RecordingWriter(path, replace(walk.rig, imus=imus, cameras=cameras)) as writer:
        for sample in walk.samples(topics):
            if counts[sample.topic] % EVERY == 0:
                writer.write(sample)
            counts[sample.topic] += 1
    assert Recording(path).topics.keys() == set(topics)
    return path


def outcomes(estimator_class, recording=None):
    """Names of the checks by outcome."""
    verdicts = check_conformance(estimator_class, recording=recording)
    return {outcome: [v.check for v in verdicts if v.outcome == outcome] for outcome in (PASSED, FAILED, SKIPPED)}


def depends_on(name, required):
    """Whether a check needs another one, directly or not."""
    while name and name != required:
        name = CHECKS[name].requires
    return bool(name)


def test_every_check_has_a_toy_that_it_catches():
    assert list(toys.BROKEN) == list(CHECKS)


@pytest.mark.parametrize("is_slow", [False, True])
@pytest.mark.parametrize("toy", [toys.Sound, toys.Camera])
def test_a_sound_estimator_passes(slow_walk, toy, is_slow):
    found = outcomes(toy, slow_walk if is_slow else None)
    assert found[FAILED] == []
    assert set(found[SKIPPED]) <= {"follow", "fault_saturation", "fault_blank_images"}


@pytest.mark.parametrize(("check", "toy"), PAIRS, ids=[toy.__name__ for _, toy in PAIRS])
def test_a_broken_estimator_is_caught_by_exactly_one_check(slow_walk, check, toy):
    found = outcomes(toy, slow_walk)
    assert found[FAILED] == [check]
    needs_it = {name for name in CHECKS if name != check and depends_on(name, check)}
    assert needs_it <= set(found[SKIPPED])
    assert set(found[SKIPPED]) - needs_it <= {"follow", "fault_saturation", "fault_blank_images"}
