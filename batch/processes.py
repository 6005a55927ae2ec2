"""Worker processes: each computes with one thread, and none outlives this process."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process

# environment variables with the number of threads of the numerical libraries, which read them when they start
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def open_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Opens a pool of processes; jobs that have not started when it closes are dropped."""
    with _one_thread_each():  # until the pool closes, because processes may start with any job
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def run_beside(function: Callable[..., None], *arguments: object) -> Iterator[None]:
    """Runs a function in a process of its own beside the body of the `with` statement.

    At the end the function is asked to stop and awaited; if the body fails, its process is killed at once.

    Args:
        function: A function of a module; its first argument, a `multiprocessing.Event`, is set when it should stop.
        arguments: Its further arguments.
    """
    context = get_context("spawn")
    stop = context.Event()
    process = context.Process(target=_run_with_parent, args=(function, stop, *arguments), daemon=True)
    with _one_thread_each():
        process.start()
    try:
        yield
    except BaseException:
        process.kill()
        raise
    finally:
        stop.set()
        process.join()


def _run_with_parent(function: Callable[..., None], *arguments: object) -> None:
    """Runs a function in a worker process that ends with its parent."""
    _end_with_parent()
    function(*arguments)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Lets worker processes that start meanwhile compute with one thread each, unless the user sets otherwise."""
    missing = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(missing, "1"))
    try:
        yield
    finally:
        for name in missing:
            del os.environ[name]


def _end_with_parent() -> None:
    """Makes a worker process end with the one that started it in every case, and print nothing when it is stopped.

    A thread of the worker waits until the parent has ended for any reason, and then ends the worker at once. Ctrl-C
    ends the worker by the signal's default action, without a traceback.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = parent_process()
    if parent is None:  # this is the main process
        return
    sentinel = parent.sentinel  # becomes ready when the parent ends

    def watch() -> None:
        """Waits for the end of the parent, then ends this process without any cleaning up."""
        connection.wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
