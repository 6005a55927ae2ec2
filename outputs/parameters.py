"""Parameters of estimators by name: `--set foot_ins.lever_arm_m=0.09`, and the keys of a study's methods.

A parameter is a field of the dataclass or named tuple that the constructor's `parameters` has as its type hint; one of
an inner group is `GROUP.NAME`. The values given replace those of the estimator's method, and all others stay.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass, replace
from types import MappingProxyType
from typing import Any, Never, TypedDict, get_args, get_type_hints

import yaml

from stridetwin.estimators import registry
from stridetwin.estimators.base import Estimator
from stridetwin.outputs.feeding import Instance
from stridetwin.streams.errors import ConfigError, FieldLocation, StrideTwinError
from stridetwin.streams.validation import suggest, validate

ParameterValues = Mapping[str, Mapping[str, object]]
"""Values by the name of the estimator and of its parameter, as JSON can hold them."""
OPTION = "--set"
_IN_USE: ContextVar[ParameterValues] = ContextVar("_IN_USE", default=MappingProxyType({}))
_END = "\n...\n"
"""What YAML writes after a value that stands alone."""


def parse_parameters(texts: Iterable[str]) -> dict[str, dict[str, object]]:
    """The values of the option `--set`, checked against the classes of the estimators.

    Args:
        texts: Each is `ESTIMATOR.PARAMETER=VALUE`, the value as in a YAML file. Of a parameter given twice, the last
            one counts.

    Returns:
        See `ParameterValues`; empty without texts.

    Raises:
        ConfigError: No such estimator or parameter, or an invalid value; the message has the valid ones, and the
            nearest name.
    """
    values: dict[str, dict[str, object]] = {}
    at = FieldLocation(source=OPTION)
    for text in texts:
        name, equals, value = text.partition("=")
        estimator, dot, parameter = name.strip().partition(".")
        if not (equals and dot and estimator and parameter and value.strip()):
            raise at.error(text, "ESTIMATOR.PARAMETER=VALUE, such as foot_ins.lever_arm_m=0.09")
        if estimator not in registry.names():
            raise at.key(name.strip()).error(estimator, suggest(estimator, registry.names()))
        values.setdefault(estimator, {})[parameter] = _read_value(value, at.key(name.strip()))
    for estimator, changes in values.items():
        estimator_class = registry.estimator(estimator)
        change_parameters(estimator_class, estimator_class.declaration.methods[0], changes, at.key(estimator))
    return values


def to_texts(values: ParameterValues) -> list[str]:
    """The texts `ESTIMATOR.PARAMETER=VALUE` that `parse_parameters` reads as these values."""
    texts = []
    for estimator, changes in values.items():
        for name, value in changes.items():
            # in one line; `_END` is the end mark that YAML adds after a number or word
            value_text = yaml.safe_dump(value, default_flow_style=True).removesuffix(_END).strip()
            texts.append(f"{estimator}.{name}={value_text}")
    return texts


def _read_value(text: str, at: FieldLocation) -> Any:
    """The value of a text: a number, a word, true or false, or a list of these."""
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise at.error(text, "a number, a word, true or false, or a list of these") from None
    if isinstance(value, str):  # YAML 1.1 takes 1e-3 for a word
        try:
            return float(value)
        except ValueError:  # a word indeed
            return value
    return value


def check_used(values: ParameterValues, names: Iterable[str]) -> None:
    """Refuses values of an estimator that does not run, because they would have no effect.

    Args:
        values: The values of `--set`, by estimator.
        names: Names of the estimators that run.

    Raises:
        ConfigError: One of the values is of another estimator; the message lists `names`.
    """
    valid = sorted(names)
    if unused := next((estimator for estimator in values if estimator not in valid), None):
        raise ConfigError(OPTION, unused, unused, f"an estimator that runs here: {', '.join(valid) or 'none'}")


def with_parameters(instance: Instance, values: ParameterValues) -> Instance:
    """An instance whose parameters are those of its method with the given values in place of some.

    The instance comes back unchanged if no value is for its estimator.

    Raises:
        ConfigError: No such parameter, or an invalid value.
    """
    name = instance.declaration.name
    if not (changes := values.get(name)):
        return instance
    at = FieldLocation(source=OPTION, path=name)
    changed = change_parameters(instance.estimator_class, instance.options.method, changes, at)
    return replace(instance, parameters=changed)


@contextmanager
def use_parameters(values: ParameterValues) -> Iterator[None]:
    """Context manager: inside it, `parameter_keywords` gives these values; for experiments, which build estimators."""
    token = _IN_USE.set(values)  # restores the values of an outer block in the end
    try:
        yield
    finally:
        _IN_USE.reset(token)


class ParameterKeywords(TypedDict, total=False):
    """Arguments of an estimator's constructor: `parameters`, of the class that it declares, or none."""

    parameters: Any


def parameter_keywords(estimator_class: type[Estimator[Never, object]], method: str) -> ParameterKeywords:
    """Arguments of an estimator's constructor for the values in use (`use_parameters`): `parameters`, or none.

    Args:
        estimator_class: The estimator.
        method: One of its methods.
    """
    name = estimator_class.declaration.name
    if not (changes := _IN_USE.get().get(name)):
        return {}
    at = FieldLocation(source=OPTION, path=name)
    return {"parameters": change_parameters(estimator_class, method, changes, at)}


def change_parameters(
    estimator_class: type[Estimator[Never, object]], method: str, values: Mapping[str, object], at: FieldLocation
) -> object:
    """The parameters that an estimator has with a method, with some values replaced.

    Args:
        estimator_class: The estimator.
        method: One of its methods.
        values: By name; of an inner group as `GROUP.NAME`.
        at: Where they are given, for errors.

    Raises:
        ConfigError: No such parameter, or an invalid value, or the estimator has no parameters; the message has the
            valid ones.
    """
    hint = get_type_hints(estimator_class.__init__).get("parameters")
    # the classes of parameters in the hint, which may be a union with None
    kinds = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and _fields(kind)]
    if not kinds:
        name = estimator_class.declaration.name
        raise at.error(dict(values), f"no parameters, as the constructor of {name} declares no class of them")
    # an estimator whose defaults depend on the method has the function `default_parameters`
    default_parameters = getattr(estimator_class, "default_parameters", None)
    group = kinds[0]() if default_parameters is None else default_parameters(method)
    for name, value in values.items():
        group = _replace_value(group, name.split("."), value, at.key(name))
    return group


def _fields(group: Any) -> list[str]:
    """Names of the fields of a dataclass or a named tuple, or of an object of it; none of anything else."""
    return [f.name for f in fields(group)] if is_dataclass(group) else list(getattr(group, "_fields", ()))


def _replace_value(group: Any, keys: list[str], value: Any, at: FieldLocation) -> Any:
    """A copy of a group of parameters with one value replaced; the keys lead to it through inner groups.

    Args:
        group: A dataclass or named tuple.
        keys: Names of the inner groups, then of the parameter.
        value: The new value, as a file has it.
        at: Where it is given, for errors.

    Raises:
        ConfigError: No such parameter, or an invalid value.
    """
    name, *inner_keys = keys
    if name not in _fields(group):  # a plain value, such as a number, has no fields at all: then nothing is suggested
        raise at.error(name, suggest(name, _fields(group)) or "no key below a value")
    try:
        if inner_keys:
            new = _replace_value(getattr(group, name), inner_keys, value, at)
        else:
            new = validate(get_type_hints(type(group))[name], value, at.source, at=at.path)
        # a named tuple has `_replace`, a dataclass needs the function `replace`
        return group._replace(**{name: new}) if hasattr(group, "_replace") else replace(group, **{name: new})
    except ConfigError as error:  # every error is located at the full name of the parameter
        raise at.error(error.value, error.valid) from error
    except (StrideTwinError, ValueError, TypeError, RuntimeError) as error:  # refused by the class of the group itself
        raise at.error(value, f"what {type(group).__name__} accepts ({error})") from error
