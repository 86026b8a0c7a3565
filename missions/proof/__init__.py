"""Proof: a tree, the knowledge base and the manager, as they are, against everything that can happen."""
