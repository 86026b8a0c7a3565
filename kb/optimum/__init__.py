"""The best configuration by estimations and preferences, and how sure that is.

`posing` makes a `problem` of what is required now, `solver` finds the best and proves it (the only module that imports
ortools, and so imported late), and `planner` is the planner of the adaptation loop that does both: within an update, or
`beside` it.
"""
