"""Fixture: a browser for exported pages."""

from collections.abc import Iterator

import pytest
from chromium import Browser, chromium


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    pipe = chromium(tmp_path_factory.mktemp("browser"))
    yield Browser(pipe)
    pipe.close()
