"""Putting it together: missions that run, are recorded, replayed and reported."""

from missions.registry import MISSIONS

__all__ = ["MISSIONS"]
