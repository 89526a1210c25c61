"""A pytest plugin for mutants: it records the lines of each test and makes tests deterministic.

If `IMUCAL_LINES` names a folder, each process writes the lines and durations of its tests there. Otherwise
the plugin only fixes the examples of Hypothesis and limits memory and, by `IMUCAL_SECONDS`, CPU time of
mutants.
"""

import json
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from coverage import Coverage

_MEMORY = 12 << 30
_FOLDER = os.environ.get("IMUCAL_LINES")
_RECORDER = (
    Coverage(
        data_file=Path(_FOLDER) / f"{os.getpid()}.coverage",
        include=["imucal/*"],
        config_file=False,
        messages=False,
    )
    if _FOLDER
    else None
)
_seconds: dict[str, float] = {}
_failed: set[str] = set()
_ran: list[str] = []
_slow: list[str] = []


def pytest_configure() -> None:
    """Remove randomness, and start recording."""
    from hypothesis import Phase, settings

    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("mutants", derandomize=True, database=None, deadline=None, phases=phases)
    settings.load_profile("mutants")
    if seconds := os.environ.get("IMUCAL_SECONDS"):
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), resource.getrlimit(resource.RLIMIT_CPU)[1]))
    if _RECORDER:
        _RECORDER.start()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Limit the memory, except that of a browser, which reserves far more than it uses."""
    if not (_RECORDER or any(map(_has_browser, session.items))):
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def _has_browser(item: pytest.Item) -> bool:
    return isinstance(item, pytest.Function) and "browser" in item.fixturenames


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Record each test under its name."""
    if _RECORDER:
        _RECORDER.switch_context(item.nodeid)
        _ran.append(item.nodeid)
        if item.get_closest_marker("slow"):
            _slow.append(item.nodeid)
    result = yield
    if _RECORDER:
        _RECORDER.switch_context("")
    return result


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Store the duration and the failure of a test."""
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration
    if report.failed:
        _failed.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the record of this process; the process that distributes tests has none."""
    if _RECORDER:
        _RECORDER.stop()
    if _RECORDER and _FOLDER and _ran:
        _RECORDER.save()
        seen = {"seconds": _seconds, "failed": sorted(_failed), "slow": _slow}
        (Path(_FOLDER) / f"{os.getpid()}.json").write_text(json.dumps(seen), encoding="utf-8")
