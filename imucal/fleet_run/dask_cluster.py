"""A client of Dask whose workers can do the work: of a cluster on this machine, or of one that is there."""

import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucal._version import __version__
from imucal.errors import EngineError
from imucal.resources import POOLS, THREADS

if TYPE_CHECKING:
    from distributed import Client

#: Seconds that connecting, a first worker, and closing may take.
CONNECT_S, WORKERS_S, CLOSE_S = 20.0, 120.0, 10.0
#: Of a scheduler that nobody hears of any more for so many seconds, nothing more is expected.
SILENCE_S = 30.0
#: A worker that is not heard of for so many seconds is taken for frozen.
FROZEN_S = 60.0
#: Who logs while workers come and go.
_NOISY = ("distributed", "tornado", "asyncio")


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


def versions() -> str:
    """Return imucal's version, as a worker has it."""
    return __version__


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
            _check_workers(client, engine)
            yield client
        finally:
            with suppress(Exception):
                client.close(timeout=CLOSE_S)
            if cluster is not None:
                with suppress(Exception):
                    cluster.close(timeout=CLOSE_S)


def _check_workers(client: "Client", engine: Engine) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
        found = client.run(versions, on_error="return")
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
