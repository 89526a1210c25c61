"""Options and fixtures every test may use."""

import os

import pytest

__all__ = ["faults_fail_the_test", "pytest_addoption", "pytest_collection_modifyitems", "update_golden"]

# Before NumPy is imported, here and in the workers: its matrices are small here, and threads of
# several workers that wait for each other in a loop take twice the time of the work itself.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


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


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written instead of compared."""
    return bool(request.config.getoption("--update-golden"))
