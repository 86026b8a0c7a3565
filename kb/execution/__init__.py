"""Carrying out plans on a system that may be slow, fail or lie.

`executor` carries out a plan in stages and retries its commands; `safeguards` keep from it what must not be done.
"""
