"""Batches that are late or lost, with a played client of Dask: what is given up, what is waited for."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from imucal.fleet_run.on_dask import Lost, _Hand, _Run


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


def late_run(client: Played, *, begun_at: str) -> "_Run[str, str]":
    """Return a run with one batch in hand, which a worker began long ago."""
    run: _Run[str, str] = _Run(cast("Any", client), "here", str, lambda _: 10.0, lambda _: None)
    run._submit("batch")
    run._workers()
    run._begun((0.0, (1, begun_at)))
    (hand,) = run._hands.values()
    hand.begun -= 60.0
    return run


def test_a_worker_that_is_late_is_restarted() -> None:
    """And its batch is lost, with the reason."""
    client = Played("tcp://a:1", "tcp://b:1")
    run = late_run(client, begun_at="tcp://a:1")
    assert list(run._late()) == [
        ("batch", Lost(status="timeout", reason="its worker did not answer any more"))
    ]
    assert client.restarted == ["tcp://a:1"]
    assert not run._hands


def test_a_batch_of_a_worker_that_is_gone_is_not_late() -> None:
    """The scheduler gives it to another, whose time begins when it says so."""
    client = Played("tcp://b:1")
    run = late_run(client, begun_at="tcp://a:1")
    run._forget_gone_workers()
    assert list(run._late()) == []
    run._begun((0.0, (1, "tcp://b:1")))
    assert list(run._late()) == []
    assert (client.restarted, len(run._hands)) == ([], 1)


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
    run: _Run[str, str] = _Run(cast("Any", Played("tcp://a:1")), "here", str, lambda _: 10.0, lambda _: None)
    assert run._outcome(cast("Any", future), _Hand("batch", 1)) == outcome
    assert len(run._hands) == in_hand


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
    assert [lost.status for _, lost in run._late() if isinstance(lost, Lost)] == ["timeout"]
