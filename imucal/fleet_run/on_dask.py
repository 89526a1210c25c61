"""Batches of a fleet on an existing Dask cluster; work on this machine needs no Dask.

Results are in the store, so a lost scheduler costs only the batches in progress.
"""

import ipaddress
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Generic, TypeVar
from urllib.parse import urlsplit

from imucal._version import __version__
from imucal.errors import EngineError, Fix
from imucal.frozen import frozen

if TYPE_CHECKING:
    from distributed import Client, Future

#: Time limits in s of connecting, of waiting for a first worker, and of closing.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: A longer silence, in s, means that the scheduler is lost.
SILENCE_S = 30.0
#: Batches per worker: one in progress, the others on their way.
WINDOW = 3
#: Seconds between checks of time limits and of the connection.
_LOOK_S = 1.0
_NOISY = ("distributed", "tornado", "asyncio")
_TIMES = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
    "distributed.comm.timeouts.tcp": f"{SILENCE_S}s",
}

T = TypeVar("T")
R = TypeVar("R")


@frozen
class Lost:
    """The reason why a batch has no result."""

    reason: str


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


class DaskWorkers(Generic[T, R]):
    """The workers of a cluster, and their batches in progress."""

    def __init__(self, client: "Client", where: str, work: Callable[[T], R]) -> None:
        self._client, self._where, self._work = client, where, work
        self.hands: dict[Future, T] = {}
        self._threads = 0
        self._asked, self._heard = -math.inf, time.monotonic()

    def room(self) -> int:
        """Return how many more batches may be submitted; raise EngineError if the scheduler is lost."""
        if time.monotonic() - self._asked >= _LOOK_S:
            self._asked, self._threads = time.monotonic(), 0
            if self._client.status == "running":
                with suppress(OSError, TimeoutError):
                    self._threads = sum(self._client.nthreads().values())
            if self._threads:
                self._heard = time.monotonic()
            elif time.monotonic() - self._heard > SILENCE_S or self._client.status == "closed":
                reason = "scheduler or workers are gone; finished logs are kept; start them, and run again"
                raise EngineError(reason, place=self._where)
        return WINDOW * max(self._threads, 1) - len(self.hands)

    def outcomes(self, take: Callable[[], T | None]) -> Iterator[tuple[T, R | Lost]]:
        """Submit batches while `take` returns any; yield them with their results as they finish."""
        from distributed import CancelledError, wait

        while True:
            while self.room() > 0 and (batch := take()) is not None:
                self._submit(batch)
            if not self.hands:
                return
            # A lost scheduler cancels its futures; a closed client raises ValueError.
            with suppress(TimeoutError, CancelledError, ValueError):
                wait(list(self.hands), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
            for future in [future for future in self.hands if future.done()]:
                batch, outcome = self.hands.pop(future), self._outcome(future)
                future.release()
                if outcome is None:
                    self._submit(batch)
                else:
                    yield batch, outcome

    def _submit(self, batch: T) -> None:
        self.hands[self._client.submit(self._work, batch, pure=False)] = batch

    def _outcome(self, future: "Future") -> R | Lost | None:
        """Return the result of a finished batch; None if it must be submitted again."""
        from distributed import KilledWorker

        # The scheduler was lost, perhaps only for a moment.
        if future.status == "cancelled":
            return None
        try:
            result: R = future.result(timeout=CONNECT_S)
        except KilledWorker:
            return Lost(reason="its workers ended")
        except (TimeoutError, OSError) as error:
            if future.status != "error":
                return None
            # Another attempt would fail in the same way.
            return Lost(reason=f"its worker failed ({type(error).__name__}: {error})")
        return result


@contextmanager
def dask_workers(address: str, work: Callable[[T], R]) -> Iterator[DaskWorkers[T, R]]:
    """Yield the workers of the cluster of a scheduler; `work` processes a batch and can be pickled.

    Raises EngineError if dask is missing, or if the scheduler or all workers can't be reached or are lost.
    """
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
        workers = DaskWorkers(client, address, work)
        try:
            check_workers(client, address)
            yield workers
        finally:
            with suppress(Exception):
                client.cancel(list(workers.hands), force=True)
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
