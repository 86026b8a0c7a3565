"""ROSA's models in TypeQL 2 files, both ways; imported late, for it needs lark.

A file is read in steps: `reading` (text to statements, by `grammar.lark`, which are the values of `syntax`), `store`
and `matching` (statements to things that play roles, in the types of `schema` and the spellings of `words`), and
`building` and `facts` (things to a model). `writing` is the way back.
"""

from kb.typeql.reading import load_typeql
from kb.typeql.writing import typeql_text

__all__ = ["load_typeql", "typeql_text"]
