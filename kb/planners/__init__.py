"""Which designs and configurations to select.

`priority` is the choice by priority. `optimal` is the planner for the best joint choice by estimations and preferences:
`encoding` makes numbers of what is required now, and `solver`, the only module that imports ortools, finds and proves.
"""
