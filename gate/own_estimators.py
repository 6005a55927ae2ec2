"""User-supplied estimators: a Python class, a program that writes a trajectory, or a trajectory.

A class is constructed with the recording's rig (`streams.rig.Rig`). Its `update(sample)` takes one sample in time
order and returns None, or a `streams.trajectory.Pose` with increasing stamps, or an object whose `pose` is one. The
class may declare `topics`, the topics that it reads (default: all but the truth's), and `frame`, whose pose it
estimates.
"""

from __future__ import annotations

import importlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Protocol, TypeGuard, cast

from stridetwin.estimators.base import PATH, Declaration, Options, PathEstimate, Stream
from stridetwin.outputs.feeding import EstimatorClass
from stridetwin.outputs.path.estimate_file import read_estimate
from stridetwin.outputs.path.run import pose_of
from stridetwin.streams.errors import ConfigError, StrideTwinError, was_interrupted
from stridetwin.streams.formats.trajectory_options import NO_OPTIONS, TrajectoryOptions
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.rig import Rig, kinds_of_streams
from stridetwin.streams.samples import Sample
from stridetwin.streams.trajectory import Pose, Trajectory, trajectory_of
from stridetwin.streams.validation import suggest

TRUTH_PREFIX = "/truth/"
_TAIL = 600  # characters of a program's last output, or of a class's exception
_HOME = Path(__file__).resolve().parents[1]  # folder of this project's code
_STANDARD_LIBRARY = sysconfig.get_path("stdlib")  # folder of Python's own modules
_WATCH = 'cat > /dev/null; kill -s KILL -- "-$1"; rm -rf -- "$2"'
"""Command of a shell whose stdin closes when this process ends for any reason.

Then it kills the process group $1 and removes the folder $2.
"""


class PathEstimator(Protocol):
    """The class of a user's estimator; it may also have `topics` and `frame`, see this module."""

    def __init__(self, rig: Rig) -> None:
        """Takes the recording's rig."""

    def update(self, sample: Sample) -> object:
        """Takes one sample in time order; returns None, a `Pose`, or an object whose `pose` is one."""


@dataclass(frozen=True, kw_only=True)
class OwnEstimator(ABC):
    """An estimator that gives a path for a recording.

    Attributes:
        name: Name in the scores.
        frame: Frame whose path it estimates.
    """

    name: str
    frame: str

    @abstractmethod
    def path(self, recording: Recording) -> PathEstimate:
        """The path of the frame that the estimator gives for a recording."""


@dataclass(frozen=True, kw_only=True)
class TumFile(OwnEstimator):
    """An existing path.

    Attributes:
        file: Its trajectory.
        options: How it is read.
        alignment: Of the scores, see `alignment.align`; with `se3` its world may have any attitude.
    """

    file: Path
    options: TrajectoryOptions = NO_OPTIONS
    alignment: str = "start"

    def path(self, recording: Recording) -> PathEstimate:
        """The path in the file; the recording helps to recognise its form."""
        path = read_estimate(self.file, recording, self.frame, self.options, self.alignment)
        return PathEstimate(name=self.name, frame=self.frame, path=path)


@dataclass(frozen=True, kw_only=True)
class PythonClass(OwnEstimator):
    """A class with `update(sample)`; it may declare its frame itself.

    Attributes:
        place: `module:Class`, installed or relative to the working folder.
    """

    place: str

    def load(self) -> type[PathEstimator]:
        """Imports the class at `place`.

        Raises:
            StrideTwinError: There is no such class, it has no `update`, or its `frame`, if it has one, is no text.
        """
        estimator_class = load_class(self.place, f"--estimator {self.name}")
        frame = getattr(estimator_class, "frame", None)
        if not (frame is None or isinstance(frame, str)):
            raise ConfigError(f"--estimator {self.name}: {self.place}", "frame", frame, "text, such as foot_l/imu")
        return estimator_class

    @property
    def own_frame(self) -> str:
        """The frame that the class declares, else `frame`."""
        declared_frame: str | None = getattr(self.load(), "frame", None)
        return str(declared_frame or self.frame).lstrip("/")

    def path(self, recording: Recording) -> PathEstimate:
        """The path that the class estimates from a recording: built with its rig and fed sample by sample.

        Raises:
            StrideTwinError: The class cannot be loaded (`load`), reads invalid topics or gives invalid poses
                (`estimate_path`), raises an exception, or calls `sys.exit`.
        """
        estimator_class = self.load()
        with _catch_user_errors(self.place):
            return PathEstimate(
                name=self.name, frame=self.own_frame, path=estimate_path(estimator_class(recording.rig), recording)
            )


@dataclass(frozen=True, kw_only=True)
class Program(OwnEstimator):
    """A program that reads a recording and writes a TUM trajectory.

    Attributes:
        command: With `{recording}` and `{output}`; split as a shell does, but run without one.
        timeout_s: Time after which it is stopped.
        options: How the trajectory is read.
        alignment: Of the scores, see `alignment.align`; with `se3` the trajectory's world may have any attitude.
    """

    command: str
    timeout_s: float
    options: TrajectoryOptions = NO_OPTIONS
    alignment: str = "start"

    def arguments(self) -> list[str]:
        """The program and its arguments, with `{recording}` and `{output}` still in them.

        Raises:
            StrideTwinError: The program is not installed, or `{recording}` or `{output}` is missing.
        """
        try:
            arguments = shlex.split(self.command)
        except ValueError as error:
            raise StrideTwinError(f"--program {self.name}: {self.command!r}: {error}") from None
        if not all(any(place in word for word in arguments) for place in ("{recording}", "{output}")):
            raise StrideTwinError(
                f"--program {self.name}: invalid {self.command!r}: expected COMMAND {{recording}} {{output}}"
            )
        if shutil.which(arguments[0]) is None:
            raise StrideTwinError(f"--program {self.name}: invalid {arguments[0]!r}: expected an installed program")
        return arguments

    def path(self, recording: Recording) -> PathEstimate:
        """The path that the program writes.

        Raises:
            StrideTwinError: It fails, takes too long or writes no trajectory; the message has the end of its output.
        """
        with tempfile.TemporaryDirectory(prefix="stridetwin-") as folder:
            output, log = Path(folder) / "estimate.txt", Path(folder) / "stderr.txt"
            placeholders = {"{recording}": str(recording.path.absolute()), "{output}": str(output)}
            arguments = self.arguments()
            for placeholder, file_name in placeholders.items():
                arguments = [argument.replace(placeholder, file_name) for argument in arguments]
            with log.open("wb") as file:
                code = _run_program(arguments, self.timeout_s, file.fileno(), Path(folder))
            # the end of what it has printed on stderr, on one line
            last = " ".join(log.read_text(encoding="utf-8", errors="replace").split())[-_TAIL:]
            printed = f"; stderr: {last}" if last else "; nothing on stderr"
            if code is None:  # it took too long
                raise StrideTwinError(f"{arguments[0]}: stopped after {self.timeout_s:g} s{printed}")
            if code != 0:
                raise StrideTwinError(f"{arguments[0]}: exit code {code}{printed}")
            if not output.is_file():
                raise StrideTwinError(f"{arguments[0]}: has not written {{output}}{printed}")
            try:
                path = read_estimate(output, recording, self.frame, self.options, self.alignment, "{output}")
            except StrideTwinError as error:  # without the temporary path, which tells the user nothing
                raise StrideTwinError(str(error).replace(str(output), "{output}")) from None
        return PathEstimate(name=self.name, frame=self.frame, path=path)


def load_class(place: str, option: str) -> type[PathEstimator]:
    """A class with a method `update`, installed or in the working folder.

    Args:
        place: `module:Class`.
        option: What asks for it, for errors.

    Raises:
        StrideTwinError: There is no such class, it has no `update`, or its import raised an exception.
    """
    module, colon, attribute = place.partition(":")
    if not (module and colon and attribute):
        raise StrideTwinError(f"{option}: invalid {place!r}: expected module:Class")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # installed modules take precedence over the working folder
    with _catch_user_errors(f"{option}: {place}: cannot be imported"):
        loaded: object = importlib.import_module(module)
        for part in attribute.split("."):  # `Outer.Inner` is a class within a class
            loaded = getattr(loaded, part)
        if _is_estimator_class(loaded):
            return loaded
    raise StrideTwinError(f"{option}: {place} is not a class with an update(sample) method")


def _is_estimator_class(loaded: object) -> TypeGuard[type[PathEstimator]]:
    """Whether what was loaded is a class with a method `update`."""
    return isinstance(loaded, type) and callable(getattr(loaded, "update", None))


def load_estimator(name: str, place: str, option: str) -> EstimatorClass:
    """A user's class as an estimator for `live`.

    A class with a `declaration` is an estimator already and is returned as it is. Any other class is put into a
    subclass of `_UserPath`, an estimator of paths that passes the samples on to it.

    Args:
        name: Its name in messages and files.
        place: `module:Class`.
        option: What asks for it, for errors.

    Raises:
        StrideTwinError: There is no such class, or it has no `update`.
    """
    user_class = load_class(place, option)
    if isinstance(getattr(user_class, "declaration", None), Declaration):
        return cast("EstimatorClass", user_class)
    # the attributes of the new subclass, which has the name of the user's class
    body = {"declaration": Declaration(name=name, kind=PATH), "user_class": user_class, "place": place}
    return cast("EstimatorClass", type(user_class.__name__, (_UserPath,), body))


class _UserPath:
    """An estimator of paths around a user's class, which is built with the rig alone and has `update(sample)`.

    Attributes:
        declaration: With the user's name for it.
        user_class: The class; its `topics` are those that it takes, all of the rig without them.
        place: Where it is, for errors.
    """

    declaration: ClassVar[Declaration]
    user_class: ClassVar[type[PathEstimator]]
    place: ClassVar[str]

    def __init__(self, rig: Rig, *, options: Options | None = None, parameters: object = None) -> None:
        """Builds the user's class with the rig; it takes neither options nor parameters, so these are not used."""
        with _catch_user_errors(self.place):
            self._inner = self.user_class(rig)

    @classmethod
    def streams(cls, rig: Rig, options: Options) -> tuple[Stream, ...]:
        """The streams of the class's topics.

        Raises:
            StrideTwinError: A topic is not that of a sensor in the rig; the message has the nearest one.
        """
        kinds = kinds_of_streams(rig)
        topics = getattr(cls.user_class, "topics", None)
        for topic in topics or ():
            if topic not in kinds:
                known = suggest(topic, kinds) or "a rig with sensors"
                raise StrideTwinError(f"{cls.user_class.__name__}.topics: invalid {topic!r}: expected {known}")
        chosen = list(kinds) if topics is None else topics  # all sensors of the rig, if the class declares none
        return tuple(Stream(role=topic, topic=topic, kind=kinds[topic]) for topic in chosen)

    def update(self, sample: Sample) -> Pose | None:
        """The pose that the class returns for a sample; None without one."""
        with _catch_user_errors(self.place):
            return pose_of(self._inner.update(sample), self.user_class.__name__)


def estimate_path(estimator: PathEstimator, recording: Recording) -> Trajectory:
    """The path that an estimator computes from the samples of a recording.

    Args:
        estimator: An object whose `update(sample)` returns None, a `Pose`, or an object whose `pose` is one.
        recording: Its truth is withheld from the estimator.

    Raises:
        StrideTwinError: It is a class, reads a topic that is not there or gives no pose, or its stamps do not increase.
    """
    if isinstance(estimator, type):
        name = estimator.__name__
        raise StrideTwinError(f"invalid class {name}: expected an object of it, such as {name}(recording.rig)")
    name = type(estimator).__name__
    poses: list[Pose] = []
    sensors = [topic for topic in recording.topics if not topic.startswith(TRUTH_PREFIX)]
    topics = getattr(estimator, "topics", None)  # an estimator without them gets all sensors
    if topics is None:
        topics = sensors
    for topic in topics:
        if topic.startswith(TRUTH_PREFIX):
            raise StrideTwinError(f"{name}.topics: invalid {topic}: expected topics of sensors")
        if topic not in sensors:
            raise StrideTwinError(f"{name}.topics: invalid {topic!r}: expected {suggest(topic, sensors)}")
    for sample in recording.samples(topics):
        if (pose := pose_of(estimator.update(sample), name)) is None:
            continue
        if poses and pose.t_ns <= poses[-1].t_ns:
            later = f"more than {poses[-1].t_ns}, the stamp of the previous pose"
            raise StrideTwinError(f"{name}.update: t_ns: invalid {pose.t_ns}: expected {later}")
        poses.append(pose)
    if not poses:
        raise StrideTwinError(f"{name}.update has returned no estimate")
    try:
        return trajectory_of(poses)
    except StrideTwinError as error:
        raise StrideTwinError(f"{name}.update: {error}") from None


@contextmanager
def _catch_user_errors(where: str) -> Iterator[None]:
    """Runs code of the user: printed output goes to stderr, and any exit but Ctrl-C becomes a StrideTwinError.

    Args:
        where: What runs, for the beginning of the message.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except KeyboardInterrupt:
        raise
    except StrideTwinError as error:  # without a location it arose in this project: its message says enough
        if not (location := _error_location(error)):
            raise
        raise StrideTwinError(f"{where}: {error}{location}") from error
    except BaseException as error:
        if was_interrupted(error):  # Ctrl-C in compiled code arrives as another exception
            raise KeyboardInterrupt from error
        # one line of bounded length; characters that are not UTF-8 are escaped
        exception_text = " ".join("".join(traceback.format_exception_only(error)).split())[:_TAIL]
        text = f"{where}: {exception_text}{_error_location(error)}"
        raise StrideTwinError(text.encode("utf-8", "backslashreplace").decode()) from error


def _error_location(error: BaseException) -> str:
    """File, line and function of the user's code in which an exception arose, such as ` (mine.py:12, in update)`.

    The user's code is the innermost that belongs neither to this project nor to an installed package.
    """
    # calls in the user's code, the outermost first; `<` begins the file name of code without a file
    user_frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith(("<", _STANDARD_LIBRARY))
        and "site-packages" not in frame.filename
        and not Path(frame.filename).resolve().is_relative_to(_HOME)
    ]
    if not user_frames:
        return ""
    file, working_folder = Path(user_frames[-1].filename), Path.cwd()
    shown_path = file.relative_to(working_folder) if file.is_relative_to(working_folder) else file
    return f" ({shown_path}:{user_frames[-1].lineno}, in {user_frames[-1].name})"


def _run_program(arguments: list[str], timeout_s: float, stderr: int, folder: Path) -> int | None:
    """Runs a program and returns its exit code; None if it took too long and was stopped with all its child processes.

    If this process is killed, the program ends as well and its folder is removed.

    Args:
        arguments: The program and its arguments.
        timeout_s: Time limit, s.
        stderr: File descriptor that receives what the program prints on stderr.
        folder: The program's temporary folder.
    """
    process = subprocess.Popen(
        arguments, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True
    )
    try:
        with _watch_process(process, folder):
            return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        return None
    finally:
        if process.poll() is None:  # still running: the program leads a process group, which is killed as a whole
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def _watch_process(process: subprocess.Popen[bytes], folder: Path) -> Iterator[None]:
    """Starts a shell that kills a program and removes its folder as soon as this process ends for any reason.

    The shell runs in a session of its own, so that signals to this process group do not reach it.
    """
    command = ["sh", "-c", _WATCH, "sh", str(process.pid), str(folder)]
    watch = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        yield
    finally:
        watch.kill()  # before its stdin closes, at which it would kill the program
        watch.communicate()
