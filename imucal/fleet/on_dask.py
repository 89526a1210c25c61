"""Do the logs of a fleet on an existing Dask cluster; work on this machine needs no Dask.

Each log is done in a new interpreter on a worker, because workers may not fork. Its row comes back to this
process, so a lost scheduler costs only the logs in progress.
"""

import ipaddress
import logging
import math
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from imucal._version import __version__
from imucal.errors import EngineError, Fix
from imucal.fleet.engines import Done, child_process, row_of
from imucal.fleet.logs import LogTask
from imucal.fleet.plan import FleetSettings
from imucal.fleet.store import LogRow
from imucal.fleet.work import first_row

if TYPE_CHECKING:
    from distributed import Client, Future

#: Time limit of a connection in s.
CONNECT_S = 20.0
#: Time limit in s of waiting for a first worker.
WORKERS_S = 120.0
#: Time limit of closing the connection in s.
CLOSE_S = 10.0
#: A longer silence, in s, means that the scheduler is lost.
SILENCE_S = 30.0
#: Logs per thread of the cluster: one in progress, the other on its way.
WINDOW = 2
#: Seconds between checks of time limits and of the connection.
_LOOK_S = 1.0
#: Packages whose messages about lost workers are repeated as errors here.
_NOISY = ("distributed", "tornado", "asyncio")
#: Dask's own time limits.
_TIMES = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
    "distributed.comm.timeouts.tcp": f"{SILENCE_S}s",
}


def unprotected(address: str | None) -> str:
    """Return a warning for the address of a cluster that others can reach; otherwise an empty text.

    Tasks of Dask are pickles: their sender runs code as the user of the workers.
    """
    parts = urlsplit(address or "inproc://")
    try:
        here = parts.hostname == "localhost" or ipaddress.ip_address(parts.hostname or "").is_loopback
    except ValueError:
        here = False
    if here or parts.scheme in {"tls", "inproc"}:
        return ""
    return (
        f"{address}: is neither tls:// nor local: anyone who reaches it can run programs as the user of its "
        "workers; set up TLS in Dask's configuration, and give a tls:// address"
    )


def on_dask(tasks: Iterable[LogTask], settings: FleetSettings) -> Iterator[Done]:
    """Yield logs with their rows as the workers of a scheduler finish them.

    Raises EngineError if dask is missing, or if the scheduler or all workers can't be reached or are lost.
    """
    address = settings.scheduler or ""
    waiting = deque(tasks)
    hands: dict[Future, LogTask] = {}
    with _connected(address) as client:
        from distributed import CancelledError, wait

        cluster = _Cluster(client, address)
        try:
            while True:
                while waiting and len(hands) < WINDOW * cluster.threads():
                    task = waiting.popleft()
                    hands[client.submit(on_worker, task, settings, pure=False)] = task
                if not hands and not waiting:
                    return
                # A lost scheduler cancels its futures; a closed client raises ValueError.
                with suppress(TimeoutError, CancelledError, ValueError):
                    wait(list(hands), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
                if not hands:
                    time.sleep(_LOOK_S)
                for future in [future for future in hands if future.done()]:
                    task = hands.pop(future)
                    row = _row_from(future, task, settings)
                    future.release()
                    if row is None:
                        waiting.appendleft(task)
                    else:
                        yield task, row
        finally:
            with suppress(Exception):
                client.cancel(list(hands), force=True)


def on_worker(task: LogTask, settings: FleetSettings) -> LogRow:
    """Return the row of a log; runs on a worker."""
    child = child_process(settings)
    try:
        return row_of(task, settings, child)
    finally:
        child.end()


class _Cluster:
    """The workers of a cluster, asked once a second."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self._address = client, address
        self._threads = 0
        self._asked, self._heard = -math.inf, time.monotonic()

    def threads(self) -> int:
        """Return the number of threads of all workers; raise EngineError if the cluster is lost."""
        if time.monotonic() - self._asked >= _LOOK_S:
            self._asked, self._threads = time.monotonic(), 0
            if self._client.status == "running":
                with suppress(OSError, TimeoutError):
                    self._threads = sum(self._client.nthreads().values())
            if self._threads:
                self._heard = time.monotonic()
            elif time.monotonic() - self._heard > SILENCE_S or self._client.status == "closed":
                reason = "scheduler or workers are gone; finished logs are kept; start them, and run again"
                raise EngineError(reason, place=self._address)
        return self._threads


def _row_from(future: "Future", task: LogTask, settings: FleetSettings) -> LogRow | None:
    """Return the row of a finished log; None if it must be submitted again."""
    from distributed import KilledWorker

    # The scheduler was lost, perhaps only for a moment.
    if future.status == "cancelled":
        return None
    try:
        row: LogRow = future.result(timeout=CONNECT_S)
    except KilledWorker:
        return first_row(task, settings, status="crash", reason="its workers ended")
    except (TimeoutError, OSError) as error:
        if future.status != "error":
            return None
        # Another attempt would fail in the same way.
        why = f"its worker failed ({type(error).__name__}: {error})"
        return first_row(task, settings, status="crash", reason=why)
    return row


@contextmanager
def _connected(address: str) -> Iterator["Client"]:
    """Yield the client of a scheduler with workers of this version of imucal."""
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        msg = f"a fleet on a cluster needs dask ({error}): pip install 'imucal-noise[fleet]'"
        raise EngineError(msg) from error
    with dask.config.set(_TIMES), _quiet():
        try:
            client = Client(address, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError, TypeError) as error:
            problem = f"can't be reached ({error}); expected the address of a Dask scheduler"
            raise EngineError(problem, place=address) from error
        try:
            check_workers(client, address)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)


def check_workers(client: "Client", address: str) -> None:
    """Wait for a worker; raise EngineError if there is none, or one has another version of imucal."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(_version, on_error="return")
    except (OSError, TimeoutError) as error:
        within = f"no worker within {WORKERS_S:.0f} s ({error})"
        raise EngineError(within, place=address, fix=Fix(f"start some: dask worker {address}")) from error
    for worker, version in found.items():
        if version != __version__:
            what = f"imucal {version}" if isinstance(version, str) else f"no imucal ({version})"
            msg = f"{worker}: found {what}, expected {__version__}; install imucal-noise=={__version__} there"
            raise EngineError(msg)


def _version() -> str:
    return __version__


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence distributed's messages about workers; lost workers are reported as errors."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _NOISY]
    levels = {logger: logger.level for logger in map(logging.getLogger, (*_NOISY, *names))}
    for logger in levels:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)
