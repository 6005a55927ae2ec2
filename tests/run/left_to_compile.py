"""What a process compiles on a recording though an estimator has been compiled before: a program, and what starts it.

The program imports everything once; each estimator is then run in a copy of it (`fork`) that has compiled nothing.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numba
from numba.core.dispatcher import Dispatcher

from stridetwin.estimators import registry
from stridetwin.outputs.feeding import runnable_instances
from stridetwin.outputs.registry import kind_of
from stridetwin.run.compile_ahead import compile_estimator, feed_synthetic_samples
from stridetwin.run.live_chain import Chain, Request
from stridetwin.run.warm_up import synthetic_rig
from stridetwin.streams.live.messages import MessageDecoder, to_messages
from stridetwin.streams.recording.reader import Recording
from stridetwin.streams.samples import Sample


def find_left_to_compile(cases: Iterable[tuple[str, Path, str]]) -> list[list[str]]:
    """Kernels left to compile in each case: `live` or `offline`, a recording, and the name of an estimator."""
    words = json.dumps([[how, str(recording), name] for how, recording, name in cases])
    done = subprocess.run([sys.executable, __file__, words], stdout=subprocess.PIPE, text=True, check=True)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert all(kernels > 0 for kernels, _ in found)
    return [left for _, left in found]


def _compile_live(recording: Recording, name: str) -> None:
    feed_synthetic_samples(Chain(Request(estimator=name), synthetic_rig(), recording.metadata))


def _run_live(recording: Recording, name: str) -> None:
    chain = Chain(Request(estimator=name), recording.rig, recording.metadata)
    for sample in _read_messages(recording, list(chain.takes)):
        for _ in chain.update(sample):
            pass


def _read_messages(recording: Recording, topics: list[str]) -> Iterator[Sample | None]:
    decoders: dict[str, MessageDecoder] = {}
    for message in to_messages(recording, topics):
        decoder = decoders.setdefault(message.topic, MessageDecoder(message.topic, message.typename))
        yield decoder.decode(message)


def _compile_offline(recording: Recording, name: str) -> None:
    compile_estimator(name, recording.metadata)


def _run_offline(recording: Recording, name: str) -> None:
    estimator_class = registry.estimator(name)
    for instance in runnable_instances(estimator_class, recording):
        kind_of(estimator_class.declaration).run(instance, recording)


_WAYS: dict[str, tuple[Callable[[Recording, str], None], Callable[[Recording, str], None]]] = {
    "live": (_compile_live, _run_live),
    "offline": (_compile_offline, _run_offline),
}


def _count_signatures() -> dict[str, int]:
    # by its type, because a weak reference would pretend to be what it refers to
    kernels = [d for d in gc.get_objects() if issubclass(type(d), Dispatcher)]
    return {f"{d.py_func.__module__}.{d.py_func.__name__}": len(d.signatures) for d in kernels}


def _print_left(how: str, recording: Recording, name: str) -> None:
    """Prints the number of compiled signatures, and the kernels of which some were compiled on the recording."""
    compile_ahead, run = _WAYS[how]
    compile_ahead(recording, name)
    before = _count_signatures()
    run(recording, name)
    after = _count_signatures()
    left = sorted(kernel for kernel, n in after.items() if n != before.get(kernel, 0))
    print(json.dumps([sum(after.values()), left]), flush=True)


def _main() -> int:
    numba.njit(lambda x: x)(0)  # loads Numba's own declarations
    for how, path, name in json.loads(sys.argv[1]):
        registry.estimator(name)
        if (pid := os.fork()) == 0:
            _print_left(how, Recording(path), name)
            return 0
        if os.waitpid(pid, 0)[1]:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
