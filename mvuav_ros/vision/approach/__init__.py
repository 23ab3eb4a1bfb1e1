"""A runway, a road or a pipeline ahead as one shape: found, tracked, and turned into guidance."""
