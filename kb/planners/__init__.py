"""Which designs and configurations to select.

`choice` says what makes one better, and chooses by priority; `optimal` is the planner for the best joint choice:
`encoding` makes numbers of what is required now, and `solver`, the only module that imports ortools, finds and proves.
"""
