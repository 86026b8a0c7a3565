"""Reading PDDL: from text to sections, signatures and conventions; `load_domain` puts it together."""
