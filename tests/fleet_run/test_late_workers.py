"""Batches whose workers fail, with a played client of Dask: what is given up, what is handed out again."""

from collections.abc import Iterable
from functools import partial
from typing import Any, cast

import pytest

from imucal.errors import EngineError
from imucal.fleet_run import on_dask
from imucal.fleet_run.on_dask import DaskWorkers, Lost


class Played:
    """A client of Dask whose scheduler has so many workers of one thread; its futures are played, too."""

    status = "running"

    def __init__(self, workers: int = 1, futures: Iterable[object] = ()) -> None:
        self.workers, self.futures = workers, iter(futures)

    def nthreads(self) -> dict[str, int]:
        return {f"tcp://a:{number}": 1 for number in range(self.workers)}

    def submit(self, *_: object, **__: object) -> object:
        return next(self.futures)


class Future:
    """What became of a batch."""

    def __init__(self, status: str, error: Exception | None = None) -> None:
        self.status, self.error = status, error

    def done(self) -> bool:
        return True

    def result(self, **_: object) -> str:
        if self.error:
            raise self.error
        return "result"

    def release(self) -> None:
        """Forget it."""


def run_of(client: Played) -> DaskWorkers[str, str]:
    """Return a run on a cluster."""
    return DaskWorkers(cast("Any", client), "here", lambda batch: batch)


@pytest.mark.parametrize(
    ("status", "outcome"),
    [
        ("error", Lost(reason="its worker failed (OSError: [Errno 28] no room)")),
        ("finished", "result"),
        ("cancelled", "result"),
    ],
)
def test_what_the_work_raises_is_not_tried_for_ever(
    monkeypatch: pytest.MonkeyPatch, status: str, outcome: Lost | str
) -> None:
    """What could not be brought, or was lost with the scheduler, is handed out again."""
    monkeypatch.setattr("distributed.wait", lambda *_, **__: None)
    run = run_of(Played(futures=[Future(status, OSError(28, "no room")), Future("finished")]))
    assert [*run.outcomes(partial(next, iter(["batch"]), None))] == [("batch", outcome)]
    assert not run.hands


def test_nobody_is_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a time without any worker the run ends, and says what to do."""
    monkeypatch.setattr(on_dask, "SILENCE_S", 0.0)
    assert run_of(Played(2)).room() == 2 * on_dask.WINDOW
    with pytest.raises(EngineError, match=r"^here: scheduler or workers are gone; finished logs are kept"):
        run_of(Played(0)).room()
