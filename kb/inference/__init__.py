"""What follows from the facts of the moment.

`network` is what depends on what, `state` the facts and statuses as arrays over it, with layers of "what if" on top;
`settling` finds the statuses that follow from a change. `measuring` and `steadiness` are about measurements over time,
`alarms` about what follows from time alone, and `growth` about a model that changes meanwhile.
"""
