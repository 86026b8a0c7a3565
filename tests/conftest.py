"""Settings of hypothesis for every test: the same examples each time, and no clock in the test run."""

from hypothesis import settings

settings.register_profile("ci", derandomize=True, deadline=None, max_examples=100, print_blob=True)
settings.load_profile("ci")
