"""A clock that a test moves by hand."""

__all__ = ["FakeClock"]


class FakeClock:
    """A clock that stands still until it is moved; hand it to whatever takes a `clock`.

    Args:
        now: what it shows first [s].
    """

    def __init__(self, now: float = 0.0) -> None:
        self._now = now

    @property
    def now(self) -> float:
        """The time [s]."""
        return self._now

    def __call__(self) -> float:
        """Return the time [s]."""
        return self._now

    def __repr__(self) -> str:
        return f"FakeClock({self._now:g})"

    def advance(self, seconds: float) -> float:
        """Let time pass [s]; return the time then."""
        return self.advance_to(self._now + seconds)

    def advance_to(self, time: float) -> float:
        """Let time pass until `time` [s]; return it.

        Raises:
            ValueError: that time is over, or is no time.
        """
        if not time >= self._now:
            raise ValueError(f"a clock that shows {self._now:g} s cannot be moved to {time:g} s; time only passes")
        self._now = time
        return time
