"""A model and what is told as OWL: individuals in the words of `rosa.owl`, files in RDF/XML, SPARQL queries, HermiT.

`individuals` leads from a model to individuals and back; `queries` and `files` are all that imports pyoxigraph, the
latter owlready2 too.
"""
