"""Tests of batches whose workers fail, with a fake Dask client: which are given up or submitted again."""

from collections.abc import Iterable
from functools import partial
from typing import Any, cast

import pytest

from imucal.errors import EngineError
from imucal.fleet_run import on_dask
from imucal.fleet_run.on_dask import DaskWorkers, Lost


class FakeClient:
    """A Dask client whose scheduler has some workers with one thread; its futures are given."""

    status = "running"

    def __init__(self, workers: int = 1, futures: Iterable[object] = ()) -> None:
        self.workers, self.futures = workers, iter(futures)

    def nthreads(self) -> dict[str, int]:
        return {f"tcp://a:{number}": 1 for number in range(self.workers)}

    def submit(self, *_: object, **__: object) -> object:
        return next(self.futures)


class Future:
    """The outcome of a batch."""

    def __init__(self, status: str, error: Exception | None = None) -> None:
        self.status, self.error = status, error

    def done(self) -> bool:
        return True

    def result(self, **_: object) -> str:
        if self.error:
            raise self.error
        return "result"

    def release(self) -> None:
        """Do nothing."""


def run_of(client: FakeClient) -> DaskWorkers[str, str]:
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
def test_work_that_raises_is_not_submitted_again(
    monkeypatch: pytest.MonkeyPatch, status: str, outcome: Lost | str
) -> None:
    """Work that was cancelled with the scheduler is submitted again."""
    monkeypatch.setattr("distributed.wait", lambda *_, **__: None)
    run = run_of(FakeClient(futures=[Future(status, OSError(28, "no room")), Future("finished")]))
    assert [*run.outcomes(partial(next, iter(["batch"]), None))] == [("batch", outcome)]
    assert not run.hands


def test_a_run_without_workers_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error contains advice."""
    monkeypatch.setattr(on_dask, "SILENCE_S", 0.0)
    assert run_of(FakeClient(2)).room() == 2 * on_dask.WINDOW
    with pytest.raises(EngineError, match=r"^here: scheduler or workers are gone"):
        run_of(FakeClient(0)).room()
