"""Batches of a fleet on Dask: a cluster of this machine's cores, or one that is there already.

The scheduler only hands out work: what is done is in the store. So a lost scheduler costs what was in hand,
and nothing waits for ever: connections, workers and batches have times after which they are given up.
"""

import logging
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

Batch = TypeVar("Batch")
Result = TypeVar("Result")

#: Batches in hand for each worker: one at work, the others on their way.
WINDOW = 3
#: Seconds that connecting, a first worker, and closing may take.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: Seconds between looks at time limits and at the connection.
_LOOK_S = 1.0
#: A topic of events by which workers say what they begin.
_TOPIC = "imucal-fleet"
#: Of a scheduler that nobody hears of any more for so many seconds, nothing more is expected.
_SILENCE_S = 30.0


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
    with _client(engine) as client:
        yield from _Run(client, work, patience, told).outcomes(take)


class _Run(Generic[Batch, Result]):
    """One run on a cluster."""

    def __init__(
        self,
        client: "Client",
        work: Callable[[Batch], Result],
        patience: Callable[[Batch], float],
        told: Callable[[int], None],
    ) -> None:
        self._client, self._work, self._patience, self._told = client, work, patience, told
        self._hands: dict[Future, _Hand[Batch]] = {}
        self._by_number: dict[int, _Hand[Batch]] = {}
        self._submitted = 0
        self._heard = time.monotonic()

    def outcomes(self, take: Callable[[], Batch | None]) -> Iterator[tuple[Batch, Result | Lost]]:
        self._client.subscribe_topic(_TOPIC, self._begun)
        while True:
            window = WINDOW * max(self._workers(), 1)
            while len(self._hands) < window and (batch := take()) is not None:
                self._submit(batch)
            if not self._hands:
                return
            yield from self._finished()
            yield from self._late()

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
        try:
            count = sum(self._client.nthreads().values()) if self._client.status == "running" else 0
        except (OSError, TimeoutError):
            count = 0
        if count:
            self._heard = time.monotonic()
            self._told(count)
        elif time.monotonic() - self._heard > _SILENCE_S or self._client.status == "closed":
            what = "its scheduler is gone" if self._client.status != "running" else "all its workers are gone"
            address = self._client.scheduler.address if self._client.scheduler else "the cluster"
            msg = f"{address}: {what}; what was done is kept; start it again, and run this again"
            raise EngineError(msg)
        return count

    def _finished(self) -> Iterator[tuple[Batch, Result | Lost]]:
        from distributed import wait

        if not self._hands:
            return
        with suppress(TimeoutError):
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
        except (TimeoutError, OSError):
            self._submit(hand.batch)
            return None
        return result

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
            with suppress(OSError, TimeoutError, ValueError):
                future.cancel()
                self._client.restart_workers([hand.worker], timeout=CLOSE_S, raise_for_error=False)
            yield hand.batch, Lost(status="timeout", reason="its worker did not answer any more")


def _in_worker(work: Callable[[Batch], Result], batch: Batch, number: int) -> Result:
    """Say where a batch is begun, and do it."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(_TOPIC, (number, worker.address))
    return work(batch)


def versions() -> str:
    """Return imucal's version, as a worker has it."""
    return __version__


@contextmanager
def _client(engine: Engine) -> Iterator["Client"]:
    """Yield a client whose workers can do the work; at the end, however it comes, nothing is left running."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        msg = f"a fleet on several processors needs dask ({error}): pip install 'imucal-noise[fleet]'"
        raise EngineError(msg) from error
    cluster = None
    with dask.config.set(_configuration()), _quiet():
        try:
            if engine.address is None:
                cluster = LocalCluster(
                    n_workers=engine.jobs,
                    threads_per_worker=1,
                    memory_limit=engine.memory,
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                )
            client = Client(cluster or engine.address, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            if cluster is not None:
                cluster.close(timeout=CLOSE_S)
            where = engine.address or "a cluster on this machine"
            msg = f"{where}: can't be reached ({error}); expected the address of a Dask scheduler"
            raise EngineError(msg) from error
        try:
            _check_workers(client, engine.address or "the cluster")
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)
            if cluster is not None:
                with suppress(Exception):
                    cluster.close(timeout=CLOSE_S)


def _check_workers(client: "Client", where: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(versions, on_error="return")
    except (OSError, TimeoutError) as error:
        msg = f"{where}: no worker within {WORKERS_S:.0f} s ({error}); start some: dask worker ADDRESS"
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
        "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
        "distributed.comm.timeouts.tcp": f"{_SILENCE_S}s",
        # One thread in each library, before NumPy is imported.
        **{f"distributed.nanny.pre-spawn-environ.{name}": 1 for name in (THREADS, *POOLS)},
    }


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence what distributed logs while workers come and go; what matters is an error of the run."""
    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
