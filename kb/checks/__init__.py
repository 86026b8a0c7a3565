"""A judge of models: what can never work, contradicts itself or is likely a slip, and what to do about it.

`verdict` asks the rest: `contradictions` (what no measurement makes possible), `rivals` (what is never chosen) and
`premises` (facts that the model states). `findings` lists all there is to find.
"""

from kb.checks.findings import Finding, Severity
from kb.checks.model import check_model

__all__ = ["Finding", "Severity", "check_model"]
