"""Options and fixtures every test may use."""

import os
import signal
import threading
from collections.abc import Iterator
from functools import cache
from unittest import mock

import pytest

__all__ = [
    "faults_fail_the_test",
    "forks",
    "logs_are_done_here",
    "machine_is_asked_once",
    "pairs_are_found_once",
    "pictures_are_blank",
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "update_golden",
    "work_stays_here",
]

# Before NumPy is imported, here and in the workers: its matrices are small here, and threads of
# several workers that wait for each other in a loop take twice the time of the work itself.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A job that a shell starts in the background ignores SIGINT, and so would the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Hundreds of child processes would each compile the package again, longer than what most of them do.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that renews golden files; look at the difference before you commit it."""
    parser.addoption("--update-golden", action="store_true", help="write the golden files anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest test, so that no worker is left alone with it at the end."""
    items.sort(key=lambda item: item.path.name != "test_readme.py")


@pytest.fixture(autouse=True)
def faults_fail_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise faults of the program in side work (second opinions …); a user is only told of them."""
    from imucal import processes

    monkeypatch.setattr(processes, "faults_are_raised", lambda: True)


@pytest.fixture(autouse=True)
def work_stays_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Do work side by side in this process, unless a test asks for `forks`.

    A child loses what it has laid out and computed for the next test; and whether one may be forked hung on
    the servers that earlier tests of this process have left running.
    """
    from imucal import processes

    if "forks" not in request.fixturenames:
        monkeypatch.setattr(processes, "may_fork", lambda: False)


@pytest.fixture
def forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let work be done in forked children, whatever servers earlier tests have left running."""
    every, earlier = threading.enumerate, set(threading.enumerate()) - {threading.main_thread()}
    monkeypatch.setattr(threading, "enumerate", lambda: [each for each in every() if each not in earlier])


@pytest.fixture
def logs_are_done_here() -> Iterator[None]:
    """Do a fleet's logs in this process; those of the tests of faults have processes of their own."""
    from tests.fleet_run.done_here import logs_done_here

    with logs_done_here():
        yield


@pytest.fixture
def pictures_are_blank() -> Iterator[None]:
    """Leave pictures undrawn; those of the tests of figures and pages and of the README are real ones."""
    from tests.report.blank import blank_pictures

    with blank_pictures():
        yield


@pytest.fixture
def pairs_are_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Find the pair that covers some fits once: a page or a file asks for it again and again.

    One takes 2 to 3 ms; what finds it has tests of its own.
    """
    from imucal.report.exports import config_numbers

    monkeypatch.setattr(config_numbers, "filter_numbers", _pair)


#: Which fits, with which options -> the fits, so that nothing else gets their place, and their pair.
_PAIRS: dict[tuple[object, ...], tuple[object, object]] = {}


def _pair(fits: list[object], **options: object) -> object:
    from imucal.prediction.filter_numbers import filter_numbers

    key = (*map(id, fits), *options.items())
    if key not in _PAIRS:
        _PAIRS[key] = fits, filter_numbers(fits, **options)  # type: ignore[arg-type]
    return _PAIRS[key][1]


@pytest.fixture(scope="session", autouse=True)
def machine_is_asked_once() -> Iterator[None]:
    """Read the limits of the control group once: each small table asks for them several times."""
    from imucal import resources

    with mock.patch.object(resources, "control_group_limits", cache(resources.control_group_limits)):
        yield


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written instead of compared."""
    return bool(request.config.getoption("--update-golden"))
