"""Why something is as it is, what would change it, and why one thing was chosen and not another.

`reasons` is the chain from a status down to the facts, in words; `requirements` says what an element needs, and which
facts would have to be others for that; `choice` why something was chosen.
"""
