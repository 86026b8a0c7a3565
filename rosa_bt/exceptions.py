"""What can go wrong in the layer of trees; each message says what was given, what exists and what to do."""

__all__ = ["RosaBtError", "TraceError", "TreeChangeError"]


class RosaBtError(Exception):
    """Base of every error that this package raises on purpose."""


class TreeChangeError(RosaBtError):
    """A tree cannot be changed like that, or not now."""


class TraceError(RosaBtError):
    """A file is no trace, or cannot be fed again."""
