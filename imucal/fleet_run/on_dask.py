"""Batches of a fleet on Dask: a cluster of this machine's cores, or one that is there already.

The scheduler only hands out work: what is done is in the store. So a lost scheduler costs what was in hand,
and nothing waits for ever: connections, workers and batches have times after which they are given up.

A client of Dask whose workers can do the work: of a cluster on this machine, or of one that is there.
"""

import logging
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from imucal._version import __version__
from imucal.errors import EngineError
from imucal.resources import POOLS, THREADS

if TYPE_CHECKING:
    from distributed import Client, Future

#: Seconds that connecting, a first worker, and closing may take.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: Of a scheduler that nobody hears of any more for so many seconds, nothing more is expected.
SILENCE_S = 30.0
#: A worker that is not heard of for so many seconds is taken for frozen.
FROZEN_S = 60.0
#: Who logs while workers come and go.
_NOISY = ("distributed", "tornado", "asyncio")


@dataclass(frozen=True, slots=True, kw_only=True)
class Engine:
    """Who does the work.

    Attributes
    ----------
    address
        Of a scheduler; None for a cluster of `jobs` workers on this machine.
    jobs
        Number of workers of a cluster of this machine's.
    memory
        Bytes that each of them may take.
    """

    address: str | None = None
    jobs: int = 1
    memory: int


def versions() -> str:
    """Return imucal's version, as a worker has it."""
    return __version__


@contextmanager
def dask_client(engine: Engine) -> Iterator["Client"]:
    """Yield a client whose workers can do the work; at the end, however it comes, nothing is left running."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        msg = f"a fleet on several processors needs dask ({error}): pip install 'imucal-noise[fleet]'"
        raise EngineError(msg) from error
    cluster = None
    with dask.config.set(_configuration()), _quiet(), _without_script():
        try:
            if engine.address is None:
                with _interrupts_ignored():
                    cluster = LocalCluster(
                        n_workers=engine.jobs,
                        threads_per_worker=1,
                        memory_limit=engine.memory,
                        # Pages that nobody asked for are not served, where Bokeh is installed, too.
                        dashboard_address="127.0.0.1:0",
                        scheduler_kwargs={"dashboard": False},
                        silence_logs=logging.CRITICAL,
                    )
            client = Client(cluster or engine.address, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            if cluster is not None:
                cluster.close(timeout=CLOSE_S)
            msg = f"{engine.address}: can't be reached ({error}); expected the address of a Dask scheduler"
            if engine.address is None:
                msg = f"a cluster of {engine.jobs} workers can't be started ({error}); expected room for it"
            raise EngineError(msg) from error
        try:
            _check_workers(client, engine)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)
            if cluster is not None:
                with suppress(Exception):
                    cluster.close(timeout=CLOSE_S)


def _check_workers(client: "Client", engine: Engine) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(versions, on_error="return")
    except (OSError, TimeoutError) as error:
        within = f"no worker within {WORKERS_S:.0f} s ({error})"
        msg = f"{engine.address}: {within}; start some: dask worker {engine.address}"
        if engine.address is None:
            msg = f"a cluster of {engine.jobs} workers on this machine: {within}; expected room for fewer"
        raise EngineError(msg) from error
    for worker, version in found.items():
        if version != __version__:
            what = f"imucal {version}" if isinstance(version, str) else f"no imucal ({version})"
            msg = f"{worker}: found {what}, expected {__version__}; install imucal-noise=={__version__} there"
            raise EngineError(msg)


def _configuration() -> dict[str, object]:
    return {
        "distributed.scheduler.allowed-failures": 1,
        "distributed.worker.daemon": True,
        # A worker that is not heard of is restarted, also where it froze before it said what it begins.
        "distributed.scheduler.worker-ttl": f"{FROZEN_S}s",
        "distributed.worker.preload": [__name__],
        # Its own watching of itself, many times a second in each process, would take 4 % of a core.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "500ms",
        "distributed.admin.system-monitor.interval": "5s",
        "distributed.worker.memory.monitor-interval": "1s",
        "distributed.scheduler.active-memory-manager.start": False,
        "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
        "distributed.comm.timeouts.tcp": f"{SILENCE_S}s",
        # One thread in each library, before NumPy is imported.
        **{f"distributed.nanny.pre-spawn-environ.{name}": 1 for name in (THREADS, *POOLS)},
    }


@contextmanager
def _without_script() -> Iterator[None]:
    """Let workers start, now and later, without the script that runs here.

    They need imucal's modules alone. `multiprocessing` would have each of them run the script's lines first,
    which start a fleet where they stand outside of an ``if __name__ == "__main__"``.
    """
    names = vars(sys.modules["__main__"])
    kept = {name: value for name, value in names.items() if name in {"__spec__", "__file__"}}
    names["__spec__"] = None
    names.pop("__file__", None)
    try:
        yield
    finally:
        names.update(kept)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Let processes that are started here ignore Ctrl-C, which a terminal sends to all: it is ours alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def dask_setup(_: object) -> None:
    """Ignore Ctrl-C in a worker that was started later; Dask calls it, as this module is a preload."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


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


Batch = TypeVar("Batch")
Result = TypeVar("Result")

#: Batches in hand for each worker: one at work, the others on their way.
WINDOW = 3
#: Seconds between looks at time limits and at the connection.
_LOOK_S = 1.0
#: A topic of events by which workers say what they begin.
_TOPIC = "imucal-fleet"


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


@dataclass(slots=True)
class _Hand(Generic[Batch]):
    """A batch in hand: its number, and where and when it was begun."""

    batch: Batch
    number: int
    worker: str = ""
    begun: float = 0.0


def outcomes(
    take: Callable[[], Batch | None],
    work: Callable[[Batch], Result],
    *,
    engine: Engine,
    patience: Callable[[Batch], float],
    told: Callable[[int], None] = lambda _: None,
) -> Iterator[tuple[Batch, Result | Lost]]:
    """Yield each batch with its result, in the order in which they are done.

    Parameters
    ----------
    take
        Returns the next batch, or None where there is none now; more may come of those that were lost.
    work
        What a worker does with a batch; a function of a module, which may be a `functools.partial`.
    engine
        Who does it.
    patience
        Seconds after which the worker of a batch is taken for dead: more than the work itself allows.
    told
        Called with the number of workers, now and then.

    Raises
    ------
    EngineError
        If dask is missing, or the scheduler or all workers can't be reached or are gone.
    """
    with dask_client(engine) as client:
        yield from _Run(client, engine.address or "the cluster", work, patience, told).outcomes(take)


class _Run(Generic[Batch, Result]):
    """One run on a cluster."""

    def __init__(
        self,
        client: "Client",
        where: str,
        work: Callable[[Batch], Result],
        patience: Callable[[Batch], float],
        told: Callable[[int], None],
    ) -> None:
        self._client, self._where = client, where
        self._work, self._patience, self._told = work, patience, told
        self._hands: dict[Future, _Hand[Batch]] = {}
        self._by_number: dict[int, _Hand[Batch]] = {}
        self._there: dict[str, int] = {}
        self._submitted = self._count = 0
        self._asked = -math.inf
        self._heard = time.monotonic()

    def outcomes(self, take: Callable[[], Batch | None]) -> Iterator[tuple[Batch, Result | Lost]]:
        self._client.subscribe_topic(_TOPIC, self._begun)
        try:
            while True:
                window = WINDOW * max(self._workers(), 1)
                while len(self._hands) < window and (batch := take()) is not None:
                    self._submit(batch)
                if not self._hands:
                    return
                yield from self._finished()
                self._forget_gone_workers()
                yield from self._late()
        finally:
            # What was not begun is not begun any more.
            with suppress(Exception):
                self._client.cancel(list(self._hands), force=True)

    def _submit(self, batch: Batch) -> None:
        self._submitted += 1
        hand = _Hand(batch, self._submitted)
        future = self._client.submit(_in_worker, self._work, batch, hand.number, pure=False)
        self._hands[future] = self._by_number[hand.number] = hand

    def _begun(self, event: tuple[float, Any]) -> None:
        """Note where and when a batch was begun; called in the client's thread."""
        number, worker = event[1]
        hand = self._by_number.get(number)
        if hand is not None:
            hand.worker, hand.begun = worker, time.monotonic()

    def _workers(self) -> int:
        """Return how many threads of workers there are; give up where nobody is heard of."""
        if time.monotonic() - self._asked < _LOOK_S:
            return self._count
        self._asked = time.monotonic()
        try:
            self._there = dict(self._client.nthreads()) if self._client.status == "running" else {}
        except (OSError, TimeoutError):
            self._there = {}
        count = sum(self._there.values())
        if count:
            self._heard = time.monotonic()
            self._told(count)
        elif time.monotonic() - self._heard > SILENCE_S or self._client.status == "closed":
            said = "scheduler or workers are gone; what was done is kept; start them, and run again"
            msg = f"{self._where}: {said}"
            raise EngineError(msg)
        self._count = count
        return count

    def _finished(self) -> Iterator[tuple[Batch, Result | Lost]]:
        from distributed import CancelledError, wait

        if not self._hands:
            return
        # Cancelled are the futures of a scheduler that was lost, and a client that is closed is none.
        with suppress(TimeoutError, CancelledError, ValueError):
            wait(list(self._hands), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
        for future in [future for future in self._hands if future.done()]:
            hand = self._hands.pop(future)
            self._by_number.pop(hand.number, None)
            outcome = self._outcome(future, hand)
            future.release()
            if outcome is not None:
                yield hand.batch, outcome

    def _outcome(self, future: "Future", hand: _Hand[Batch]) -> Result | Lost | None:
        """Return the result of a future that is done; None where it was cancelled and is to be done again."""
        from distributed import KilledWorker

        if future.status == "cancelled":
            # The scheduler was lost; whether it comes back is seen at the next look.
            self._submit(hand.batch)
            return None
        try:
            result: Result = future.result(timeout=CONNECT_S)
        except KilledWorker:
            return Lost(status="crash", reason="the workers that did it ended")
        except (TimeoutError, OSError) as error:
            if future.status == "error":
                # The work's own: another try would end the same, again and again.
                return Lost(status="crash", reason=f"its worker failed ({type(error).__name__}: {error})")
            self._submit(hand.batch)
            return None
        return result

    def _forget_gone_workers(self) -> None:
        """Take what workers began that are gone for not begun: the scheduler gives it to others."""
        for hand in self._hands.values():
            if self._there and hand.begun and hand.worker not in self._there:
                hand.begun = 0.0

    def _late(self) -> Iterator[tuple[Batch, Result | Lost]]:
        """Restart workers that are far over the time of their batch: what they do can't be cancelled."""
        now = time.monotonic()
        late = {
            future: hand
            for future, hand in self._hands.items()
            if hand.begun and now - hand.begun > self._patience(hand.batch)
        }
        for future, hand in late.items():
            del self._hands[future], self._by_number[hand.number]
            # A KeyError: the scheduler has restarted it in this moment.
            with suppress(OSError, TimeoutError, ValueError, KeyError):
                future.cancel()
                self._client.restart_workers([hand.worker], timeout=CLOSE_S, raise_for_error=False)
            yield hand.batch, Lost(status="timeout", reason="its worker did not answer any more")


def _in_worker(work: Callable[[Batch], Result], batch: Batch, number: int) -> Result:
    """Say where a batch is begun, and do it."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(_TOPIC, (number, worker.address))
    return work(batch)
