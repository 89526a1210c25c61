"""Batches that are late or lost, with a played client of Dask: what is given up, what is waited for."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from imucal.fleet_run.on_dask import DaskRun, Hand, Lost
from imucal.fleet_run.plan import LogTask

BATCH = [LogTask(place="a.mcap")]


class Played:
    """A client of Dask whose scheduler has one worker, and which restarts workers that it still has."""

    status = "running"

    def __init__(self, *workers: str) -> None:
        self.workers = set(workers)
        self.restarted: list[str] = []

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(self.workers, 1)

    def submit(self, *_: object, **__: object) -> "Played":
        return Played()

    def cancel(self) -> None:
        """As a future is."""

    def restart_workers(self, workers: list[str], **_: object) -> None:
        for worker in workers:
            self.workers.remove(worker)
            self.restarted.append(worker)


def run_of(client: Played) -> DaskRun[list[LogTask], list[object]]:
    """Return a run whose batches may take ten seconds."""
    return DaskRun(cast("Any", client), "here", lambda _: [], lambda _: 10.0)


def late_run(client: Played, *, begun_at: str) -> DaskRun[list[LogTask], list[object]]:
    """Return a run with one batch in hand, which a worker began long ago."""
    run = run_of(client)
    run.submit(BATCH)
    run.threads()
    run.begun((0.0, (1, begun_at)))
    (hand,) = run.hands.values()
    hand.begun -= 60.0
    return run


def test_a_worker_that_is_late_is_restarted() -> None:
    """And its batch is lost, with the reason."""
    client = Played("tcp://a:1", "tcp://b:1")
    run = late_run(client, begun_at="tcp://a:1")
    assert list(run.late()) == [(BATCH, Lost(status="timeout", reason="its worker did not answer any more"))]
    assert client.restarted == ["tcp://a:1"]
    assert not run.hands


def test_a_batch_of_a_worker_that_is_gone_is_not_late() -> None:
    """The scheduler gives it to another, whose time begins when it says so."""
    client = Played("tcp://b:1")
    run = late_run(client, begun_at="tcp://a:1")
    assert list(run.late()) == []
    run.begun((0.0, (1, "tcp://b:1")))
    assert list(run.late()) == []
    assert (client.restarted, len(run.hands)) == ([], 1)


@pytest.mark.parametrize(
    ("status", "outcome", "in_hand"),
    [
        ("error", Lost(status="crash", reason="its worker failed (OSError: [Errno 28] no room)"), 0),
        ("finished", None, 1),
    ],
)
def test_what_the_work_raises_is_not_tried_for_ever(status: str, outcome: Lost | None, in_hand: int) -> None:
    """An error of the way is: the same one where the result could not be brought."""

    def result(**_: object) -> None:
        raise OSError(28, "no room")

    future = SimpleNamespace(status=status, result=result)
    run = run_of(Played("tcp://a:1"))
    assert run.outcome(Hand(BATCH, cast("Any", future))) == outcome
    assert len(run.hands) == in_hand


@pytest.mark.parametrize("error", [KeyError("tcp://a:1"), TimeoutError(), OSError()])
def test_a_worker_that_goes_in_this_moment_is_no_error(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scheduler may have restarted it itself."""
    client = Played("tcp://a:1")
    run = late_run(client, begun_at="tcp://a:1")

    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(client, "restart_workers", fails)
    assert [lost.status for _, lost in run.late()] == ["timeout"]
