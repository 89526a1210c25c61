"""Batches of a fleet on Dask: a cluster of this machine's cores, or one that is there already.

The scheduler only hands out work: what is done is in the store. So a lost scheduler costs what was in hand,
and nothing waits for ever: connections, workers and batches have times after which they are given up.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from imucal.errors import EngineError
from imucal.fleet_run.dask_cluster import CLOSE_S, CONNECT_S, SILENCE_S, Engine, dask_client

if TYPE_CHECKING:
    from distributed import Client, Future

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
