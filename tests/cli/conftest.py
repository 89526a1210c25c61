"""Commands under test write their pictures blank, unless a test looks at them."""

import pytest

__all__ = ["pictures", "pictures_unless_asked_for"]


@pytest.fixture
def pictures() -> None:
    """Have pictures drawn."""


@pytest.fixture(autouse=True)
def pictures_unless_asked_for(request: pytest.FixtureRequest) -> None:
    """Draw blank pictures unless a test uses the fixture `pictures`."""
    if "pictures" not in request.fixturenames:
        request.getfixturevalue("pictures_are_blank")
