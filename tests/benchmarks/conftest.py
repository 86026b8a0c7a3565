"""Benchmarks leave their tables here; they are printed when all have run."""

import pytest

TABLES = pytest.StashKey()


@pytest.fixture(scope="session")
def tables(request):
    """Functions that return a table each, by title; asked at the end of the run."""
    return request.config.stash.setdefault(TABLES, {})


def pytest_terminal_summary(terminalreporter, config):
    for _, written in sorted(config.stash.get(TABLES, {}).items()):
        terminalreporter.write_line(f"\n{written()}")
