"""Keeping what is told, on disk and for queries.

`journal` numbers what is told, `writer` commits it in order, by one thread, to the `file`; `recovery` goes on from
there after a kill. `queries` reads SPARQL, and `keeping` is what a knowledge base offers of all this.
"""
