"""Why something is as it is, what would change it, and why one thing was chosen and not another.

`reasons` is the chain from a status down to the facts; `comparison` makes words of a constraint and its measurement;
`requirements` says what an element needs, `remedies` which facts would have to be others, and `choice` why it was
chosen.
"""
