"""Programs of others that plan, each run in a process of its own, and what they need to be asked."""
