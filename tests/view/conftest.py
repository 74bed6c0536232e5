"""One browser for all the pages of a module."""

from collections.abc import Iterator

import pytest

from tests.view.browser import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator:
    """Closed before tests elsewhere run event loops of their own."""
    with chromium() as found:
        yield found
