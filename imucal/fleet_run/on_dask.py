"""Batches of a fleet on a Dask cluster that is there already; what this machine does needs no Dask.

The scheduler only hands out work: what is done is in the store. So a lost scheduler costs what was in hand,
and nothing waits for ever: connections, workers and batches have times after which they are given up.
"""

import ipaddress
import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar
from urllib.parse import urlsplit

from imucal._version import __version__
from imucal.errors import EngineError

if TYPE_CHECKING:
    from distributed import Client, Future

#: Seconds that connecting, a first worker, and closing may take.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: Of a scheduler that nobody hears of any more for so many seconds, nothing more is expected.
SILENCE_S = 30.0
#: Batches in hand for each worker: one at work, the others on their way.
WINDOW = 3
#: Seconds between looks at time limits and at the connection.
_LOOK_S = 1.0
#: A topic of events by which workers say what they begin.
_TOPIC = "imucal-fleet"
#: Who logs while workers come and go.
_NOISY = ("distributed", "tornado", "asyncio")
#: What Dask's client waits for at most.
_TIMES = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
    "distributed.comm.timeouts.tcp": f"{SILENCE_S}s",
}

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lost:
    """Why a batch has no result: its worker ended again and again, or took far too long.

    Attributes
    ----------
    status
        ``crash`` or ``timeout``, as in the store.
    reason
        In words.
    """

    status: str
    reason: str


def unprotected(address: str) -> str:
    """Return what is to be said of an address by which others may reach a cluster; empty where none can.

    Tasks of Dask are pickles: whoever can send one runs code as the user of the workers. Dask's own
    configuration has the certificates of ``tls://`` addresses.
    """
    parts = urlsplit(address)
    try:
        here = parts.hostname == "localhost" or ipaddress.ip_address(parts.hostname or "").is_loopback
    except ValueError:
        here = False
    if here or parts.scheme in {"tls", "inproc"}:
        return ""
    return (
        f"{address}: is neither tls:// nor of this machine alone: whoever reaches it runs programs as the "
        "user of its workers; set up TLS in Dask's configuration, and give a tls:// address"
    )


def outcomes(
    take: Callable[[], T | None], work: Callable[[T], R], *, address: str, patience: Callable[[T], float]
) -> Iterator[tuple[T, R | Lost]]:
    """Yield each batch with its result, in the order in which they are done.

    Parameters
    ----------
    take
        Returns the next batch, or None where there is none now; more may come of those that were lost.
    work
        What a worker does with a batch; a function of a module, which may be a `functools.partial`.
    address
        Of the scheduler of those who do it.
    patience
        Seconds after which the worker of a batch is taken for dead: more than the work itself allows.

    Raises
    ------
    EngineError
        If dask is missing, or the scheduler or all workers can't be reached or are gone.
    """
    with dask_client(address) as client:
        yield from DaskRun(client, address, work, patience).outcomes(take)


@dataclass(slots=True)
class Hand(Generic[T]):
    """A batch in hand, and where and when it was begun."""

    batch: T
    future: "Future"
    worker: str = ""
    begun: float = 0.0


class DaskRun(Generic[T, R]):
    """One run on a cluster: the batches in hand, and who is there to do them."""

    def __init__(
        self, client: "Client", where: str, work: Callable[[T], R], patience: Callable[[T], float]
    ) -> None:
        self._client, self._where, self._work, self._patience = client, where, work, patience
        self.hands: dict[int, Hand[T]] = {}
        self._submitted = 0
        self._workers: dict[str, int] = {}
        self._asked, self._heard = -math.inf, time.monotonic()

    def outcomes(self, take: Callable[[], T | None]) -> Iterator[tuple[T, R | Lost]]:
        """Do batches as long as there are any, as the function of that name."""
        self._client.subscribe_topic(_TOPIC, self.begun)
        try:
            while True:
                window = WINDOW * max(self.threads(), 1)
                while len(self.hands) < window and (batch := take()) is not None:
                    self.submit(batch)
                if not self.hands:
                    return
                yield from self._finished()
                yield from self.late()
        finally:
            # What was not begun is not begun any more.
            with suppress(Exception):
                self._client.cancel([hand.future for hand in self.hands.values()], force=True)

    def submit(self, batch: T) -> None:
        """Hand out a batch."""
        self._submitted += 1
        future = self._client.submit(_in_worker, self._work, batch, self._submitted, pure=False)
        self.hands[self._submitted] = Hand(batch, future)

    def begun(self, event: tuple[float, Any]) -> None:
        """Note where and when a batch was begun; called in the client's thread."""
        number, worker = event[1]
        if hand := self.hands.get(number):
            hand.worker, hand.begun = worker, time.monotonic()

    def threads(self) -> int:
        """Return how many threads of workers there are; give up where nobody is heard of."""
        if time.monotonic() - self._asked >= _LOOK_S:
            self._asked = time.monotonic()
            try:
                self._workers = dict(self._client.nthreads()) if self._client.status == "running" else {}
            except (OSError, TimeoutError):
                self._workers = {}
            if any(self._workers.values()):
                self._heard = time.monotonic()
            elif time.monotonic() - self._heard > SILENCE_S or self._client.status == "closed":
                said = "scheduler or workers are gone; what was done is kept; start them, and run again"
                msg = f"{self._where}: {said}"
                raise EngineError(msg)
        return sum(self._workers.values())

    def _finished(self) -> Iterator[tuple[T, R | Lost]]:
        from distributed import CancelledError, wait

        # Cancelled are the futures of a scheduler that was lost, and a client that is closed is none.
        with suppress(TimeoutError, CancelledError, ValueError):
            futures = [hand.future for hand in self.hands.values()]
            wait(futures, timeout=_LOOK_S, return_when="FIRST_COMPLETED")
        for number, hand in list(self.hands.items()):
            if not hand.future.done():
                continue
            del self.hands[number]
            outcome = self.outcome(hand)
            hand.future.release()
            if outcome is not None:
                yield hand.batch, outcome

    def outcome(self, hand: Hand[T]) -> R | Lost | None:
        """Return the result of a batch whose future is done; None where it is handed out again."""
        from distributed import KilledWorker

        # Cancelled: the scheduler was lost; whether it comes back is seen at the next look.
        if hand.future.status != "cancelled":
            try:
                result: R = hand.future.result(timeout=CONNECT_S)
            except KilledWorker:
                return Lost(status="crash", reason="the workers that did it ended")
            except (TimeoutError, OSError) as error:
                if hand.future.status == "error":
                    # The work's own: another try would end the same, again and again.
                    return Lost(status="crash", reason=f"its worker failed ({type(error).__name__}: {error})")
            else:
                return result
        self.submit(hand.batch)
        return None

    def late(self) -> Iterator[tuple[T, Lost]]:
        """Restart workers that are far over the time of their batch: what they do can't be cancelled.

        What workers have begun that are gone is not late: the scheduler gives it to others.
        """
        now = time.monotonic()
        for number, hand in list(self.hands.items()):
            if self._workers and hand.worker not in self._workers:
                hand.begun = 0.0
            if not hand.begun or now - hand.begun <= self._patience(hand.batch):
                continue
            del self.hands[number]
            # A KeyError: the scheduler has restarted it in this moment.
            with suppress(OSError, TimeoutError, ValueError, KeyError):
                hand.future.cancel()
                self._client.restart_workers([hand.worker], timeout=CLOSE_S, raise_for_error=False)
            yield hand.batch, Lost(status="timeout", reason="its worker did not answer any more")


def _in_worker(work: Callable[[T], R], batch: T, number: int) -> R:
    """Say where a batch is begun, and do it."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(_TOPIC, (number, worker.address))
    return work(batch)


@contextmanager
def dask_client(address: str) -> Iterator["Client"]:
    """Yield a client of a cluster whose workers can do the work."""
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
            msg = f"{address}: can't be reached ({error}); expected the address of a Dask scheduler"
            raise EngineError(msg) from error
        try:
            check_workers(client, address)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)


def check_workers(client: "Client", address: str) -> None:
    """Wait for a worker; refuse those of another version of imucal."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(_version, on_error="return")
    except (OSError, TimeoutError) as error:
        within = f"no worker within {WORKERS_S:.0f} s ({error})"
        msg = f"{address}: {within}; start some: dask worker {address}"
        raise EngineError(msg) from error
    for worker, version in found.items():
        if version != __version__:
            what = f"imucal {version}" if isinstance(version, str) else f"no imucal ({version})"
            msg = f"{worker}: found {what}, expected {__version__}; install imucal-noise=={__version__} there"
            raise EngineError(msg)


def _version() -> str:
    """Return imucal's version, as a worker has it."""
    return __version__


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence what distributed logs while workers come and go; what matters is an error of the run."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in _NOISY]
    loggers = [logging.getLogger(name) for name in (*_NOISY, *names)]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
