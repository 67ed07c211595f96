"""What holds for every test file."""

import gc
from collections.abc import Iterator

import pytest

from twin.blas_threads import set_environment

set_environment()  # before NumPy is loaded: workers' threads wait for each other, some tests took seven times as long


@pytest.fixture(scope="module", autouse=True)
def _nothing_kept_for_other_files(request: pytest.FixtureRequest) -> Iterator[None]:
    """Clear what a file's cached functions keep: of the long tests' factors the process grew to ten gigabytes."""
    yield
    for each in vars(request.module).values():
        if hasattr(each, "cache_clear") and each.__module__ == request.module.__name__:
            each.cache_clear()
    gc.collect()  # sensors and their strained states refer to each other


@pytest.fixture
def says(capsys):
    """Give a command in this process, which must end with a code; return what it prints."""

    def give(code, *arguments):
        from twin.cli import main

        with pytest.raises(SystemExit) as ended:
            main(list(arguments))
        printed = capsys.readouterr()
        assert (ended.value.code or 0) == code, printed.err
        return printed.out + printed.err

    return give
