"""Options and fixtures for all tests."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest

__all__ = [
    "axes_are_screened_once",
    "faults_fail_the_test",
    "forks",
    "logs_are_done_here",
    "pictures_are_blank",
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "update_golden",
]

# This must precede the import of NumPy, here and in the workers: matrices are small, and competing threads
# of several workers take twice the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A background job of a shell ignores SIGINT, and its children would inherit this.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Otherwise hundreds of child processes would compile the package, which takes longer than most of their work.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that renews golden files; check the difference before a commit."""
    parser.addoption("--update-golden", action="store_true", help="write the golden files anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start with the longest test, so that it does not run alone at the end."""
    items.sort(key=lambda item: item.path.name != "test_readme.py")


@pytest.fixture(autouse=True)
def faults_fail_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise faults of the program in side work (second opinions …), which users only see as findings.

    All tests use it, because it changes no result of a program without faults, and a fault could occur in any
    test. IMUCAL_DEBUG would do the same but also changes the messages of the command line.
    """
    from imucal import side_work

    monkeypatch.setattr(side_work, "faults_are_raised", lambda: True)


@pytest.fixture
def axes_are_screened_once() -> Iterator[None]:
    """Screen each axis once for all tests with equal samples."""
    from tests.screening.once import axes_screened_once

    with axes_screened_once():
        yield


@pytest.fixture
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run parallel work in forked children, despite servers of earlier tests."""
    every, existing = threading.enumerate, set(threading.enumerate()) - {threading.main_thread()}
    monkeypatch.setattr(threading, "enumerate", lambda: [each for each in every() if each not in existing])


@pytest.fixture
def logs_are_done_here() -> Iterator[None]:
    """Process the logs of fleets in this process; tests of faults use their own processes."""
    from tests.fleet.done_here import logs_done_here

    with logs_done_here():
        yield


@pytest.fixture
def pictures_are_blank() -> Iterator[None]:
    """Skip the drawing of pictures; tests of figures, pages and the README draw them."""
    from tests.report.blank import blank_pictures

    with blank_pictures():
        yield


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Return whether golden files are written instead of compared."""
    return bool(request.config.getoption("--update-golden"))
