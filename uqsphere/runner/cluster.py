"""Evaluations on a Dask cluster: the one file that knows `distributed`."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, Final, TypeVar

from uqsphere.errors import AccessError, UsageError

#: seconds to wait for the scheduler to answer
CONNECT: Final = 20.0
#: workers' deaths that the scheduler itself bears before it reports them; `uqsphere.runner.workers` counts on
DEATHS: Final = 3


T = TypeVar("T")


def as_executor(given: Any) -> Any:
    """What a user gave as an executor, with a Dask client dressed as one."""
    if given is not None and type(given).__module__.split(".")[0] == "distributed":
        return DaskExecutor(given)
    return given


class DaskExecutor:
    """A client of Dask with the futures of the standard library; work of workers that die is done by others."""

    kind = "dask"

    def __init__(self, client: Any, *, own: int | None = None) -> None:
        self.client = client
        # the same call twice is two evaluations
        self._pool = client.get_executor(pure=False)
        #: workers of a cluster that was started for this run, and is looked after here
        self.own = own
        self._told = False

    def look_after(self) -> None:
        """Bring workers of a cluster of our own back; tell once if there is none.

        A nanny restarts its worker, but gives up if that dies while it starts.

        Raises
        ------
        AccessError
            When the connection to the scheduler is lost.
        """
        if self.client.status not in ("running", "connecting"):
            raise AccessError(
                "the Dask scheduler was lost; what was evaluated is kept, and the same command goes on with it"
            )
        missing = not self.client.scheduler_info(n_workers=-1)["workers"]
        if self.own is not None:
            self.client.cluster.scale(self.own)
        elif missing and not self._told:
            print("the Dask cluster has no workers at the moment: waiting for some", file=sys.stderr, flush=True)
        self._told = missing

    @property
    def count(self) -> int:
        """Workers there are at the moment, at least one: they may still be on their way."""
        return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))

    def submit(self, function: Callable[..., T], /, *args: object) -> Future[T]:
        """Have `function(*args)` done by some worker of the cluster."""
        future: Future[T] = self._pool.submit(function, *args)
        return future


@contextlib.contextmanager
def dask_cluster(address: str, workers: int | None) -> Iterator[DaskExecutor]:
    """A running cluster by the address of its scheduler, or one of this machine's processes for `local`.

    Raises
    ------
    UsageError
        When the address is none, or Dask is not installed.
    AccessError
        When nobody answers there.
    """
    scheme, separator, place = address.partition("://")
    if address != "local" and not (separator and place and scheme in ("tcp", "tls", "ucx", "ws", "wss")):
        raise UsageError(f"--dask takes tcp://HOST:PORT of a scheduler, or local; found {address!r}")
    try:
        import dask
        import distributed
    except ImportError as error:
        raise UsageError('--dask needs Dask: pip install "uqsphere[dask]"') from error
    from uqsphere.runner.workers import processors

    make_cluster: Any = distributed.LocalCluster
    make_client: Any = distributed.Client
    own = (workers or processors()) if address == "local" else None
    with contextlib.ExitStack() as opened, _quiet():
        opened.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": DEATHS}))
        try:
            if address == "local":
                cluster = opened.enter_context(
                    make_cluster(
                        n_workers=own,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",  # None would take port 8787, on every interface
                        silence_logs=logging.CRITICAL,
                    )
                )
                client = opened.enter_context(make_client(cluster, timeout=CONNECT))
            else:
                client = opened.enter_context(make_client(address, timeout=CONNECT))
        except (OSError, TimeoutError) as error:
            raise AccessError(f"no Dask scheduler answers at {address}: {error}") from error
        yield DaskExecutor(client, own=own)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Dask's own log of what it survives is not the user's business."""
    loggers = [
        logging.getLogger(name)
        for name in ("distributed", "distributed.nanny", "distributed.scheduler", "distributed.client")
    ]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
