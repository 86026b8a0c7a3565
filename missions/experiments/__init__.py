"""Many runs and what came of them: campaigns and their reports, and what it takes to write a model."""
