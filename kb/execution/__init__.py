"""Carrying out plans on a system that may be slow, fail or lie.

`executor` carries out a plan in stages, with the retry policy that `attempts` has for each command; `safeguards` keep
what must not be carried out from it: a veto, budgets, quarantine.
"""
