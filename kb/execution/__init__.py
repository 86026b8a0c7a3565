"""Carrying out plans on a system that may be slow, fail or lie.

`executor` carries out a plan in stages, with the patience that `attempts` has for each command; `condemned` are the
configurations that could not be set; `gate` asks for a veto first, and `rehearsal` is a dry run.
"""
