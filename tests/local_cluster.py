"""A Dask cluster on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def open_cluster() -> Iterator[Any]:
    """Context manager: a cluster of two processes, which may be killed; skips the test without `distributed`.

    Its processes, and those that take the place of killed ones, are forks of one that has imported `distributed`, which
    takes seconds. A module that imports it at the top costs them in each process of the tests.
    """
    pytest.importorskip("distributed")
    import dask
    import distributed

    with (
        dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster,
    ):
        yield cluster
