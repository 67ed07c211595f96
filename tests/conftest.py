"""What holds for every test file."""

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def _nothing_kept_for_other_files(request: pytest.FixtureRequest) -> Iterator[None]:
    """Clear what a file's cached functions keep: of the long tests' factors the process grew to ten gigabytes."""
    yield
    for each in vars(request.module).values():
        if hasattr(each, "cache_clear") and each.__module__ == request.module.__name__:
            each.cache_clear()
