"""A model and what is told as OWL: individuals in the words of `rosa.owl`, files in RDF/XML, SPARQL queries, HermiT."""
