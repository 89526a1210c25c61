"""Tests of clusters with a fake Dask client: what is unavailable, unprotected or lost, and who repeats it."""

import errno
import re
from collections.abc import Mapping

import pytest

from imucal import __version__
from imucal.errors import EngineError
from imucal.fleet import on_dask as engine
from imucal.fleet.logs import LogTask
from imucal.fleet.on_dask import on_dask, unprotected
from imucal.fleet.plan import FleetSettings
from imucal.fleet.store import LogRow

distributed = pytest.importorskip("distributed")

#: End of a message about a worker of another version.
OTHER = f", expected {__version__}; install imucal-noise=={__version__} there"
#: The row of each log that a worker did.
ROW: LogRow = {"status": "ok"}


class Future:
    """The outcome of a log: a row or an error."""

    def __init__(self, status: str = "finished", error: Exception | None = None) -> None:
        self.status, self.error = status, error

    def done(self) -> bool:
        return True

    def result(self, **_: object) -> LogRow:
        if self.error:
            raise self.error
        return ROW

    def release(self) -> None:
        """Do nothing."""


class FakeClient:
    """A Dask client whose scheduler has some workers with one thread; its futures are given."""

    status = "running"

    def __init__(
        self, *futures: Future, workers: int = 1, versions: Mapping[str, object] | None = None
    ) -> None:
        self.workers, self.futures, self.versions = workers, list(futures), versions or {}
        self.submitted: list[str] = []

    def wait_for_workers(self, *_: object, **__: object) -> None:
        if not self.workers:
            raise OSError(errno.EAGAIN, "nobody")

    def run(self, *_: object, **__: object) -> Mapping[str, object]:
        return {"tcp://a:0": __version__, **self.versions}

    def nthreads(self) -> dict[str, int]:
        return {f"tcp://a:{number}": 1 for number in range(self.workers)}

    def submit(self, _: object, task: LogTask, *__: object, **___: object) -> Future:
        self.submitted.append(task.path)
        return self.futures.pop(0)

    def cancel(self, *_: object, **__: object) -> None:
        """Do nothing."""

    def close(self, **__: object) -> None:
        """Do nothing."""


def fails(*_: object, **__: object) -> None:
    raise OSError(errno.EMFILE, "full")


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Wait for no future; return the numbers of futures for which the run waited."""
    waits: list[int] = []
    monkeypatch.setattr("distributed.wait", lambda hands, **_: waits.append(len(hands)))
    return waits


def rows(monkeypatch: pytest.MonkeyPatch, client: object, *names: str) -> list[tuple[str, str, str]]:
    """Return path, status and reason of some logs, done on a cluster."""
    monkeypatch.setattr("distributed.Client", client if callable(client) else lambda *_, **__: client)
    settings = FleetSettings(store="/", folder="/", scheduler="tcp://head:8786", memory=1 << 30)
    done = on_dask([LogTask(place=name) for name in names], settings)
    return [(task.path, row["status"], row.get("reason", "")) for task, row in done]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(28, "no room"), "its worker failed (OSError: [Errno 28] no room)"),
        (TimeoutError("late"), "its worker failed (TimeoutError: late)"),
        (distributed.KilledWorker("a", "tcp://a:0", 3), "its workers ended"),
    ],
)
def test_a_log_whose_worker_fails_is_given_up(
    monkeypatch: pytest.MonkeyPatch, error: Exception, reason: str
) -> None:
    """Another attempt would fail in the same way; the other logs are done."""
    client = FakeClient(Future("error", error), Future())
    assert rows(monkeypatch, client, "a", "b") == [("a", "crash", reason), ("b", "ok", "")]
    assert client.submitted == ["a", "b"]


@pytest.mark.parametrize(
    "lost", [Future("cancelled"), Future("finished", OSError("gone")), Future("lost", TimeoutError())]
)
def test_a_log_that_the_scheduler_lost_is_submitted_again(
    monkeypatch: pytest.MonkeyPatch, lost: Future
) -> None:
    """The scheduler, or the connection to it, may be back."""
    client = FakeClient(lost, Future(), Future())
    assert sorted(rows(monkeypatch, client, "a", "b")) == [("a", "ok", ""), ("b", "ok", "")]
    assert client.submitted == ["a", "b", "a"]


def test_few_logs_wait_on_the_cluster(monkeypatch: pytest.MonkeyPatch, waits: list[int]) -> None:
    """A lost scheduler forgets only two logs per worker."""
    client = FakeClient(*(Future() for _ in range(30)), workers=3)
    names = [f"{number}" for number in range(30)]
    assert [path for path, _, _ in rows(monkeypatch, client, *names)] == names
    assert waits == [2 * 3] * 5


def test_a_run_without_workers_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error contains advice."""
    monkeypatch.setattr(engine, "SILENCE_S", 0.0)
    client = FakeClient()
    monkeypatch.setattr(client, "nthreads", dict)
    with pytest.raises(EngineError, match=r"^tcp://head:8786: scheduler or workers are gone; finished logs"):
        rows(monkeypatch, client, "a")


@pytest.mark.parametrize(
    ("client", "message"),
    [
        (
            fails,
            "tcp://head:8786: can't be reached ([Errno 24] full); expected the address of a Dask scheduler",
        ),
        (
            FakeClient(workers=0),
            "tcp://head:8786: no worker within 120 s ([Errno 11] nobody); start some: dask worker tcp://head:8786",
        ),
        (
            FakeClient(versions={"tcp://b:1": "0.1"}),
            f"tcp://b:1: found imucal 0.1{OTHER}",
        ),
        (
            FakeClient(versions={"tcp://b:1": ModuleNotFoundError("imucal")}),
            f"tcp://b:1: found no imucal (imucal){OTHER}",
        ),
    ],
)
def test_missing_parts_are_reported(monkeypatch: pytest.MonkeyPatch, client: object, message: str) -> None:
    """The message contains the address and what to do."""
    with pytest.raises(EngineError, match=f"^{re.escape(message)}$"):
        rows(monkeypatch, client, "a")


def test_a_public_address_is_reported() -> None:
    """Tasks are pickles, so anyone who can send one can run programs as the workers' user."""
    for address in ("tls://head:8786", "tcp://127.0.0.1:8786", "tcp://[::1]:8786", "tcp://localhost:8786"):
        assert not unprotected(address)
    for address in ("tcp://head:8786", "10.1.2.3:8786", "ucx://head", "tcp://0.0.0.0:1"):
        message = unprotected(address)
        assert message.startswith(f"{address}: is neither tls:// nor local: anyone who reaches it can run")
        assert message.endswith("set up TLS in Dask's configuration, and give a tls:// address")
