"""Planners by others, each run in a process of its own, and the code that calls them."""
