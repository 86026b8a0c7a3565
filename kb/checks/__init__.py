"""Model checks: what can never work, contradicts itself or is likely a slip, and what to do about it.

`model` asks the rest: `contradictions` (what no measurement makes possible) and `choices` (what is never chosen).
`findings` lists all there is to find.
"""
