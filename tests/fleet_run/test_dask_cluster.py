"""Tests of clusters that are unavailable or unprotected: messages contain the address and advice."""

import errno
import re

import pytest

from imucal.errors import EngineError
from imucal.fleet_run.on_dask import dask_workers, unprotected

pytest.importorskip("distributed")


class Workerless:
    """A client whose scheduler has no workers."""

    def __init__(self, *_: object, **__: object) -> None:
        """Ignore all arguments."""

    def wait_for_workers(self, *_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, "nobody")

    def cancel(self, *_: object, **__: object) -> None:
        """Do nothing."""

    def close(self, **__: object) -> None:
        """Do nothing."""


def fails(*_: object, **__: object) -> None:
    raise OSError(errno.EMFILE, "full")


@pytest.mark.parametrize(
    ("fake", "message"),
    [
        (fails, "can't be reached ([Errno 24] full); expected the address of a Dask scheduler"),
        (
            Workerless,
            "no worker within 120 s ([Errno 11] nobody); start some: dask worker tcp://head:8786",
        ),
    ],
)
def test_missing_parts_are_reported(monkeypatch: pytest.MonkeyPatch, fake: object, message: str) -> None:
    monkeypatch.setattr("distributed.Client", fake)
    message = f"tcp://head:8786: {message}"
    with pytest.raises(EngineError, match=f"^{re.escape(message)}$"), dask_workers("tcp://head:8786", str):
        pass


@pytest.mark.parametrize(
    "address", ["tls://head:8786", "tcp://127.0.0.1:8786", "tcp://[::1]:8786", "tcp://localhost:8786"]
)
def test_a_protected_address_is_not_reported(address: str) -> None:
    assert not unprotected(address)


@pytest.mark.parametrize("address", ["tcp://head:8786", "10.1.2.3:8786", "ucx://head", "tcp://0.0.0.0:1"])
def test_a_public_address_is_reported(address: str) -> None:
    """Tasks are pickles, so anyone who can send one can run programs as the workers' user."""
    message = unprotected(address)
    assert message.startswith(
        f"{address}: is neither tls:// nor local: anyone who reaches it can run programs"
    )
    assert message.endswith("set up TLS in Dask's configuration, and give a tls:// address")
