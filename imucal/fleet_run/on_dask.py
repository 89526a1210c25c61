"""Batches of a fleet on Dask: a cluster of this machine's cores, or one that is there already.

The scheduler only hands out work: what is done is in the store. So a lost scheduler costs what was in hand,
and nothing waits for ever: connections, workers and batches have times after which they are given up.
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
from typing import TYPE_CHECKING, Any, TypeAlias

from imucal._version import __version__
from imucal.errors import EngineError
from imucal.fleet_run.plan import LogDone, LogTask
from imucal.resources import POOLS, THREADS

if TYPE_CHECKING:
    from distributed import Client, Future

#: Seconds that connecting, a first worker, and closing may take.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: Of a scheduler that nobody hears of any more for so many seconds, nothing more is expected.
SILENCE_S = 30.0
#: A worker that is not heard of for so many seconds is taken for frozen.
FROZEN_S = 60.0
#: Batches in hand for each worker: one at work, the others on their way.
WINDOW = 3
#: Seconds between looks at time limits and at the connection.
_LOOK_S = 1.0
#: A topic of events by which workers say what they begin.
_TOPIC = "imucal-fleet"
#: Who logs while workers come and go.
_NOISY = ("distributed", "tornado", "asyncio")

Batch: TypeAlias = list[LogTask]
Work: TypeAlias = Callable[[Batch], list[LogDone]]


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


def outcomes(
    take: Callable[[], Batch | None], work: Work, *, engine: Engine, patience: Callable[[Batch], float]
) -> Iterator[tuple[Batch, list[LogDone] | Lost]]:
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

    Raises
    ------
    EngineError
        If dask is missing, or the scheduler or all workers can't be reached or are gone.
    """
    with dask_client(engine) as client:
        yield from DaskRun(client, engine.address or "the cluster", work, patience).outcomes(take)


@dataclass(slots=True)
class Hand:
    """A batch in hand, and where and when it was begun."""

    batch: Batch
    future: "Future"
    worker: str = ""
    begun: float = 0.0


class DaskRun:
    """One run on a cluster: the batches in hand, and who is there to do them."""

    def __init__(self, client: "Client", where: str, work: Work, patience: Callable[[Batch], float]) -> None:
        self._client, self._where, self._work, self._patience = client, where, work, patience
        self.hands: dict[int, Hand] = {}
        self._submitted = 0
        self._workers: dict[str, int] = {}
        self._asked, self._heard = -math.inf, time.monotonic()

    def outcomes(self, take: Callable[[], Batch | None]) -> Iterator[tuple[Batch, list[LogDone] | Lost]]:
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

    def submit(self, batch: Batch) -> None:
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

    def _finished(self) -> Iterator[tuple[Batch, list[LogDone] | Lost]]:
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

    def outcome(self, hand: Hand) -> list[LogDone] | Lost | None:
        """Return the result of a batch whose future is done; None where it is handed out again."""
        from distributed import KilledWorker

        # Cancelled: the scheduler was lost; whether it comes back is seen at the next look.
        if hand.future.status != "cancelled":
            try:
                result: list[LogDone] = hand.future.result(timeout=CONNECT_S)
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

    def late(self) -> Iterator[tuple[Batch, Lost]]:
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


def _in_worker(work: Work, batch: Batch, number: int) -> list[LogDone]:
    """Say where a batch is begun, and do it."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(_TOPIC, (number, worker.address))
    return work(batch)


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
            check_workers(client, engine)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)
            if cluster is not None:
                with suppress(Exception):
                    cluster.close(timeout=CLOSE_S)


def check_workers(client: "Client", engine: Engine) -> None:
    """Wait for a worker; refuse those of another version of imucal."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(_version, on_error="return")
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


def _version() -> str:
    """Return imucal's version, as a worker has it."""
    return __version__


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
