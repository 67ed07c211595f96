"""The page on force fields shows what is stored."""

from benchmarks.inverse_page import PAGE, page


def test_page_is_the_scripts_output() -> None:
    assert PAGE.read_text() == page(), "run: python -m benchmarks.inverse_page"
