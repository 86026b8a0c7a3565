"""What runs a mission: its parts, the run, the task layer, percepts, and recordings."""
