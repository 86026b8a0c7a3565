"""Connects a mission, or any robot's own program, to other programs: one file a wire."""
