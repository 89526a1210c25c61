"""A cluster that can't be had: each message says of which one, and what to do."""

import errno
import re
from typing import Any, cast

import pytest

from imucal.errors import EngineError
from imucal.fleet_run.on_dask import Engine, check_workers, dask_client

pytest.importorskip("distributed")


class Workerless:
    """A client whose scheduler has no workers."""

    def __init__(self, *_: object, **__: object) -> None:
        """Connect to nobody."""

    def wait_for_workers(self, *_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, "nobody")

    def close(self, **__: object) -> None:
        """Leave nobody."""


def fails(*_: object, **__: object) -> None:
    raise OSError(errno.EMFILE, "full")


@pytest.mark.parametrize(
    ("what", "played", "address", "said"),
    [
        (
            "LocalCluster",
            fails,
            None,
            "a cluster of 2 workers can't be started ([Errno 24] full); expected room for it",
        ),
        (
            "Client",
            fails,
            "tcp://head:8786",
            "tcp://head:8786: can't be reached ([Errno 24] full); expected the address of a Dask scheduler",
        ),
        (
            "Client",
            Workerless,
            "tcp://head:8786",
            "tcp://head:8786: no worker within 120 s ([Errno 11] nobody); start some: dask worker tcp://head:8786",
        ),
    ],
)
def test_what_is_missing_is_said(
    monkeypatch: pytest.MonkeyPatch, what: str, played: object, address: str | None, said: str
) -> None:
    monkeypatch.setattr(f"distributed.{what}", played)
    with (
        pytest.raises(EngineError, match=f"^{re.escape(said)}$"),
        dask_client(Engine(address=address, jobs=2, memory=1 << 30)),
    ):
        pass


def test_a_cluster_of_this_machine_without_workers() -> None:
    """It has no address that a worker could be given."""
    with pytest.raises(EngineError, match="a cluster of 3 workers on this machine: no worker within 120 s"):
        check_workers(cast("Any", Workerless()), Engine(jobs=3, memory=1))
