"""ROSA's models in TypeQL 2 files, both ways; imported late, for it needs lark.

A file is read in steps: `syntax` (text to statements, by `grammar.lark`), `store` (statements to things that play
roles, in the types and spellings of `vocabulary`), `reader` (things to a model). `writer` is the way back.
"""
