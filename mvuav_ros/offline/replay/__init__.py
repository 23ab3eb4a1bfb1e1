"""The nodes' own code over recordings."""
