"""Evaluations on a Dask cluster: the one file that knows `distributed`."""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Iterator
from typing import Any, Final

from uqsphere.errors import AccessError, UsageError
from uqsphere.runner.workers import LocalWorkers, Pool, Workers, processors

#: seconds to wait for the scheduler to answer
CONNECT: Final = 20.0
#: workers' deaths that the scheduler itself bears before it reports them; `uqsphere.runner.workers` counts on
DEATHS: Final = 3


class DaskWorkers(Pool):
    """A client of Dask; work of workers that die is done by others."""

    def __init__(self, client: Any, *, own: int | None = None) -> None:
        super().__init__(client.get_executor(pure=False), "dask")  # the same call twice is two evaluations
        self.client = client
        #: workers of a cluster that was started for this run, and is looked after here
        self.own = own
        self._told = False

    @property
    def count(self) -> int:
        """Workers there are at the moment, at least one: they may still be on their way."""
        return max(1, len(self.client.scheduler_info(n_workers=-1)["workers"]))

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


def workers_of(executor: Any) -> Workers | None:
    """What a user gave as an executor, as workers."""
    if executor is None or isinstance(executor, (Pool, LocalWorkers)):
        return executor
    return DaskWorkers(executor) if type(executor).__module__.split(".")[0] == "distributed" else Pool(executor)


@contextlib.contextmanager
def dask_cluster(address: str, workers: int | None) -> Iterator[DaskWorkers]:
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
    kit: Any = distributed
    loggers = [logging.getLogger(f"distributed{part}") for part in ("", ".nanny", ".scheduler", ".client")]
    own = (workers or processors()) if address == "local" else None
    with contextlib.ExitStack() as opened:
        for logger in loggers:  # Dask's own log of what it survives is not the user's business
            opened.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        opened.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": DEATHS}))
        where: Any = address
        try:
            if own is not None:
                # no dashboard_address would take port 8787, on every interface
                where = opened.enter_context(
                    kit.LocalCluster(n_workers=own, threads_per_worker=1, processes=True, host="127.0.0.1",
                                             dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL)
                )  # fmt: skip
            client = opened.enter_context(kit.Client(where, timeout=CONNECT))
        except (OSError, TimeoutError) as error:
            raise AccessError(f"no Dask scheduler answers at {address}: {error}") from error
        yield DaskWorkers(client, own=own)
