"""Many runs and what came of them.

Campaigns and their reports, and what it takes to write a model.
"""
