"""The pytest plugin `rosa`: fixtures for tests of missions, which import when used."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from missions.testing import Decisions, FakeClock, ScriptedManaged
    from rosa_bt import Trace


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--update-traces`."""
    parser.getgroup("rosa", "adaptive missions (rosa)").addoption(
        "--update-traces", action="store_true", help="write the golden traces"
    )


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

    def beside(source: Any, *given: Any, **named: Any) -> "Decisions":  # noqa: ANN401  # as replay
        if isinstance(source, str | Path):
            source = request.path.parent / source
        return replay(source, *given, **named)

    return beside


@pytest.fixture
def golden_trace(request: pytest.FixtureRequest) -> "Callable[[Trace], None]":
    """Compare a trace with the one in the folder `golden` beside the test.

    `pytest --update-traces` writes that.
    """
    from missions.testing.decisions import check_golden

    test = request.node.nodeid
    name = re.sub(r"[^\w\-]+", "_", test.partition("::")[2]).strip("_")
    return partial(
        check_golden,
        path=request.path.parent / "golden" / f"{request.path.stem}.{name}.trace",
        command=f'pytest --update-traces "{test}"',
        update=request.config.getoption("--update-traces"),
    )
