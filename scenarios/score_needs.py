"""What scores need: from a score to its estimator, the topics that this reads, and the sensors that give them.

`run`, `score`, campaigns, placement and gate simulate and compute no more than that. A sensor that is left out changes
no byte of the others, so the scores are the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from stridetwin.estimators import registry
from stridetwin.estimators.base import Options
from stridetwin.outputs.feeding import EstimatorClass, runnable_on
from stridetwin.outputs.pose_feed import default_odometry
from stridetwin.outputs.registry import kind_of
from stridetwin.scenarios import exo_geometry
from stridetwin.scenarios.scenario_file import Scenario
from stridetwin.sim.config import TwinConfig
from stridetwin.sim.sensors.standard_rig import SensorRig, sensor_rig
from stridetwin.streams.errors import ConfigError, StrideTwinError


def estimators_of(names: Iterable[str], source: str = "only") -> frozenset[str]:
    """The estimators behind some names, and the odometry that feeds those that take poses.

    Args:
        names: Estimators (`foot_ins`), their parts (`foot_ins_l`) or scores (`foot_ins_l.end_error_m`).
        source: Where the names are written, for the message.

    Raises:
        ConfigError: A name is that of no installed estimator.
    """
    estimators: set[str] = set()
    for name in names:
        output = name.partition(".")[0]  # an estimator, or one with its part, such as `foot_ins_l`
        without_part = output.rpartition("_")[0]
        estimator = next((n for n in (output, without_part) if n in registry.names()), None)
        if estimator is None:
            raise ConfigError(source, "estimator", name, ", ".join(registry.names()))
        estimators.add(estimator)
        if kind_of(registry.estimator(estimator).declaration).takes_poses:
            estimators.add(default_odometry().declaration.name)
    return frozenset(estimators)


def sensors_of(estimators: Iterable[str], config: TwinConfig) -> tuple[str, ...]:
    """Groups of a walk's sensors that some estimators read, in the walk's order; optional streams included.

    Raises:
        StrideTwinError: An estimator cannot run with the walk's sensors; the message names it.
    """
    worn = sensor_rig(config)  # the sensors of this walk, by topic
    topics = {topic for name in estimators for topic in _topics(registry.estimator(name), config, worn)}
    # a sensor counts if its own topic is read, or that of its depth images
    groups = {
        sensor.group
        for topic, sensor in worn.sensors.items()
        if topic in topics or getattr(sensor.calibration, "depth_topic", "") in topics
    }
    return tuple(group for group in config.sensors if group in groups)


def with_sensors_for(scenario: Scenario, estimators: Collection[str]) -> Scenario:
    """The scenario with only those sensors that some estimators read.

    Raises:
        StrideTwinError: An estimator cannot run with the walk's sensors; the message names it.
    """
    return replace(scenario, config=replace(scenario.config, sensors=sensors_of(estimators, scenario.config)))


def _topics(estimator_class: EstimatorClass, config: TwinConfig, worn: SensorRig) -> set[str]:
    """Topics that an estimator reads from the sensors of a walk, optional ones included.

    Args:
        estimator_class: The estimator, with the first of its methods.
        config: Configuration of the walk.
        worn: Its sensors.

    Raises:
        StrideTwinError: The estimator cannot run with these sensors.
    """
    from stridetwin.sim.wearer.body import fit_wearer  # imports the simulator, which `score` does without

    declaration = estimator_class.declaration
    # a user's exoskeleton has no D-H table, so that its recording has no geometry
    has_links = config.exo is not None and config.exo.user_exo is None
    metadata = exo_geometry.geometry_metadata(fit_wearer(config.person), worn.rig, seed=0) if has_links else {}
    options = Options(method=declaration.methods[0], metadata=metadata, source=config.name)
    available_topics = worn.sensors.keys() | {c.depth_topic for c in worn.rig.cameras.values()}
    instances = runnable_on(estimator_class, options, worn.rig, available_topics)
    topics = {stream.topic for instance in instances for stream in instance.streams}
    if not topics:
        raise StrideTwinError(
            f"{config.name}: {declaration.name} cannot run: expected a walk with {declaration.needs or 'other sensors'}"
        )
    return topics
