"""The pytest plugin `rosa`: fixtures for tests of missions, which import when used."""

from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from missions.testing import Decisions, FakeClock, ScriptedManaged
    from rosa_bt import Trace

_WRITTEN = pytest.StashKey[list[Path]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--update-traces`."""
    group = parser.getgroup("rosa", "adaptive missions (rosa)")
    group.addoption(
        "--update-traces",
        action="store_true",
        help="write the golden traces that differ or are missing",
    )


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """Say which golden traces were written."""
    written = config.stash.get(_WRITTEN, [])
    if written:
        terminalreporter.section("golden traces written")
        for path in written:
            terminalreporter.line(str(path))


@pytest.fixture
def fake_clock() -> "FakeClock":
    """A clock at 0 s that the test moves: `fake_clock.advance(0.5)`."""
    from missions.testing import FakeClock

    return FakeClock()


@pytest.fixture
def managed(fake_clock: "FakeClock") -> "ScriptedManaged":
    """A managed system on `fake_clock`: `managed.script("camera", fail_first=2, takes=0.5)`."""
    from missions.testing import ScriptedManaged

    return ScriptedManaged(fake_clock)


@pytest.fixture
def replay(request: pytest.FixtureRequest) -> "Callable[..., Decisions]":
    """`missions.testing.decisions.replay`.

    A relative path is looked for beside the file of the test.
    """
    from missions.testing.decisions import replay

    @wraps(replay)
    def beside(
        source: str | Path | Iterable[Mapping[str, Any]],
        *given: Any,  # noqa: ANN401  # the arguments of replay
        **named: Any,  # noqa: ANN401  # the arguments of replay
    ) -> "Decisions":
        if isinstance(source, str | Path):
            source = request.path.parent / source
        return replay(source, *given, **named)

    return beside


@pytest.fixture
def golden_trace(request: pytest.FixtureRequest) -> "Callable[..., None]":
    """Compare a trace with the one in the folder `golden` beside the test.

    `pytest --update-traces` writes that.
    """
    from missions.testing.decisions import check_golden, golden_path

    config = request.config
    test = request.node.nodeid
    compared: set[Path] = set()

    def check(trace: "Trace", name: str = "") -> None:
        __tracebackhide__ = True
        path = golden_path(request.path, test.partition("::")[2], name)
        if path in compared:
            raise ValueError(
                f"{test} has compared with {path.name} already; golden_trace(trace, name=...)"
            )
        compared.add(path)
        command = f'pytest --update-traces "{test}"'
        if check_golden(trace, path, update=config.getoption("--update-traces"), command=command):
            config.stash.setdefault(_WRITTEN, []).append(path)

    return check
