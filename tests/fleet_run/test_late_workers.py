"""Batches whose workers fail, with a played client of Dask: what is given up, what is handed out again."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from imucal.errors import EngineError
from imucal.fleet_run import on_dask
from imucal.fleet_run.on_dask import DaskRun, Lost


class Played:
    """A client of Dask whose scheduler has so many workers of one thread."""

    status = "running"

    def __init__(self, workers: int = 1) -> None:
        self.workers = workers

    def nthreads(self) -> dict[str, int]:
        return {f"tcp://a:{number}": 1 for number in range(self.workers)}

    def submit(self, *_: object, **__: object) -> object:
        return object()


def run_of(client: Played) -> DaskRun[str, str]:
    """Return a run on a cluster."""
    return DaskRun(cast("Any", client), "here", lambda batch: batch)


@pytest.mark.parametrize(
    ("status", "outcome", "in_hand"),
    [
        ("error", Lost(reason="its worker failed (OSError: [Errno 28] no room)"), 0),
        ("finished", None, 1),
        ("cancelled", None, 1),
    ],
)
def test_what_the_work_raises_is_not_tried_for_ever(status: str, outcome: Lost | None, in_hand: int) -> None:
    """One of the way is: the same where the result could not be brought, or the scheduler was lost."""

    def result(**_: object) -> None:
        raise OSError(28, "no room")

    run = run_of(Played())
    assert run.outcome(cast("Any", SimpleNamespace(status=status, result=result)), "batch") == outcome
    assert list(run.hands.values()) == ["batch"] * in_hand


def test_nobody_is_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a time without any worker the run ends, and says what to do."""
    monkeypatch.setattr(on_dask, "SILENCE_S", 0.0)
    assert run_of(Played(2)).threads() == 2
    with pytest.raises(EngineError, match=r"^here: scheduler or workers are gone; what was done is kept; st"):
        run_of(Played(0)).threads()
