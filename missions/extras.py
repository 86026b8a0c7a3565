"""What is optional: a library that is there only if its extra was installed."""

from collections.abc import Iterator
from contextlib import contextmanager

from missions.engine.mission import MissionError


@contextmanager
def needs(extra: str, what: str) -> Iterator[None]:
    """Say which extra is missing when an import inside fails.

        with needs("live", "the live page"):
            import websockets

    Raises:
        MissionError: a library is not installed.
    """
    try:
        yield
    except ImportError as error:
        missing = f"{what} needs {error.name or error}, which is not installed"
        raise MissionError(f"{missing}; pip install 'rosa-taca[{extra}]' brings it") from error
